//! What a pixel counts for the texture: the more slantingly the surface lies in it, the more of the surface it mixes, and the
//! further it is off where the pose is.

use glam::DVec3;

use super::mean_colours::well_inside;
use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::gpu::GpuError;
use crate::ops::PixelList;

/// What counts however slanting it is: some places face no camera.
const LEAST: f64 = 0.02;

/// The pixels of a frame well inside the mask, each by the square of the cosine between the face's normal and the way to the
/// camera, as the scene's shape and poses are; one on average. Waits.
pub fn facing_pixels(
    scene: &Scene,
    faces: &[[u32; 3]],
    poses: &PoseGroups,
    frame: usize,
    level: usize,
) -> Result<PixelList, GpuError> {
    let (gpu, images) = (&scene.gpu, &scene.frames[frame].levels[level]);
    let mut recorder = gpu.recorder("fit/facing");
    scene.forward(&mut recorder, images, poses.at(frame));
    recorder.submit()?;
    let (cosines, pix_to_face) = (cosines(scene, faces)?, gpu.read(&scene.hard.pix_to_face)?);
    let pixels: Vec<[u8; 4]> = gpu.read(&images.target)?.into_iter().map(u32::to_le_bytes).collect();
    let inside = well_inside(&pixels, images.width as usize);
    Ok(PixelList::weighted(gpu, "fit/facing", &weights(inside, &pix_to_face, &cosines)))
}

/// Of each face's normal and the way to the camera, as the scene is seen in its last hard image. Waits.
pub fn cosines(scene: &Scene, faces: &[[u32; 3]]) -> Result<Vec<f64>, GpuError> {
    let view = scene.gpu.read(&scene.view)?;
    Ok(faces.iter().map(|face| cosine(&view, face)).collect())
}

/// What each pixel counts; `pix_to_face` may go on beyond the image.
fn weights(inside: impl Iterator<Item = bool>, pix_to_face: &[i32], cosines: &[f64]) -> Vec<f32> {
    let of = |(inside, &face): (bool, &i32)| match cosines.get(face as usize) {
        _ if !inside => 0.0,
        // What the body does not cover is drawn in no colour that can be learned.
        None => LEAST,
        Some(cosine) => (cosine * cosine).max(LEAST),
    };
    let weights: Vec<f64> = inside.zip(pix_to_face).map(of).collect();
    let (n, sum) = (weights.iter().filter(|weight| **weight > 0.0).count(), weights.iter().sum::<f64>());
    let mean = sum / n.max(1) as f64;
    weights.into_iter().map(|weight| (weight / mean.max(LEAST)) as f32).collect()
}

/// Between a face's normal and the way to the camera, of points in view space.
fn cosine(view: &[f32], face: &[u32; 3]) -> f64 {
    let [a, b, c] = face.map(|v| DVec3::from_array([0, 1, 2].map(|k| f64::from(view[3 * v as usize + k]))));
    let normal = (b - a).cross(c - a).normalize_or_zero();
    normal.dot((a + b + c).normalize_or_zero()).abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_that_looks_at_the_camera_counts_most() {
        // Far away before the camera: across, turned by 60°, and edge on.
        let (s, c) = (60f32.to_radians().sin(), 60f32.to_radians().cos());
        let corners = [[0.0, 0.0, 1e4], [0.0, 1.0, 1e4], [1.0, 0.0, 1e4], [c, 0.0, 1e4 + s], [0.0, 0.0, 1e4 + 1.0]];
        let faces = [[0, 1, 2], [0, 1, 3], [0, 1, 4]];
        let cosines: Vec<f64> = faces.iter().map(|face| cosine(corners.as_flattened(), face)).collect();
        for (got, want) in cosines.iter().zip([1.0, 0.5, 0.0]) {
            assert!((got - want).abs() < 1e-3, "{cosines:?}");
        }
        // Pixels of each, one that the body does not cover, one outside of the mask, and what lies behind the image.
        let inside = [true, true, true, true, false].into_iter();
        let weights = weights(inside, &[0, 1, 2, -1, 0, 0], &cosines);
        assert_eq!((weights.len(), weights[4]), (5, 0.0));
        let mean = weights.iter().sum::<f32>() / 4.0;
        assert!((mean - 1.0).abs() < 1e-5, "{weights:?}");
        assert!((weights[0] / weights[1] - 4.0).abs() < 0.02, "{weights:?}");
        assert!(weights[2] > 0.0 && weights[2] == weights[3] && weights[2] < 0.1 * weights[1], "{weights:?}");
    }
}
