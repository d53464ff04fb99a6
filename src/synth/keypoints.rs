//! What a keypoint detector would say of the made person: COCO-17 with noise, occlusions and dropouts.

use glam::{DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::body::{Body, KeypointSource};
use crate::camera::Camera;
use crate::math::normal;

/// Confidence of a keypoint that the body hides.
const HIDDEN: f64 = 0.3;

/// Share of keypoints that the detector misses.
const DROPOUT: f64 = 0.05;

/// Depth by which the surface may lie before a keypoint that is still seen, metres: joints lie inside the body.
const JOINT_DEPTH: f32 = 0.18;
const SURFACE_DEPTH: f32 = 0.02;

/// `[17]` x, y in pixels and confidence, for a mesh in camera space.
pub(super) fn detect(
    body: &Body,
    vertices: &[[f32; 3]],
    joints: &[[f32; 3]],
    camera: &Camera,
    noise_px: f64,
    rng: &mut Pcg64,
) -> Vec<[f64; 3]> {
    let mean = |points: &[[f32; 3]], which: &[u32]| {
        which.iter().map(|&i| Vec3::from(points[i as usize])).sum::<Vec3>() / which.len().max(1) as f32
    };
    let points = body.keypoint_set("coco17").map_or(&[][..], |set| &set.points);
    let keypoint = |source: &KeypointSource| {
        let (point, depth) = match source {
            KeypointSource::Joint(j) => (Vec3::from(joints[*j as usize]), JOINT_DEPTH),
            KeypointSource::Joints(j) => (mean(joints, j), JOINT_DEPTH),
            KeypointSource::Vertices(v) => (mean(vertices, v), SURFACE_DEPTH),
        };
        let hidden = hidden(body, vertices, point, depth);
        let seen = 0.8 + 0.2 * rng.random::<f64>();
        let noise = [normal(rng), normal(rng)].map(|n| noise_px * n);
        let dropped = rng.random::<f64>() < DROPOUT;
        let [x, y] = camera.project(point.as_dvec3().to_array());
        if dropped { [0.0; 3] } else { [x + noise[0], y + noise[1], if hidden { HIDDEN } else { seen }] }
    };
    points.iter().map(keypoint).collect()
}

/// Whether a face crosses the ray from the camera to `point` more than `depth` before it.
fn hidden(body: &Body, vertices: &[[f32; 3]], point: Vec3, depth: f32) -> bool {
    let (ray, far) = (point.normalize().as_dvec3(), (point.length() - depth) as f64);
    body.faces.iter().any(|face| {
        let [a, b, c] = face.map(|i| DVec3::from(vertices[i as usize].map(f64::from)));
        // Möller and Trumbore: the ray from the origin against the triangle.
        let (e1, e2) = (b - a, c - a);
        let p = ray.cross(e2);
        let det = e1.dot(p);
        if det.abs() < 1e-14 {
            return false;
        }
        let u = -a.dot(p) / det;
        let q = (-a).cross(e1);
        let v = ray.dot(q) / det;
        let t = e2.dot(q) / det;
        u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < far
    })
}
