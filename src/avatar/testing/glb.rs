//! A reader of GLB files for tests.

use glam::{Mat4, Quat, Vec3, Vec4};
use serde_json::Value;

/// A GLB read back by the rules of the format, knowing nothing of the writer.
pub(in crate::avatar) struct Glb {
    pub json: Value,
    binary: Vec<u8>,
}

impl Glb {
    pub fn parse(bytes: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let json_len = word(12);
        assert!(json_len % 4 == 0 && &bytes[16..20] == b"JSON");
        let json = serde_json::from_slice(&bytes[20..20 + json_len]).unwrap();
        let at = 20 + json_len;
        assert_eq!(&bytes[at + 4..at + 8], b"BIN\0");
        assert_eq!(at + 8 + word(at), bytes.len());
        Self { json, binary: bytes[at + 8..].to_vec() }
    }

    /// Rows of an accessor as numbers.
    pub fn accessor(&self, index: &Value) -> Vec<Vec<f32>> {
        let accessor = &self.json["accessors"][index.as_u64().unwrap() as usize];
        let view = &self.json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let offset = view["byteOffset"].as_u64().unwrap() as usize;
        let bytes = &self.binary[offset..offset + view["byteLength"].as_u64().unwrap() as usize];
        assert_eq!(offset % 4, 0);
        let numbers: Vec<f32> = match accessor["componentType"].as_u64().unwrap() {
            5121 => bytes.iter().map(|&b| b as f32).collect(),
            5125 => bytes.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b) as f32).collect(),
            5126 => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
            other => panic!("component type {other}"),
        };
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            other => panic!("type {other}"),
        };
        assert_eq!(numbers.len(), width * accessor["count"].as_u64().unwrap() as usize);
        numbers.chunks(width).map(<[f32]>::to_vec).collect()
    }

    pub fn attribute(&self, name: &str) -> Vec<Vec<f32>> {
        self.accessor(&self.json["meshes"][0]["primitives"][0]["attributes"][name])
    }

    /// World matrices of the joints at keyframe `k` of the animation, or at rest.
    pub fn joints(&self, k: Option<usize>) -> Vec<Mat4> {
        let nodes = self.json["nodes"].as_array().unwrap();
        let mut local: Vec<(Vec3, Quat)> = nodes
            .iter()
            .map(|n| {
                let t = n["translation"].as_array();
                let t = t.map_or(Vec3::ZERO, |t| Vec3::from_slice(&t.iter().map(f32_of).collect::<Vec<_>>()));
                (t, Quat::IDENTITY)
            })
            .collect();
        let animation = &self.json["animations"][0];
        for channel in animation["channels"].as_array().into_iter().flatten() {
            let Some(k) = k else { break };
            let sampler = &animation["samplers"][channel["sampler"].as_u64().unwrap() as usize];
            let value = &self.accessor(&sampler["output"])[k];
            let node = &mut local[channel["target"]["node"].as_u64().unwrap() as usize];
            match channel["target"]["path"].as_str().unwrap() {
                "translation" => node.0 = Vec3::from_slice(value),
                "rotation" => node.1 = Quat::from_slice(value),
                other => panic!("path {other}"),
            }
        }
        let mut world = vec![Mat4::NAN; nodes.len()];
        let mut stack: Vec<(usize, Mat4)> = self.json["scenes"][0]["nodes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|n| (n.as_u64().unwrap() as usize, Mat4::IDENTITY))
            .collect();
        while let Some((node, parent)) = stack.pop() {
            world[node] = parent * Mat4::from_rotation_translation(local[node].1, local[node].0);
            let children = nodes[node]["children"].as_array().into_iter().flatten();
            stack.extend(children.map(|c| (c.as_u64().unwrap() as usize, world[node])));
        }
        world
    }

    /// The skinned positions (glTF 2.0, section 3.7.3.3).
    pub fn skinned(&self, k: Option<usize>) -> Vec<Vec3> {
        let skin = &self.json["skins"][0];
        let world = self.joints(k);
        let inverse = self.accessor(&skin["inverseBindMatrices"]);
        let matrices: Vec<Mat4> = skin["joints"]
            .as_array()
            .unwrap()
            .iter()
            .zip(&inverse)
            .map(|(j, m)| world[j.as_u64().unwrap() as usize] * Mat4::from_cols_slice(m))
            .collect();
        let (positions, joints, weights) =
            (self.attribute("POSITION"), self.attribute("JOINTS_0"), self.attribute("WEIGHTS_0"));
        (0..positions.len())
            .map(|v| {
                let p = Vec3::from_slice(&positions[v]).extend(1.0);
                let sum = (0..4).map(|k| weights[v][k] * (matrices[joints[v][k] as usize] * p)).sum::<Vec4>();
                sum.truncate()
            })
            .collect()
    }
}

pub(in crate::avatar) fn f32_of(value: &Value) -> f32 {
    value.as_f64().unwrap() as f32
}
