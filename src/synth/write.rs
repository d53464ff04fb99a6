//! The files of a made clip.

use std::fs::File;
use std::io::{BufWriter, Cursor, Write};
use std::path::{Path, PathBuf};

use image::{GrayImage, ImageFormat, Luma, RgbImage};
use serde_json::json;

use super::{SynthError, SynthOptions};
use crate::avatar::Pose;
use crate::avatar::ply::{self, Mesh};
use crate::body::{Body, JOINT_NAMES};
use crate::camera::Camera;
use crate::mask;
use crate::novel::{NovelEntry, NovelFile};
use crate::npz::NpzWriter;
use crate::video_writer::{Quality, VideoWriter};

/// Writes a folder piece by piece.
pub(super) struct FolderWriter {
    folder: PathBuf,
    video: VideoWriter,
    masks: zip::ZipWriter<BufWriter<File>>,
    keypoints: Vec<Vec<[f64; 3]>>,
    poses: Vec<Pose>,
    joints: Vec<Vec<[f32; 3]>>,
    novel: NovelFile,
}

impl FolderWriter {
    /// A clip of this body. What an earlier call made in the folder goes.
    pub fn create(folder: &Path, body: &Body, options: &SynthOptions) -> Result<Self, SynthError> {
        clear(folder)?;
        std::fs::create_dir_all(folder.join("truth"))?;
        std::fs::create_dir_all(folder.join("novel"))?;
        // First of all, so that a clip that was interrupted can be made anew.
        let about = json!({ "made_by": MADE_BY, "body": body.name, "options": options });
        std::fs::write(folder.join(ABOUT), about.to_string())?;
        let size = options.filming.size(options.size_px);
        Ok(Self {
            video: VideoWriter::create(&folder.join("video.mp4"), size, options.fps, Quality::Fine)?,
            masks: zip::ZipWriter::new(BufWriter::new(File::create(folder.join("masks.zip"))?)),
            folder: folder.to_owned(),
            keypoints: Vec::new(),
            poses: Vec::new(),
            joints: Vec::new(),
            novel: NovelFile::default(),
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn json(&self, name: &str, value: &serde_json::Value) -> Result<(), SynthError> {
        Ok(serde_json::to_writer(BufWriter::new(File::create(self.path(name))?), value)?)
    }

    /// The clothed T-pose.
    pub fn canonical(&self, body: &Body, rest: &[[f32; 3]]) -> Result<(), SynthError> {
        self.mesh("truth/canonical.ply", body, rest)
    }

    /// The posed surface of frame `i`, camera space.
    pub fn surface(&self, i: usize, body: &Body, vertices: &[[f32; 3]]) -> Result<(), SynthError> {
        self.mesh(&format!("truth/frame_{i:04}.ply"), body, vertices)
    }

    fn mesh(&self, name: &str, body: &Body, vertices: &[[f32; 3]]) -> Result<(), SynthError> {
        let mesh = Mesh { vertices: vertices.to_vec(), faces: body.faces.clone(), colours: Vec::new() };
        Ok(ply::write(&mesh, File::create(self.path(name))?)?)
    }

    /// The next frame of the video with its mask, keypoints and truth.
    pub fn frame(
        &mut self,
        image: &RgbImage,
        coverage: &GrayImage,
        pose: &Pose,
        joints: &[[f32; 3]],
        keypoints: Vec<[f64; 3]>,
    ) -> Result<(), SynthError> {
        if self.poses.is_empty() {
            image.save(self.path("frame_0000.png"))?;
        }
        self.video.push(image)?;
        let mut png = Cursor::new(Vec::new());
        binary(coverage).write_to(&mut png, ImageFormat::Png)?;
        let stored = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Stored)
            .last_modified_time(zip::DateTime::default());
        self.masks.start_file(format!("masks/{:04}.png", self.poses.len()), stored)?;
        self.masks.write_all(png.get_ref())?;
        self.poses.push(*pose);
        self.joints.push(joints.to_vec());
        self.keypoints.push(keypoints);
        Ok(())
    }

    pub fn novel_view(
        &mut self,
        k: usize,
        camera: &Camera,
        image: &RgbImage,
        coverage: &GrayImage,
    ) -> Result<(), SynthError> {
        let entry = NovelEntry::of_frame(0, camera);
        let entry = self.pictures(&format!("view_{k:02}"), entry, image, coverage)?;
        self.novel.views.push(entry);
        Ok(())
    }

    pub fn novel_pose(&mut self, entry: NovelEntry, image: &RgbImage, coverage: &GrayImage) -> Result<(), SynthError> {
        let entry = self.pictures(&format!("pose_{:02}", self.novel.poses.len()), entry, image, coverage)?;
        self.novel.poses.push(entry);
        Ok(())
    }

    fn pictures(
        &self,
        name: &str,
        mut entry: NovelEntry,
        image: &RgbImage,
        coverage: &GrayImage,
    ) -> Result<NovelEntry, SynthError> {
        (entry.image, entry.mask) = (format!("{name}.png"), format!("{name}_mask.png"));
        image.save(self.folder.join("novel").join(&entry.image))?;
        binary(coverage).save(self.folder.join("novel").join(&entry.mask))?;
        Ok(entry)
    }

    /// Everything that is known only at the end.
    pub fn finish(mut self, body: &Body, betas: &[f32], camera: &Camera) -> Result<(), SynthError> {
        let keypoints = std::mem::take(&mut self.keypoints);
        self.json("keypoints.json", &json!({ "format": "coco17", "frames": keypoints }))?;
        self.json(
            "camera.json",
            &json!({
                "width": camera.width, "height": camera.height,
                "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
            }),
        )?;
        self.json("truth/joints3d.json", &json!({ "names": JOINT_NAMES, "frames": self.joints }))?;
        self.json("novel/novel.json", &json!(self.novel))?;
        let pelvis = |joints: &Vec<[f32; 3]>| joints[0];
        let trans: Vec<[f32; 3]> = self.joints.iter().map(pelvis).collect();
        self.poses("truth/poses.npz", &self.poses, &trans, Some((body, betas)))?;
        let novel: (Vec<Pose>, Vec<[f32; 3]>) =
            self.novel.poses.iter().filter_map(|e| Some((Pose::try_from(e.pose.as_deref()?).ok()?, e.trans?))).unzip();
        self.poses("novel/poses.npz", &novel.0, &novel.1, None)?;
        self.masks.finish()?;
        Ok(self.video.finish()?)
    }

    /// `trans` is the pelvis joint's position.
    fn poses(
        &self,
        name: &str,
        poses: &[Pose],
        trans: &[[f32; 3]],
        shape: Option<(&Body, &[f32])>,
    ) -> Result<(), SynthError> {
        let mut npz = NpzWriter::new(BufWriter::new(File::create(self.path(name))?));
        npz.add("poses", &[poses.len(), 72], poses.as_flattened())?;
        npz.add("trans", &[trans.len(), 3], trans.as_flattened())?;
        if let Some((body, betas)) = shape {
            npz.add("betas", &[betas.len()], betas)?;
            npz.add("joints_rest", &[24, 3], body.shaped_joints(betas).as_flattened())?;
            npz.add("parents", &[24], &body.parents)?;
        }
        npz.finish()?.flush()?;
        Ok(())
    }
}

/// Says who made a clip.
const ABOUT: &str = "subject.json";
const MADE_BY: &str = "effigy synth";

/// Takes the truth of an earlier made clip away: it may have had more frames and pictures, which would count as the new one's.
/// Files of anybody else's stay, and no clip is made among them.
fn clear(folder: &Path) -> Result<(), SynthError> {
    if !folder.is_dir() || std::fs::read_dir(folder)?.next().is_none() {
        return Ok(());
    }
    let about = std::fs::read(folder.join(ABOUT)).ok();
    let about: Option<serde_json::Value> = about.and_then(|text| serde_json::from_slice(&text).ok());
    if about.is_none_or(|about| about["made_by"] != MADE_BY) {
        return Err(SynthError::Occupied { folder: folder.to_owned() });
    }
    for part in ["truth", "novel"] {
        let part = folder.join(part);
        if part.is_dir() {
            std::fs::remove_dir_all(part)?;
        }
    }
    Ok(())
}

/// 255 where at least half of the pixel is covered.
fn binary(coverage: &GrayImage) -> GrayImage {
    GrayImage::from_fn(coverage.width(), coverage.height(), |x, y| Luma([mask::binary(coverage.get_pixel(x, y).0[0])]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clip_takes_the_place_of_a_made_one_and_of_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let clip = folder.path().join("clip");
        let create = || FolderWriter::create(&clip, &Body::test_body(), &SynthOptions::default()).map(drop);
        create().unwrap();
        // As it stands when it is interrupted, with pictures of a longer list.
        let old = clip.join("novel/view_09.png");
        std::fs::write(&old, "").unwrap();
        create().unwrap();
        assert!(!old.exists() && clip.join("truth").is_dir());
        std::fs::write(clip.join(ABOUT), r#"{ "made_by": "a camera" }"#).unwrap();
        assert!(matches!(create(), Err(SynthError::Occupied { .. })));
        std::fs::remove_file(clip.join(ABOUT)).unwrap();
        std::fs::write(clip.join("video.mp4"), "a person").unwrap();
        assert!(matches!(create(), Err(SynthError::Occupied { .. })));
        assert_eq!(std::fs::read(clip.join("video.mp4")).unwrap(), b"a person");
    }
}
