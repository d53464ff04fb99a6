//! Host side of `shaders/keypoints/gather.wgsl` and `gather_backward.wgsl`.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::body::{KeypointSet, KeypointSource};
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::Rows;

/// A keypoint set on the device.
pub struct KeypointGather {
    pub n_keypoints: usize,
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    starts: Buffer<u32>,
    sources: Buffer<u32>,
    n_distinct: usize,
    distinct: Buffer<u32>,
    keypoint_starts: Buffer<u32>,
    keypoints: Buffer<u32>,
}

impl KeypointGather {
    pub fn new(gpu: &Gpu, set: &KeypointSet) -> Self {
        let lists: Vec<Vec<u32>> = set.points.iter().map(encoded).collect();
        let mut users: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for (k, list) in lists.iter().enumerate() {
            for &source in list {
                users.entry(source).or_default().push(k as u32);
            }
        }
        let (rows, users_rows) = (Rows::from_lists(&lists), Rows::from_lists(users.values()));
        let distinct: Vec<u32> = users.into_keys().collect();
        Self {
            n_keypoints: set.points.len(),
            forward: kernel!(gpu, "keypoints/gather"),
            backward: kernel!(gpu, "keypoints/gather_backward"),
            starts: gpu.upload("keypoints/starts", &rows.starts),
            sources: gpu.upload("keypoints/sources", &rows.items),
            n_distinct: distinct.len(),
            distinct: gpu.upload("keypoints/distinct", &distinct),
            keypoint_starts: gpu.upload("keypoints/keypoint_starts", &users_rows.starts),
            keypoints: gpu.upload("keypoints/keypoints", &users_rows.items),
        }
    }

    /// Records `keypoints [K, 3]` of a posed body.
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        vertices: &Buffer<f32>,
        joints: &Buffer<f32>,
        keypoints: &Buffer<f32>,
    ) {
        assert!(keypoints.len() == 3 * self.n_keypoints, "{}: length", keypoints.label());
        recorder.dispatch(
            &self.forward,
            &(self.n_keypoints as u32),
            &[&self.starts, &self.sources, vertices, joints, keypoints],
            linear_groups(self.n_keypoints, 64),
        );
    }

    /// Records the way back: adds to `grad_vertices [V, 3]` and `grad_joints [24, 3]`.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        grad_keypoints: &Buffer<f32>,
        grad_vertices: &Buffer<f32>,
        grad_joints: &Buffer<f32>,
    ) {
        assert!(grad_keypoints.len() == 3 * self.n_keypoints, "{}: length", grad_keypoints.label());
        recorder.dispatch(
            &self.backward,
            &(self.n_distinct as u32),
            &[
                &self.distinct,
                &self.keypoint_starts,
                &self.keypoints,
                &self.starts,
                grad_keypoints,
                grad_vertices,
                grad_joints,
            ],
            linear_groups(self.n_distinct, 64),
        );
    }
}

/// Vertex i as 2i, joint i as 2i + 1.
fn encoded(source: &KeypointSource) -> Vec<u32> {
    match source {
        KeypointSource::Joint(j) => vec![2 * j + 1],
        KeypointSource::Joints(joints) => joints.iter().map(|j| 2 * j + 1).collect(),
        KeypointSource::Vertices(vertices) => vertices.iter().map(|v| 2 * v).collect(),
    }
}
