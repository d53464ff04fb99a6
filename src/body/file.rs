//! The body's file: one npz archive, `<name>.body.npz`, whose arrays bear the names of [`Body`]'s fields.
//!
//! Numbers are f32, u32 and i32; the name and the keypoint sets (JSON) are UTF-8 bytes. Optional arrays are left out
//! where they are empty.

use std::io::{BufReader, Read, Seek, Write};
use std::path::Path;

use super::check::InvalidBody;
use super::{Body, KeypointSet, N_INFLUENCES, N_JOINTS};
use crate::atomic_file;
use crate::npz::{Array, Npz, NpzError, NpzWriter};

/// Grows with every change that an older reader would misread.
const FORMAT_VERSION: u32 = 1;

/// Bodies hold a few million values; this bounds what a damaged file can make us allocate.
const MAX_VALUES: usize = 1 << 27;

/// Why a body could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum BodyError {
    #[error(transparent)]
    Npz(#[from] NpzError),
    #[error(transparent)]
    Invalid(#[from] InvalidBody),
    #[error("body format version {0}, expected {FORMAT_VERSION}")]
    Version(f64),
    #[error("body array `{array}`: {reason}")]
    Text { array: &'static str, reason: String },
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

const ANY: usize = usize::MAX;

fn triples<T: Copy>(flat: &[T]) -> Vec<[T; 3]> {
    flat.as_chunks().0.to_vec()
}

fn u32s(array: &Array) -> Vec<u32> {
    array.data.iter().map(|&x| x as u32).collect()
}

fn text(npz: &Npz, array: &'static str) -> Result<String, BodyError> {
    let bytes = npz.shaped(array, &[ANY])?.data.iter().map(|&x| x as u8).collect();
    String::from_utf8(bytes).map_err(|e| BodyError::Text { array, reason: e.to_string() })
}

/// The array, or an empty one where the file leaves it out.
fn optional(npz: &Npz, name: &str, shape: &[usize]) -> Result<Array, NpzError> {
    if npz.arrays.contains_key(name) { npz.shaped(name, shape).cloned() } else { Ok(Array::new(&[0], Vec::new())) }
}

impl Body {
    /// Reads and checks a body.
    pub fn load(path: &Path) -> Result<Body, BodyError> {
        Body::read(BufReader::new(std::fs::File::open(path)?))
    }

    /// As [`Body::load`], from an archive inside something else.
    pub fn read(reader: impl Read + Seek) -> Result<Body, BodyError> {
        let npz = Npz::read(reader, MAX_VALUES)?;
        let version = npz.scalar("format_version")?;
        if version != f64::from(FORMAT_VERSION) {
            return Err(BodyError::Version(version));
        }
        let keypoints = text(&npz, "keypoints")?;
        let keypoints: Vec<KeypointSet> = serde_json::from_str(&keypoints)
            .map_err(|e| BodyError::Text { array: "keypoints", reason: e.to_string() })?;

        let v_template = npz.shaped("v_template", &[ANY, 3])?;
        let n_vertices = v_template.shape[0];
        let shapedirs = npz.shaped("shapedirs", &[n_vertices, 3, ANY])?;
        let n_betas = shapedirs.shape[2];
        let joints = u32s(npz.shaped("lbs_joints", &[n_vertices, N_INFLUENCES])?);
        let weights = npz.shaped("lbs_weights", &[n_vertices, N_INFLUENCES])?.f32();
        let body = Body {
            name: text(&npz, "name")?,
            v_template: triples(&v_template.f32()),
            shapedirs: shapedirs.f32(),
            posedirs: optional(&npz, "posedirs", &[(N_JOINTS - 1) * 9, n_vertices * 3])?.f32(),
            j_template: triples(&npz.shaped("j_template", &[N_JOINTS, 3])?.f32()),
            j_shapedirs: npz.shaped("j_shapedirs", &[N_JOINTS, 3, n_betas])?.f32(),
            n_betas,
            parents: npz.shaped("parents", &[N_JOINTS])?.data.iter().map(|&p| p as i32).collect(),
            lbs_joints: joints.as_chunks().0.to_vec(),
            lbs_weights: weights.as_chunks().0.to_vec(),
            faces: triples(&u32s(npz.shaped("faces", &[ANY, 3])?)),
            uvs: optional(&npz, "uvs", &[ANY, 2])?.f32().as_chunks().0.to_vec(),
            uv_faces: triples(&u32s(&optional(&npz, "uv_faces", &[ANY, 3])?)),
            mirror: u32s(npz.shaped("mirror", &[n_vertices])?),
            keypoints,
        };
        body.check()?;
        Ok(body)
    }

    /// Writes the body so that `path` holds either what it held before or the whole new file.
    pub fn save(&self, path: &Path) -> Result<(), BodyError> {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder)?;
        atomic_file::replace(path, |writer| self.write(writer))
    }

    /// As [`Body::save`], into an archive inside something else.
    pub fn write(&self, writer: impl Write + Seek) -> Result<(), BodyError> {
        self.check()?;
        let (v, b) = (self.n_vertices(), self.n_betas);
        let keypoints = serde_json::to_vec(&self.keypoints)
            .map_err(|e| BodyError::Text { array: "keypoints", reason: e.to_string() })?;
        let mut npz = NpzWriter::new(writer);
        npz.add("format_version", &[], &[FORMAT_VERSION])?;
        npz.add("name", &[self.name.len()], self.name.as_bytes())?;
        npz.add("v_template", &[v, 3], self.v_template.as_flattened())?;
        npz.add("shapedirs", &[v, 3, b], &self.shapedirs)?;
        if !self.posedirs.is_empty() {
            npz.add("posedirs", &[(N_JOINTS - 1) * 9, v * 3], &self.posedirs)?;
        }
        npz.add("j_template", &[N_JOINTS, 3], self.j_template.as_flattened())?;
        npz.add("j_shapedirs", &[N_JOINTS, 3, b], &self.j_shapedirs)?;
        npz.add("parents", &[N_JOINTS], &self.parents)?;
        npz.add("lbs_joints", &[v, N_INFLUENCES], self.lbs_joints.as_flattened())?;
        npz.add("lbs_weights", &[v, N_INFLUENCES], self.lbs_weights.as_flattened())?;
        npz.add("faces", &[self.n_faces(), 3], self.faces.as_flattened())?;
        if !self.uvs.is_empty() {
            npz.add("uvs", &[self.uvs.len(), 2], self.uvs.as_flattened())?;
            npz.add("uv_faces", &[self.n_faces(), 3], self.uv_faces.as_flattened())?;
        }
        npz.add("mirror", &[v], &self.mirror)?;
        npz.add("keypoints", &[keypoints.len()], &keypoints)?;
        npz.finish()?.flush()?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn bytes(body: &Body) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        body.write(&mut out).unwrap();
        out.into_inner()
    }

    #[test]
    fn a_body_comes_back_as_it_went_in() {
        let mut body = Body::test_body();
        body.name = "Zoë".to_owned();
        assert_eq!(Body::read(Cursor::new(bytes(&body))).unwrap(), body);
        (body.uvs, body.uv_faces) = (Vec::new(), Vec::new());
        body.posedirs = (0..207 * body.n_vertices() * 3).map(|i| (i % 7) as f32).collect();
        assert_eq!(Body::read(Cursor::new(bytes(&body))).unwrap(), body);
    }

    #[test]
    fn the_same_body_makes_the_same_bytes() {
        assert_eq!(bytes(&Body::test_body()), bytes(&Body::test_body()));
    }

    #[test]
    fn a_file_is_replaced_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bodies/test.body.npz");
        let mut body = Body::test_body();
        body.save(&path).unwrap();
        body.faces.clear();
        let error = body.save(&path).unwrap_err().to_string();
        assert!(error.contains("`uv_faces`"), "{error}");
        assert_eq!(Body::load(&path).unwrap(), Body::test_body());
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn an_array_of_another_shape_and_another_version_are_refused() {
        let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
        npz.add("format_version", &[], &[2u32]).unwrap();
        let error = Body::read(npz.finish().unwrap()).unwrap_err().to_string();
        assert_eq!(error, "body format version 2, expected 1");

        let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
        npz.add("format_version", &[], &[FORMAT_VERSION]).unwrap();
        npz.add("keypoints", &[2], b"[]").unwrap();
        npz.add("v_template", &[3, 2], &[0.0f32; 6]).unwrap();
        let error = Body::read(npz.finish().unwrap()).unwrap_err().to_string();
        assert_eq!(error, "array `v_template`: shape [3, 2], expected [any, 3]");
    }
}
