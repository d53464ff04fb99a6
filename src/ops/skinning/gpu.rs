//! Host side of `shaders/skinning/`.

use std::sync::Arc;

use crate::body::{Body, N_INFLUENCES, N_JOINTS, N_POSE};
use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params([u32; 2]);

/// The numbers of a shader's own `Params`, in its order.
fn params(first: usize, second: usize) -> Params {
    Params([first as u32, second as u32])
}

/// Entries of the local rotations that pose blend shapes follow: 23 joints, 3×3 each.
const N_FEATURES: usize = (N_JOINTS - 1) * 9;

/// One frame of per-frame parameters, or of their gradients.
#[derive(Clone, Copy)]
pub struct PoseAt<'a> {
    /// `[N, 24, 3]`
    pub poses: &'a Buffer<f32>,
    /// `[N, 3]`
    pub transl: &'a Buffer<f32>,
    pub frame: usize,
}

impl PoseAt<'_> {
    fn check(&self) {
        assert!((self.frame + 1) * N_POSE <= self.poses.len(), "{}: frame {}", self.poses.label(), self.frame);
        assert!((self.frame + 1) * 3 <= self.transl.len(), "{}: frame {}", self.transl.label(), self.frame);
    }
}

struct Kernels {
    shape_vertices: Arc<Kernel>,
    shape_joints: Arc<Kernel>,
    betas_backward: Arc<Kernel>,
    offsets_backward: Arc<Kernel>,
    joints: Arc<Kernel>,
    pose_blend: Arc<Kernel>,
    vertices: Arc<Kernel>,
    vertices_backward: Arc<Kernel>,
    transforms_backward: Arc<Kernel>,
    chain_backward: Arc<Kernel>,
    pose_blend_backward: Arc<Kernel>,
    rodrigues_backward: Arc<Kernel>,
}

impl Kernels {
    fn new(gpu: &Gpu) -> Self {
        Self {
            shape_vertices: kernel!(gpu, "skinning/shape_vertices"),
            shape_joints: kernel!(gpu, "skinning/shape_joints"),
            betas_backward: kernel!(gpu, "skinning/betas_backward"),
            offsets_backward: kernel!(gpu, "skinning/offsets_backward"),
            joints: kernel!(gpu, "skinning/joints"),
            pose_blend: kernel!(gpu, "skinning/pose_blend"),
            vertices: kernel!(gpu, "skinning/vertices"),
            vertices_backward: kernel!(gpu, "skinning/vertices_backward"),
            transforms_backward: kernel!(gpu, "skinning/transforms_backward"),
            chain_backward: kernel!(gpu, "skinning/chain_backward"),
            pose_blend_backward: kernel!(gpu, "skinning/pose_blend_backward"),
            rodrigues_backward: kernel!(gpu, "skinning/rodrigues_backward"),
        }
    }
}

/// The body on the device.
pub struct SkinningBody {
    pub n_vertices: usize,
    pub n_betas: usize,
    kernels: Kernels,
    v_template: Buffer<f32>,
    /// `[B, V, 3]`, so that neighbouring lanes read neighbouring values.
    shapedirs: Buffer<f32>,
    j_template: Buffer<f32>,
    /// `[B, 24, 3]`
    j_shapedirs: Buffer<f32>,
    posedirs: Option<Buffer<f32>>,
    /// Parents (the root its own), then the bit set of each joint's subtree.
    skeleton: Buffer<u32>,
    lbs_joints: Buffer<u32>,
    lbs_weights: Buffer<f32>,
    joint_starts: Buffer<u32>,
    joint_vertices: Buffer<u32>,
    joint_weights: Buffer<f32>,
}

/// The T-pose of one iteration and the gradients by it.
pub struct ShapeState {
    pub v_shaped: Buffer<f32>,
    pub v_deformed: Buffer<f32>,
    pub j_shaped: Buffer<f32>,
    pub grad_v_deformed: Buffer<f32>,
    pub grad_j_shaped: Buffer<f32>,
}

impl ShapeState {
    /// Records the clearing of both gradients, once a batch.
    pub fn clear_gradients(&self, recorder: &mut Recorder<'_>) {
        recorder.clear(&self.grad_v_deformed);
        recorder.clear(&self.grad_j_shaped);
    }
}

/// The posed mesh of one frame and what its backward pass needs.
pub struct PoseState {
    pub vertices: Buffer<f32>,
    pub joints: Buffer<f32>,
    pub transforms: Buffer<f32>,
    rotations: Buffer<f32>,
    /// Only where the body has pose blend shapes; else it is `v_deformed`.
    v_posed: Option<Buffer<f32>>,
    grad_v_posed: Buffer<f32>,
    grad_transforms: Buffer<f32>,
    grad_rotations: Buffer<f32>,
}

impl SkinningBody {
    pub fn new(gpu: &Gpu, body: &Body) -> Self {
        let n_vertices = body.n_vertices();
        assert_eq!(body.parents.len(), N_JOINTS, "{}: joints", body.name);
        let influences = Influences::of(body);
        Self {
            n_vertices,
            n_betas: body.n_betas,
            kernels: Kernels::new(gpu),
            v_template: gpu.upload("skinning/v_template", body.v_template.as_flattened()),
            shapedirs: gpu.upload("skinning/shapedirs", &transposed(&body.shapedirs, body.n_betas)),
            j_template: gpu.upload("skinning/j_template", body.j_template.as_flattened()),
            j_shapedirs: gpu.upload("skinning/j_shapedirs", &transposed(&body.j_shapedirs, body.n_betas)),
            posedirs: (!body.posedirs.is_empty()).then(|| {
                assert_eq!(body.posedirs.len(), N_FEATURES * 3 * n_vertices, "{}: posedirs", body.name);
                gpu.upload("skinning/posedirs", &body.posedirs)
            }),
            skeleton: gpu.upload("skinning/skeleton", &skeleton(&body.parents)),
            lbs_joints: gpu.upload("skinning/lbs_joints", body.lbs_joints.as_flattened()),
            lbs_weights: gpu.upload("skinning/lbs_weights", body.lbs_weights.as_flattened()),
            joint_starts: gpu.upload("skinning/joint_starts", &influences.starts),
            joint_vertices: gpu.upload("skinning/joint_vertices", &influences.vertices),
            joint_weights: gpu.upload("skinning/joint_weights", &influences.weights),
        }
    }

    pub fn shape_state(&self, gpu: &Gpu) -> ShapeState {
        let points = |name: &str, n: usize| gpu.zeros(&format!("skinning/{name}"), 3 * n);
        ShapeState {
            v_shaped: points("v_shaped", self.n_vertices),
            v_deformed: points("v_deformed", self.n_vertices),
            j_shaped: points("j_shaped", N_JOINTS),
            grad_v_deformed: points("grad_v_deformed", self.n_vertices),
            grad_j_shaped: points("grad_j_shaped", N_JOINTS),
        }
    }

    pub fn pose_state(&self, gpu: &Gpu) -> PoseState {
        let zeros = |name: &str, len: usize| gpu.zeros(&format!("skinning/{name}"), len);
        PoseState {
            vertices: zeros("vertices", 3 * self.n_vertices),
            joints: zeros("joints", 3 * N_JOINTS),
            transforms: zeros("transforms", 12 * N_JOINTS),
            rotations: zeros("rotations", 9 * N_JOINTS),
            v_posed: self.posedirs.as_ref().map(|_| zeros("v_posed", 3 * self.n_vertices)),
            grad_v_posed: zeros("grad_v_posed", 3 * self.n_vertices),
            grad_transforms: zeros("grad_transforms", 12 * N_JOINTS),
            grad_rotations: zeros("grad_rotations", 9 * N_JOINTS),
        }
    }

    /// Records the T-pose of `betas [B]` and `offsets [V, 3]`: two dispatches.
    pub fn shape_forward(
        &self,
        recorder: &mut Recorder<'_>,
        betas: &Buffer<f32>,
        offsets: &Buffer<f32>,
        shape: &ShapeState,
    ) {
        let len = 3 * self.n_vertices;
        assert!(betas.len() == self.n_betas && offsets.len() == len, "{}, {}: length", betas.label(), offsets.label());
        recorder.dispatch(
            &self.kernels.shape_vertices,
            &params(len, self.n_betas),
            &[&self.v_template, &self.shapedirs, betas, offsets, &shape.v_shaped, &shape.v_deformed],
            linear_groups(len, 64),
        );
        recorder.dispatch(
            &self.kernels.shape_joints,
            &params(3 * N_JOINTS, self.n_betas),
            &[&self.j_template, &self.j_shapedirs, betas, &shape.j_shaped],
            linear_groups(3 * N_JOINTS, 64),
        );
    }

    /// Records the posing of one frame: two dispatches, three with pose blend shapes.
    pub fn pose_forward(&self, recorder: &mut Recorder<'_>, shape: &ShapeState, at: PoseAt<'_>, posed: &PoseState) {
        at.check();
        recorder.dispatch(
            &self.kernels.joints,
            &params(at.frame, 0),
            &[at.poses, at.transl, &shape.j_shaped, &self.skeleton, &posed.rotations, &posed.transforms, &posed.joints],
            [1, 1, 1],
        );
        if let (Some(posedirs), Some(v_posed)) = (&self.posedirs, &posed.v_posed) {
            let len = 3 * self.n_vertices;
            recorder.dispatch(
                &self.kernels.pose_blend,
                &params(len, N_FEATURES),
                &[&shape.v_deformed, posedirs, &posed.rotations, v_posed],
                linear_groups(len, 64),
            );
        }
        let v_posed = posed.v_posed.as_ref().unwrap_or(&shape.v_deformed);
        recorder.dispatch(
            &self.kernels.vertices,
            &params(self.n_vertices, at.frame),
            &[v_posed, &self.lbs_joints, &self.lbs_weights, &posed.transforms, at.transl, &posed.vertices],
            linear_groups(self.n_vertices, 64),
        );
    }

    /// Records the backward pass of one frame: adds to `grad` at its frame and to the gradients in `shape`. `posed` and
    /// `shape` hold the results of the forward passes of `at`.
    #[expect(clippy::too_many_arguments, reason = "an operator's inputs and gradients are its contract")]
    pub fn pose_backward(
        &self,
        recorder: &mut Recorder<'_>,
        shape: &ShapeState,
        at: PoseAt<'_>,
        posed: &PoseState,
        grad_vertices: &Buffer<f32>,
        grad_joints: &Buffer<f32>,
        grad: PoseAt<'_>,
    ) {
        at.check();
        grad.check();
        let k = &self.kernels;
        assert!(grad_vertices.len() == 3 * self.n_vertices, "{}: length", grad_vertices.label());
        assert!(grad_joints.len() == 3 * N_JOINTS, "{}: length", grad_joints.label());
        recorder.dispatch(
            &k.vertices_backward,
            &params(self.n_vertices, 0),
            &[
                &self.lbs_joints,
                &self.lbs_weights,
                &posed.transforms,
                grad_vertices,
                &posed.grad_v_posed,
                &shape.grad_v_deformed,
            ],
            linear_groups(self.n_vertices, 64),
        );
        let v_posed = posed.v_posed.as_ref().unwrap_or(&shape.v_deformed);
        recorder.dispatch(
            &k.transforms_backward,
            &params(N_JOINTS, 0),
            &[
                &self.joint_starts,
                &self.joint_vertices,
                &self.joint_weights,
                v_posed,
                grad_vertices,
                &posed.grad_transforms,
            ],
            [N_JOINTS as u32, 1, 1],
        );
        recorder.dispatch(
            &k.chain_backward,
            &params(grad.frame, 0),
            &[
                &shape.j_shaped,
                &self.skeleton,
                &posed.transforms,
                &posed.grad_transforms,
                grad_joints,
                &posed.grad_rotations,
                &shape.grad_j_shaped,
                grad.transl,
            ],
            [1, 1, 1],
        );
        if let Some(posedirs) = &self.posedirs {
            recorder.dispatch(
                &k.pose_blend_backward,
                &params(3 * self.n_vertices, 0),
                &[posedirs, &posed.grad_v_posed, &posed.grad_rotations],
                [N_FEATURES as u32, 1, 1],
            );
        }
        recorder.dispatch(
            &k.rodrigues_backward,
            &params(at.frame, grad.frame),
            &[at.poses, &posed.grad_rotations, grad.poses],
            [1, 1, 1],
        );
    }

    /// Records what is left once a batch: adds the gradients gathered in `shape` to `grad_betas` and `grad_offsets`.
    pub fn shape_backward(
        &self,
        recorder: &mut Recorder<'_>,
        shape: &ShapeState,
        grad_betas: &Buffer<f32>,
        grad_offsets: &Buffer<f32>,
    ) {
        let len = 3 * self.n_vertices;
        assert!(grad_betas.len() == self.n_betas, "{}: length", grad_betas.label());
        assert!(grad_offsets.len() == len, "{}: length", grad_offsets.label());
        recorder.dispatch(
            &self.kernels.betas_backward,
            &params(len, 3 * N_JOINTS),
            &[&self.shapedirs, &self.j_shapedirs, &shape.grad_v_deformed, &shape.grad_j_shaped, grad_betas],
            [self.n_betas as u32, 1, 1],
        );
        recorder.dispatch(
            &self.kernels.offsets_backward,
            &params(len, 0),
            &[&shape.grad_v_deformed, grad_offsets],
            linear_groups(len, 64),
        );
    }
}

/// `[N, B]` to `[B, N]`.
fn transposed(dirs: &[f32], n_betas: usize) -> Vec<f32> {
    (0..n_betas).flat_map(|b| dirs.iter().skip(b).step_by(n_betas)).copied().collect()
}

fn skeleton(parents: &[i32]) -> Vec<u32> {
    let mut subtrees: Vec<u32> = (0..parents.len()).map(|j| 1 << j).collect();
    for (j, &parent) in parents.iter().enumerate().rev() {
        if let Ok(p) = usize::try_from(parent) {
            subtrees[p] |= subtrees[j];
        }
    }
    let own = parents.iter().enumerate().map(|(j, &parent)| u32::try_from(parent).unwrap_or(j as u32));
    own.chain(subtrees).collect()
}

/// Which vertices each joint moves.
struct Influences {
    starts: Vec<u32>,
    vertices: Vec<u32>,
    weights: Vec<f32>,
}

impl Influences {
    fn of(body: &Body) -> Self {
        let mut by_joint = vec![Vec::new(); N_JOINTS];
        for (v, (joints, weights)) in body.lbs_joints.iter().zip(&body.lbs_weights).enumerate() {
            for k in 0..N_INFLUENCES {
                if weights[k] != 0.0 {
                    by_joint[joints[k] as usize].push((v as u32, weights[k]));
                }
            }
        }
        let mut starts = vec![0];
        for list in &by_joint {
            starts.push(starts[starts.len() - 1] + list.len() as u32);
        }
        let (vertices, weights) = by_joint.into_iter().flatten().unzip();
        Self { starts, vertices, weights }
    }
}
