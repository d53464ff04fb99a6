//! The avatar and its file.

use std::io::{BufReader, Cursor, Read, Seek, Write};
use std::path::Path;

use glam::{Quat, Vec3};

use super::ply::Mesh;
use super::pose::Pose;
use crate::atomic_file;
use crate::body::{Body, BodyError, N_POSE};
use crate::camera::Camera;
use crate::npz::{Npz, NpzError, NpzWriter};
use crate::ops::light::Light;
use crate::ops::skinning::cpu::{Posed, forward};
use crate::ops::texture_field::{TextureFieldConfig, TextureFieldError, TextureFieldParams};

const FORMAT_VERSION: u32 = 1;

/// Values in a file at most: the largest field and body stay far below.
const MAX_VALUES: usize = 1 << 29;

/// A fitted person: SMPL+D with a texture field and the captured motion. World space is the capture's: metres, for a
/// single camera the camera's own axes (x right, y down, z forward).
#[derive(Clone, Debug, PartialEq)]
pub struct AvatarModel {
    pub body: Body,
    /// `[B]`
    pub betas: Vec<f32>,
    /// `[V, 3]`: the paper's D, metres in the T-pose
    pub offsets: Vec<[f32; 3]>,
    /// `[V, 3]` in [0, 1]: learned texture coordinates
    pub texcoords: Vec<[f32; 3]>,
    pub texture_config: TextureFieldConfig,
    pub texture: TextureFieldParams,
    /// The light that the clip was filmed in; the texture and the face colours are the albedo under it.
    pub light: Light,
    /// `[F, 3]` sRGB in [0, 1]: stage 1's colours
    pub face_colours: Vec<[f32; 3]>,
    /// `[N, 72]`
    pub poses: Vec<Pose>,
    /// `[N, 3]`: SMPL's `transl`, of this `body`
    pub transl: Vec<[f32; 3]>,
    /// Metres in the T-pose: how far the pelvis joint of this `body` lies from that of the model it was made of
    pub pelvis_moved: [f32; 3],
    /// `[N]` indices in the video, ascending
    pub frames: Vec<u32>,
    /// Frames a second of the video
    pub fps: f64,
    /// The capture's camera
    pub camera: Camera,
}

/// Why an avatar could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    #[error("avatar file: version {0}, expected {FORMAT_VERSION}")]
    Version(f64),
    #[error("avatar file: {0}")]
    Invalid(String),
    #[error("avatar file: {0}")]
    Archive(#[from] NpzError),
    #[error("avatar file: {0}")]
    Texture(#[from] TextureFieldError),
    #[error("avatar file: {0}")]
    Body(#[from] BodyError),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// What of the file is not an array.
#[derive(serde::Serialize, serde::Deserialize)]
struct Meta {
    /// Absent in files of before there was one: their texture holds the light.
    #[serde(default = "even")]
    light: Light,
    texture_config: TextureFieldConfig,
    #[serde(default)]
    pelvis_moved: [f32; 3],
    fps: f64,
    camera: Camera,
}

fn even() -> Light {
    Light::EVEN
}

impl AvatarModel {
    /// The clothed body in the T-pose: `T + B_s β + D`, `[V, 3]`.
    pub fn rest_vertices(&self) -> Vec<[f32; 3]> {
        let shaped = self.body.shaped_vertices(&self.betas);
        shaped.iter().zip(&self.offsets).map(|(v, d)| std::array::from_fn(|k| v[k] + d[k])).collect()
    }

    /// Places of the model that the avatar's body was made of, as `motion.npz` and requests have them (SMPL's `transl`), plus this
    /// are the avatar's own, metres: a body turns about its pelvis joint, and about another one it lies as it did at another place.
    pub fn pelvis_shift(&self, pose: &Pose) -> Vec3 {
        let moved = Vec3::from(self.pelvis_moved);
        Quat::from_scaled_axis(Vec3::from_slice(pose)) * moved - moved
    }

    /// The body posed in world space.
    pub fn posed(&self, pose: &Pose, transl: [f32; 3]) -> Posed<f32> {
        forward(&self.body, &self.betas, Some(&self.offsets), pose, transl)
    }

    /// The mesh of captured frame `k` (an index into `frames`) in world space, or the T-pose; without colours. `None`
    /// where there is no such frame.
    pub fn mesh(&self, k: Option<usize>) -> Option<Mesh> {
        let vertices = match k {
            Some(k) => self.posed(self.poses.get(k)?, self.transl[k]).vertices,
            None => self.rest_vertices(),
        };
        Some(Mesh { vertices, faces: self.body.faces.clone(), colours: Vec::new() })
    }

    /// When each captured frame was taken, seconds from the first.
    pub fn times(&self) -> Vec<f32> {
        let first = self.frames.first().copied().unwrap_or(0);
        self.frames.iter().map(|&frame| (f64::from(frame - first) / self.fps) as f32).collect()
    }

    /// The place in `frames` of a frame of the video, or of the nearest kept one.
    ///
    /// # Panics
    /// When there are no frames.
    pub fn nearest_frame(&self, video_frame: u32) -> usize {
        let nearest = (0..self.frames.len()).min_by_key(|&k| self.frames[k].abs_diff(video_frame));
        nearest.expect("an avatar has at least one frame")
    }

    /// Checks what the rest of the program relies on: lengths, finite numbers, frames in order.
    pub fn check(&self) -> Result<(), ModelError> {
        let invalid = |reason: String| Err(ModelError::Invalid(reason));
        let (v, f, n) = (self.body.n_vertices(), self.body.n_faces(), self.poses.len());
        let lengths = [
            ("betas", self.betas.len(), self.body.n_betas),
            ("offsets", self.offsets.len(), v),
            ("texcoords", self.texcoords.len(), v),
            ("face_colours", self.face_colours.len(), f),
            ("transl", self.transl.len(), n),
            ("frames", self.frames.len(), n),
        ];
        for (name, have, want) in lengths {
            if have != want {
                return invalid(format!("`{name}` has {have} rows, expected {want}"));
            }
        }
        if n == 0 {
            return invalid("it has no frames".to_owned());
        }
        self.texture.validate(&self.texture_config)?;
        let t = &self.texture;
        let arrays: [(&str, &[f32]); 10] = [
            ("betas", &self.betas),
            ("offsets", self.offsets.as_flattened()),
            ("texcoords", self.texcoords.as_flattened()),
            ("face_colours", self.face_colours.as_flattened()),
            ("poses", self.poses.as_flattened()),
            ("transl", self.transl.as_flattened()),
            ("table", &t.table),
            ("w0", &t.w0),
            ("w1", &t.w1),
            ("w2", &t.w2),
        ];
        for (name, values) in arrays {
            if values.iter().any(|x| !x.is_finite()) {
                return invalid(format!("`{name}` is not finite"));
            }
        }
        if !self.frames.is_sorted_by(|a, b| a < b) {
            return invalid("`frames` is not ascending".to_owned());
        }
        if !self.light.is_sound() {
            return invalid("the light is not finite, or its direction has not length one".to_owned());
        }
        if self.pelvis_moved.iter().any(|x| !x.is_finite()) {
            return invalid("`pelvis_moved` is not finite".to_owned());
        }
        if !(self.fps.is_finite() && self.fps > 0.0) {
            return invalid(format!("fps is {}", self.fps));
        }
        Ok(())
    }

    /// Writes the avatar so that `path` holds either what it held before or the whole new file.
    pub fn save(&self, path: &Path) -> Result<(), ModelError> {
        atomic_file::replace(path, |writer| self.write(writer))
    }

    /// As [`AvatarModel::save`], to any writer.
    pub fn write(&self, out: impl Write + Seek) -> Result<(), ModelError> {
        self.check()?;
        let (v, f, n) = (self.body.n_vertices(), self.body.n_faces(), self.poses.len());
        let mut body = Cursor::new(Vec::new());
        self.body.write(&mut body)?;
        let body = body.into_inner();
        let meta = Meta {
            light: self.light,
            texture_config: self.texture_config,
            pelvis_moved: self.pelvis_moved,
            fps: self.fps,
            camera: self.camera.clone(),
        };
        let meta = serde_json::to_vec(&meta).map_err(|e| ModelError::Invalid(e.to_string()))?;
        let mut npz = NpzWriter::new(out);
        npz.add("format_version", &[], &[FORMAT_VERSION])?;
        npz.add("meta", &[meta.len()], &meta)?;
        npz.add("body", &[body.len()], &body)?;
        npz.add("betas", &[self.betas.len()], &self.betas)?;
        npz.add("offsets", &[v, 3], self.offsets.as_flattened())?;
        npz.add("texcoords", &[v, 3], self.texcoords.as_flattened())?;
        npz.add("face_colours", &[f, 3], self.face_colours.as_flattened())?;
        npz.add("poses", &[n, N_POSE], self.poses.as_flattened())?;
        npz.add("transl", &[n, 3], self.transl.as_flattened())?;
        npz.add("frames", &[n], &self.frames)?;
        let t = &self.texture;
        for (name, values) in [("table", &t.table), ("w0", &t.w0), ("w1", &t.w1), ("w2", &t.w2)] {
            npz.add(&format!("texture_{name}"), &[values.len()], values)?;
        }
        npz.finish()?.flush()?;
        Ok(())
    }

    /// Reads and checks an avatar.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        Self::read(BufReader::new(std::fs::File::open(path)?))
    }

    /// As [`AvatarModel::load`], from any reader.
    pub fn read(input: impl Read + Seek) -> Result<Self, ModelError> {
        let npz = Npz::read(input, MAX_VALUES)?;
        let version = npz.scalar("format_version")?;
        if version != f64::from(FORMAT_VERSION) {
            return Err(ModelError::Version(version));
        }
        let bytes = |name: &str| -> Result<Vec<u8>, NpzError> {
            Ok(npz.shaped(name, &[usize::MAX])?.data.iter().map(|&x| x as u8).collect())
        };
        let flat = |name: &str| -> Result<Vec<f32>, NpzError> { Ok(npz.shaped(name, &[usize::MAX])?.f32()) };
        let meta: Meta = serde_json::from_slice(&bytes("meta")?).map_err(|e| ModelError::Invalid(e.to_string()))?;
        let model = Self {
            body: Body::read(Cursor::new(bytes("body")?))?,
            betas: flat("betas")?,
            offsets: rows(&npz, "offsets")?,
            texcoords: rows(&npz, "texcoords")?,
            texture_config: meta.texture_config,
            texture: TextureFieldParams {
                table: flat("texture_table")?,
                w0: flat("texture_w0")?,
                w1: flat("texture_w1")?,
                w2: flat("texture_w2")?,
            },
            light: meta.light,
            face_colours: rows(&npz, "face_colours")?,
            poses: rows(&npz, "poses")?,
            transl: rows(&npz, "transl")?,
            pelvis_moved: meta.pelvis_moved,
            frames: npz.shaped("frames", &[usize::MAX])?.data.iter().map(|&x| x as u32).collect(),
            fps: meta.fps,
            camera: meta.camera,
        };
        model.check()?;
        Ok(model)
    }
}

/// The rows of an `[_, N]` array.
fn rows<const N: usize>(npz: &Npz, name: &str) -> Result<Vec<[f32; N]>, NpzError> {
    Ok(npz.shaped(name, &[usize::MAX, N])?.f32().as_chunks().0.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::testing::turning_avatar;

    #[test]
    fn an_avatar_comes_back_from_its_file() {
        let model = turning_avatar();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.npz");
        model.save(&path).unwrap();
        assert_eq!(AvatarModel::load(&path).unwrap(), model);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing temporary stays");
        // As any other result.
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            std::fs::write(folder.path().join("other"), "").unwrap();
            let mode = |name: &str| folder.path().join(name).metadata().unwrap().permissions().mode();
            assert_eq!(mode("model.npz"), mode("other"));
        }
    }

    #[test]
    fn what_is_not_a_whole_avatar_is_not_written() {
        let good = turning_avatar();
        let mut nan = good.clone();
        nan.poses[1][5] = f32::NAN;
        assert!(nan.write(Cursor::new(Vec::new())).unwrap_err().to_string().contains("`poses` is not finite"));
        let mut short = good.clone();
        short.offsets.pop();
        assert!(short.check().unwrap_err().to_string().contains("`offsets` has 633 rows, expected 634"));
        let mut unordered = good;
        unordered.frames.swap(0, 1);
        assert!(unordered.check().is_err());
    }

    #[test]
    fn a_truncated_file_is_an_error() {
        let mut bytes = Cursor::new(Vec::new());
        turning_avatar().write(&mut bytes).unwrap();
        let bytes = bytes.into_inner();
        assert!(AvatarModel::read(Cursor::new(&bytes[..bytes.len() / 2])).is_err());
    }
}
