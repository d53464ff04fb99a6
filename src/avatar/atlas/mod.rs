//! The texture atlas: a layout of the body's faces on a square, and the colours baked into it.

mod bake;
mod fill;
mod unwrap;

pub use bake::{BakeError, bake};

use crate::body::Body;

/// Where each face lies on the texture. glTF's convention: (0, 0) is the top left corner, v runs down.
#[derive(Clone, Debug, PartialEq)]
pub struct UvLayout {
    /// `[T, 2]` in [0, 1]
    pub uvs: Vec<[f32; 2]>,
    /// `[F, 3]`: corners of each face in `uvs`
    pub uv_faces: Vec<[u32; 3]>,
}

impl UvLayout {
    /// The body's own layout where it has one inside [0, 1], else one made from its T-pose: charts of faces that look
    /// the same way, packed with the head larger.
    pub fn of_body(body: &Body) -> Self {
        let inside = body.uvs.iter().flatten().all(|x| (0.0..=1.0).contains(x));
        if !body.uvs.is_empty() && inside {
            Self { uvs: body.uvs.clone(), uv_faces: body.uv_faces.clone() }
        } else {
            unwrap::unwrap(body)
        }
    }
}
