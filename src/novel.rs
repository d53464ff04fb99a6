//! `novel/novel.json` of a clip with truth: its held-out pictures. `effigy synth` writes it, `effigy eval` reads it.

use serde::{Deserialize, Serialize};

use crate::camera::Camera;

#[derive(Debug, Default, Serialize, Deserialize)]
pub struct NovelFile {
    /// Of a pose that the video shows, by other cameras
    #[serde(default)]
    pub views: Vec<NovelEntry>,
    /// Of poses that it does not show
    #[serde(default)]
    pub poses: Vec<NovelEntry>,
}

/// A held-out picture. It shows `pose` with the pelvis joint at `trans`; without both the captured pose of `frame`.
#[derive(Debug, Serialize, Deserialize)]
pub struct NovelEntry {
    /// Files beside the list.
    pub image: String,
    pub mask: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Of the video; the first where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<u32>,
    /// `[72]`
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<Vec<f32>>,
    /// Metres, in the clip's world
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trans: Option<[f32; 3]>,
    #[serde(rename = "R")]
    rotation: [[f64; 3]; 3],
    #[serde(rename = "t")]
    translation: [f64; 3],
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
}

impl NovelEntry {
    /// Of the captured pose of a frame, seen by a camera without a lens. Its files are still to be told.
    pub fn of_frame(frame: u32, camera: &Camera) -> Self {
        Self { frame: Some(frame), ..Self::of_camera(camera) }
    }

    /// Of a pose `[72]` with the pelvis joint there; else as [`NovelEntry::of_frame`].
    pub fn of_pose(name: &str, pose: &[f32], pelvis: [f32; 3], camera: &Camera) -> Self {
        let (name, pose) = (Some(name.to_owned()), Some(pose.to_vec()));
        Self { name, pose, trans: Some(pelvis), ..Self::of_camera(camera) }
    }

    fn of_camera(camera: &Camera) -> Self {
        Self {
            image: String::new(),
            mask: String::new(),
            name: None,
            frame: None,
            pose: None,
            trans: None,
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| camera.rotation[3 * i + j])),
            translation: camera.translation,
            width: camera.width,
            height: camera.height,
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
        }
    }

    pub fn camera(&self) -> Camera {
        Camera {
            rotation: std::array::from_fn(|i| self.rotation[i / 3][i % 3]),
            translation: self.translation,
            ..Camera::pinhole(self.width, self.height, [self.fx, self.fy, self.cx, self.cy])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_goes_out_and_comes_back() {
        let rotation = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let camera =
            Camera { rotation, translation: [0.5, 0.0, 1.0], ..Camera::pinhole(64, 48, [40.0, 50.0, 32.0, 24.0]) };
        let pose =
            NovelEntry { image: "a.png".into(), ..NovelEntry::of_pose("walk", &[0.5; 72], [1.0, 2.0, 3.0], &camera) };
        let text = serde_json::to_string(&NovelFile { views: Vec::new(), poses: vec![pose] }).unwrap();
        assert!(text.contains(r#""R":[[0.0,-1.0,0.0],[1.0,0.0,0.0],[0.0,0.0,1.0]]"#), "{text}");
        assert!(!text.contains("frame"), "{text}");
        let back: NovelFile = serde_json::from_str(&text).unwrap();
        let [pose] = &back.poses[..] else { panic!("{text}") };
        assert_eq!(pose.camera(), camera);
        assert_eq!((pose.image.as_str(), pose.frame, pose.trans), ("a.png", None, Some([1.0, 2.0, 3.0])));
    }
}
