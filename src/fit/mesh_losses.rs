//! The losses that look at the mesh itself, in the T-pose: normal consistency and face areas (paper §3.5), and the
//! smoothness of D.

use super::config::Weights;
use crate::body::Body;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::ops::LossSlot;
use crate::ops::face_area::FaceArea;
use crate::ops::face_normals::FaceNormals;
use crate::ops::laplacian::Laplacian;
use crate::ops::normal_consistency::NormalConsistency;
use crate::ops::skinning::ShapeState;
use crate::ops::topology::Topology;

/// The three losses with their scratch.
pub struct MeshLosses {
    face_normals: FaceNormals,
    normal_consistency: NormalConsistency,
    face_area: FaceArea,
    laplacian: Laplacian,
    normals: Buffer<f32>,
    rest_normals: Buffer<f32>,
    grad_normals: Buffer<f32>,
    n_faces: usize,
    n_vertices: usize,
}

/// Where the values go.
#[derive(Clone, Copy)]
pub struct MeshSlots {
    pub normal_consistency: usize,
    pub face_area: usize,
    pub laplacian: usize,
}

impl MeshLosses {
    pub fn new(gpu: &Gpu, body: &Body, topology: &Topology) -> Self {
        let face_normals = FaceNormals::new(gpu, &body.faces, topology);
        Self {
            normals: face_normals.normals(gpu, "fit/normals"),
            rest_normals: face_normals.normals(gpu, "fit/rest_normals"),
            grad_normals: face_normals.normals(gpu, "fit/grad_normals"),
            normal_consistency: NormalConsistency::new(gpu, topology),
            face_area: FaceArea::new(gpu, body.n_faces()),
            laplacian: Laplacian::new(gpu, topology),
            face_normals,
            n_faces: body.n_faces(),
            n_vertices: body.n_vertices(),
        }
    }

    /// Records values and gradients; adds to `shape.grad_v_deformed` and `grad_offsets`.
    #[expect(clippy::too_many_arguments, reason = "the operands of three losses")]
    pub fn record(
        &self,
        recorder: &mut Recorder<'_>,
        weights: &Weights,
        shape: &ShapeState,
        offsets: &Buffer<f32>,
        grad_offsets: &Buffer<f32>,
        losses: &Buffer<f32>,
        slots: MeshSlots,
    ) {
        let slot = |index| LossSlot::new(losses, index);
        let Self { normals, rest_normals, grad_normals, .. } = self;
        self.face_normals.forward(recorder, &shape.v_deformed, normals);
        self.face_normals.forward(recorder, &shape.v_shaped, rest_normals);
        recorder.clear(grad_normals);
        self.normal_consistency.forward(recorder, normals, slot(slots.normal_consistency));
        self.normal_consistency.backward(
            recorder,
            normals,
            weights.normal_consistency / self.n_faces as f32,
            grad_normals,
        );
        self.face_area.forward(recorder, normals, rest_normals, slot(slots.face_area));
        self.face_area.backward(recorder, normals, rest_normals, weights.face_area / self.n_faces as f32, grad_normals);
        self.face_normals.backward(recorder, &shape.v_deformed, grad_normals, &shape.grad_v_deformed);
        self.laplacian.forward(recorder, offsets, slot(slots.laplacian));
        // In square centimetres a vertex.
        self.laplacian.backward(recorder, weights.laplacian * 1e4 / self.n_vertices as f32, grad_offsets);
    }
}
