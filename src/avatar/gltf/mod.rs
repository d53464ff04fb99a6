//! The avatar as a glTF 2.0 binary: a skinned mesh in the T-pose with 24 named joints, the albedo in an unlit
//! material and, as a variant, in a lit one, and the captured motion. Pose blend shapes are not exported: glTF has no
//! counterpart for them.
//!
//! glTF's world has +Y up and the person faces +Z, standing on y = 0. A capture's world is OpenCV's camera (y down), so
//! the motion is turned by 180° about x and moved so that the feet are near the ground and the path is centred; the
//! matrix is kept in `asset.extras` as `gltf_from_world` (row-major).

mod buffer;
mod motion;
#[cfg(test)]
mod tests;

use std::collections::HashMap;

use glam::Vec3;
use serde_json::{Value, json};

use self::buffer::{Buffers, Use, container};
use self::motion::{Motion, convert};
use super::{AvatarModel, UvLayout, pose};
use crate::body::{JOINT_NAMES, N_JOINTS};

/// An encoded picture.
pub struct Texture<'a> {
    pub bytes: &'a [u8],
    /// `image/png` or `image/jpeg`
    pub mime: &'a str,
}

/// The vertices of the file: one for each pair of a body vertex and a texture corner, in the order of the faces.
struct Split {
    /// `[S]`: vertex of the body, corner of the layout
    corners: Vec<[u32; 2]>,
    /// `[F, 3]`
    faces: Vec<[u32; 3]>,
}

fn split(faces: &[[u32; 3]], layout: &UvLayout) -> Split {
    let mut known = HashMap::new();
    let mut out = Split { corners: Vec::new(), faces: Vec::with_capacity(faces.len()) };
    for (face, uv_face) in faces.iter().zip(&layout.uv_faces) {
        out.faces.push(std::array::from_fn(|k| {
            let corner = [face[k], uv_face[k]];
            *known.entry(corner).or_insert_with(|| {
                out.corners.push(corner);
                out.corners.len() as u32 - 1
            })
        }));
    }
    out
}

/// Influences of a vertex as glTF wants them: each joint once, joint 0 where the weight is zero, summing to one.
fn influences(joints: [u32; 4], weights: [f32; 4]) -> ([u8; 4], [f32; 4]) {
    let (mut out_joints, mut out_weights, mut n) = ([0u8; 4], [0f32; 4], 0);
    for (joint, weight) in joints.into_iter().zip(weights).filter(|(_, w)| *w > 0.0) {
        let known = out_joints[..n].iter().position(|&j| j as u32 == joint);
        let at = known.unwrap_or(n);
        n = n.max(at + 1);
        out_joints[at] = joint as u8;
        out_weights[at] += weight;
    }
    let sum: f32 = out_weights.iter().sum();
    (out_joints, out_weights.map(|w| w / sum))
}

/// Builds `avatar.glb`.
///
/// # Panics
/// When the layout has another number of faces than the body, or the model has no frames.
pub fn write_glb(model: &AvatarModel, layout: &UvLayout, texture: &Texture<'_>) -> Vec<u8> {
    let mut file = Rigged::new(model, layout, texture);
    let motion = convert(model);
    file.document["asset"]["extras"] = json!({
        "gltf_from_world": motion.gltf_from_world.transpose().to_cols_array(),
        "body": model.body.name,
        "video_frames": model.frames,
    });
    file.document["animations"] = json!([animation(&mut file.buffers, &motion)]);
    file.add_lit_variant();
    file.into_bytes()
}

/// The avatar in its T-pose, textured and rigged: what every file has that is built on glTF. Joint j is node j.
pub(super) struct Rigged {
    /// Without what tells of the buffers.
    pub document: Value,
    buffers: Buffers,
}

impl Rigged {
    /// # Panics
    /// When the layout has another number of faces than the body.
    pub fn new(model: &AvatarModel, layout: &UvLayout, texture: &Texture<'_>) -> Self {
        let body = &model.body;
        assert_eq!(body.faces.len(), layout.uv_faces.len(), "faces of body and texture layout");
        let rest = model.rest_vertices();
        let split = split(&body.faces, layout);
        let floor = split.corners.iter().map(|c| rest[c[0] as usize][1]).fold(f32::INFINITY, f32::min);
        let up = |p: [f32; 3]| [p[0], p[1] - floor, p[2]];
        let joints: Vec<[f32; 3]> = body.shaped_joints(&model.betas).into_iter().map(up).collect();

        let mut buffers = Buffers::default();
        let primitive = primitive(&mut buffers, model, layout, &split, &rest, up);
        let inverse_bind: Vec<[f32; 16]> =
            joints.iter().map(|&j| glam::Mat4::from_translation(-Vec3::from(j)).to_cols_array()).collect();
        let inverse_bind = buffers.floats(&inverse_bind, Use::Other);
        let document = json!({
            "asset": { "version": "2.0", "generator": concat!("Effigy ", env!("CARGO_PKG_VERSION")) },
            "extensionsUsed": ["KHR_materials_unlit"],
            "scene": 0,
            "scenes": [{ "name": "avatar", "nodes": [0, N_JOINTS] }],
            "nodes": nodes(&body.parents, &joints),
            "meshes": [{ "name": "body", "primitives": [primitive] }],
            "skins": [{
                "name": "skeleton", "skeleton": 0, "inverseBindMatrices": inverse_bind,
                "joints": (0..N_JOINTS).collect::<Vec<_>>(),
            }],
            "materials": [{
                "name": "captured",
                "pbrMetallicRoughness": {
                    "baseColorTexture": { "index": 0 }, "metallicFactor": 0.0, "roughnessFactor": 0.9,
                },
                "extensions": { "KHR_materials_unlit": {} },
            }],
            "textures": [{ "source": 0, "sampler": 0 }],
            "samplers": [{ "magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071 }],
            "images": [],
        });
        let mut file = Self { document, buffers };
        file.image("texture", texture);
        file
    }

    /// The same material for a scene's lights, to choose instead: programs that know no variants show the unlit one.
    /// <https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_materials_variants>
    fn add_lit_variant(&mut self) {
        const EXTENSION: &str = "KHR_materials_variants";
        let document = &mut self.document;
        let mut lit = document["materials"][0].clone();
        lit["name"] = "lit".into();
        lit.as_object_mut().expect("a material is an object").remove("extensions");
        let materials = document["materials"].as_array_mut().expect("a document has materials");
        materials.push(lit);
        let names: Vec<Value> = materials.iter().map(|material| json!({ "name": material["name"] })).collect();
        let mappings: Vec<Value> = (0..names.len()).map(|k| json!({ "material": k, "variants": [k] })).collect();
        document["extensions"] = json!({ EXTENSION: { "variants": names } });
        document["meshes"][0]["primitives"][0]["extensions"] = json!({ EXTENSION: { "mappings": mappings } });
        document["extensionsUsed"].as_array_mut().expect("a document uses extensions").push(EXTENSION.into());
    }

    /// Adds a picture; its index.
    pub fn image(&mut self, name: &str, image: &Texture<'_>) -> usize {
        let view = self.buffers.view(image.bytes, Use::Other);
        let images = self.document["images"].as_array_mut().expect("a document has images");
        images.push(json!({ "name": name, "bufferView": view, "mimeType": image.mime }));
        images.len() - 1
    }

    /// The whole file.
    pub fn into_bytes(self) -> Vec<u8> {
        let Self { mut document, buffers } = self;
        document["bufferViews"] = buffers.views.into();
        document["accessors"] = buffers.accessors.into();
        document["buffers"] = json!([{ "byteLength": buffers.bytes.len() }]);
        container(&document, buffers.bytes)
    }
}

/// Node j is joint j, node 24 the mesh. Joint nodes carry translations only: every joint frame is parallel to the world
/// in the zero pose.
fn nodes(parents: &[i32], joints: &[[f32; 3]]) -> Vec<Value> {
    let mut nodes: Vec<Value> = (0..N_JOINTS)
        .map(|j| {
            let parent = usize::try_from(parents[j]).map_or(Vec3::ZERO, |p| Vec3::from(joints[p]));
            let children: Vec<usize> = (0..N_JOINTS).filter(|&c| parents[c] == j as i32).collect();
            let mut node =
                json!({ "name": JOINT_NAMES[j], "translation": (Vec3::from(joints[j]) - parent).to_array() });
            if !children.is_empty() {
                node["children"] = children.into();
            }
            node
        })
        .collect();
    nodes.push(json!({ "name": "avatar", "mesh": 0, "skin": 0 }));
    nodes
}

fn primitive(
    buffers: &mut Buffers,
    model: &AvatarModel,
    layout: &UvLayout,
    split: &Split,
    rest: &[[f32; 3]],
    up: impl Fn([f32; 3]) -> [f32; 3],
) -> Value {
    let body = &model.body;
    let normals = pose::vertex_normals(rest, &body.faces);
    let of_vertex =
        |values: &[[f32; 3]]| -> Vec<[f32; 3]> { split.corners.iter().map(|c| values[c[0] as usize]).collect() };
    let positions: Vec<[f32; 3]> = of_vertex(rest).into_iter().map(up).collect();
    let uvs: Vec<[f32; 2]> = split.corners.iter().map(|c| layout.uvs[c[1] as usize]).collect();
    let (joints, weights): (Vec<_>, Vec<_>) = split
        .corners
        .iter()
        .map(|c| influences(body.lbs_joints[c[0] as usize], body.lbs_weights[c[0] as usize]))
        .unzip();
    json!({
        "attributes": {
            "POSITION": buffers.floats(&positions, Use::Vertex),
            "NORMAL": buffers.floats(&of_vertex(&normals), Use::Vertex),
            "TEXCOORD_0": buffers.floats(&uvs, Use::Vertex),
            "JOINTS_0": buffers.joints(&joints),
            "WEIGHTS_0": buffers.floats(&weights, Use::Vertex),
        },
        "indices": buffers.indices(&split.faces),
        "material": 0,
        "mode": 4,
    })
}

fn animation(buffers: &mut Buffers, motion: &Motion) -> Value {
    let input = buffers.floats(&motion.times.iter().map(|&t| [t]).collect::<Vec<_>>(), Use::Other);
    let (mut samplers, mut channels) = (Vec::new(), Vec::new());
    let mut add = |output: usize, node: usize, path: &str| {
        channels.push(json!({ "sampler": samplers.len(), "target": { "node": node, "path": path } }));
        samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
    };
    add(buffers.floats(&motion.root, Use::Other), 0, "translation");
    for (j, rotations) in motion.rotations.iter().enumerate() {
        add(buffers.floats(rotations, Use::Other), j, "rotation");
    }
    json!({ "name": "captured", "samplers": samplers, "channels": channels })
}
