//! The losses that look at the mesh itself, in the T-pose: normal consistency and face areas (paper §3.5), and the
//! smoothness of D.

use glam::Vec3;

use super::config::Weights;
use super::losses::{Losses, Term};
use crate::body::Body;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::ops::face_area::FaceArea;
use crate::ops::face_normals::FaceNormals;
use crate::ops::laplacian::Laplacian;
use crate::ops::normal_consistency::NormalConsistency;
use crate::ops::skinning::ShapeState;
use crate::ops::topology::Topology;

/// Faces below this part of the mean area count in no loss of faces: their gradients grow as they shrink, and one second moment
/// for all of D lets them rule its steps. Of the default body 16 of 13,998 are; with its toes closed to caps and
/// its ears gone ([`super::covered`]) 463, nearly all at the toes.
const LEAST_AREA: f32 = 0.01;

/// Twice the mean area of a body's faces, and of each face.
fn doubled_areas(body: &Body) -> (f32, Vec<f32>) {
    let doubled = |&[a, b, c]: &[u32; 3]| {
        let [a, b, c] = [a, b, c].map(|v| Vec3::from(body.v_template[v as usize]));
        (b - a).cross(c - a).length()
    };
    let each: Vec<f32> = body.faces.iter().map(doubled).collect();
    (each.iter().sum::<f32>() / each.len().max(1) as f32, each)
}

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

impl MeshLosses {
    pub fn new(gpu: &Gpu, body: &Body, topology: &Topology) -> Self {
        let face_normals = FaceNormals::new(gpu, &body.faces, topology);
        let (mean, doubled) = doubled_areas(body);
        let least = LEAST_AREA * mean;
        let of_large = topology.with_pairs_of(|f| doubled[f as usize] > least);
        Self {
            normals: face_normals.normals(gpu, "fit/normals"),
            rest_normals: face_normals.normals(gpu, "fit/rest_normals"),
            grad_normals: face_normals.normals(gpu, "fit/grad_normals"),
            normal_consistency: NormalConsistency::new(gpu, &of_large),
            face_area: FaceArea::new(gpu, body.n_faces(), least),
            laplacian: Laplacian::new(gpu, topology),
            face_normals,
            n_faces: body.n_faces(),
            n_vertices: body.n_vertices(),
        }
    }

    /// Records values and gradients; adds to `shape.grad_v_deformed` and `grad_offsets`.
    pub fn record(
        &self,
        recorder: &mut Recorder<'_>,
        weights: &Weights,
        shape: &ShapeState,
        offsets: &Buffer<f32>,
        grad_offsets: &Buffer<f32>,
        losses: &Losses,
    ) {
        if weights.normal_consistency != 0.0 || weights.face_area != 0.0 {
            self.record_faces(recorder, weights, shape, losses);
        }
        if weights.laplacian != 0.0 {
            self.laplacian.forward(recorder, offsets, losses.slot(Term::Laplacian));
            // In square centimetres a vertex.
            self.laplacian.backward(recorder, weights.laplacian * 1e4 / self.n_vertices as f32, grad_offsets);
        }
    }

    fn record_faces(&self, recorder: &mut Recorder<'_>, weights: &Weights, shape: &ShapeState, losses: &Losses) {
        let Self { normals, rest_normals, grad_normals, .. } = self;
        let n = self.n_faces as f32;
        self.face_normals.forward(recorder, &shape.v_deformed, normals);
        recorder.clear(grad_normals);
        if weights.normal_consistency != 0.0 {
            self.normal_consistency.forward(recorder, normals, losses.slot(Term::NormalConsistency));
            self.normal_consistency.backward(recorder, normals, weights.normal_consistency / n, grad_normals);
        }
        if weights.face_area != 0.0 {
            self.face_normals.forward(recorder, &shape.v_shaped, rest_normals);
            self.face_area.forward(recorder, normals, rest_normals, losses.slot(Term::FaceArea));
            self.face_area.backward(recorder, normals, rest_normals, weights.face_area / n, grad_normals);
        }
        self.face_normals.backward(recorder, &shape.v_deformed, grad_normals, &shape.grad_v_deformed);
    }
}
