//! The binary part of a GLB: accessors over one buffer, each in a view of its own, 4-byte aligned.

use serde_json::{Value, json};

const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// What a view is for; vertex data and indices name their target, as the validator wants.
#[derive(Clone, Copy)]
pub(super) enum Use {
    Vertex,
    Index,
    Other,
}

/// Buffer views and accessors in the order in which they were added.
#[derive(Default)]
pub(super) struct Buffers {
    pub bytes: Vec<u8>,
    pub views: Vec<Value>,
    pub accessors: Vec<Value>,
}

impl Buffers {
    /// A view of raw bytes; its index.
    pub fn view(&mut self, data: &[u8], usage: Use) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": data.len() });
        match usage {
            Use::Vertex => view["target"] = ARRAY_BUFFER.into(),
            Use::Index => view["target"] = ELEMENT_ARRAY_BUFFER.into(),
            Use::Other => {}
        }
        self.bytes.extend(data);
        self.views.push(view);
        self.views.len() - 1
    }

    /// `SCALAR`, `VEC2`, `VEC3`, `VEC4` or `MAT4` of floats by N, with the bounds of each component; its index.
    pub fn floats<const N: usize>(&mut self, data: &[[f32; N]], usage: Use) -> usize {
        let kind = match N {
            1 => "SCALAR",
            2 => "VEC2",
            3 => "VEC3",
            4 => "VEC4",
            16 => "MAT4",
            _ => unreachable!("glTF has no vector of {N}"),
        };
        let view = self.view(bytemuck::cast_slice(data.as_flattened()), usage);
        let bound = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
            (0..N).map(|k| data.iter().map(|row| row[k]).reduce(pick).unwrap_or(0.0)).collect()
        };
        self.accessors.push(json!({
            "bufferView": view, "componentType": FLOAT, "count": data.len(), "type": kind,
            "min": bound(f32::min), "max": bound(f32::max),
        }));
        self.accessors.len() - 1
    }

    /// Four joint indices a vertex; the accessor's index.
    pub fn joints(&mut self, data: &[[u8; 4]]) -> usize {
        let view = self.view(data.as_flattened(), Use::Vertex);
        self.accessors
            .push(json!({ "bufferView": view, "componentType": UNSIGNED_BYTE, "count": data.len(), "type": "VEC4" }));
        self.accessors.len() - 1
    }

    /// Triangle indices; the accessor's index.
    pub fn indices(&mut self, faces: &[[u32; 3]]) -> usize {
        let view = self.view(bytemuck::cast_slice(faces.as_flattened()), Use::Index);
        let max = faces.iter().flatten().max();
        self.accessors.push(json!({
            "bufferView": view, "componentType": UNSIGNED_INT, "count": faces.len() * 3, "type": "SCALAR",
            "min": [0], "max": [max],
        }));
        self.accessors.len() - 1
    }
}

/// Joins the JSON and the binary chunk (glTF 2.0, section 4.4).
pub(super) fn container(json: &Value, mut binary: Vec<u8>) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let mut out = Vec::with_capacity(total);
    let words = |out: &mut Vec<u8>, words: &[u32]| out.extend(words.iter().flat_map(|w| w.to_le_bytes()));
    words(&mut out, &[u32::from_le_bytes(*b"glTF"), 2, total as u32]);
    words(&mut out, &[text.len() as u32, u32::from_le_bytes(*b"JSON")]);
    out.extend(text);
    words(&mut out, &[binary.len() as u32, u32::from_le_bytes(*b"BIN\0")]);
    out.extend(binary);
    out
}
