//! One colour a face in closed form: for fixed geometry the mean over all pixels that show the face minimises the
//! squared error, and needs no learning rate. Stage 1 starts from it and goes on by gradient.

use crate::fit::groups::PoseGroups;
use crate::fit::scene::Scene;
use crate::gpu::GpuError;

/// Mean colours `[F, 3]` over all frames at `level`, for the scene's shape. A face that no pixel showed takes the mean of
/// its neighbours, from the seen ones outwards.
pub fn mean_face_colours(
    scene: &Scene,
    faces: &[[u32; 3]],
    poses: &PoseGroups,
    level: usize,
) -> Result<Vec<f32>, GpuError> {
    let gpu = &scene.gpu;
    let sums = gpu.zeros::<f32>("fit/colour_sums", faces.len() * 3);
    let counts = gpu.zeros::<f32>("fit/colour_counts", faces.len() * 3);
    for (frame, images) in scene.frames.iter().enumerate() {
        let level = &images.levels[level];
        let (mut colour, mut seen) = (Vec::new(), Vec::new());
        for pixel in gpu.read(&level.target)?.into_iter().map(u32::to_le_bytes) {
            let inside = if pixel[3] >= 128 { 1.0f32 } else { 0.0 };
            colour.extend([0, 1, 2].map(|c| inside * pixel[c] as f32 / 255.0));
            seen.extend([inside; 3]);
        }
        let colour = gpu.upload("fit/target_colour", &colour);
        let seen = gpu.upload("fit/target_seen", &seen);
        let mut recorder = gpu.recorder("fit/mean_face_colours");
        scene.forward(&mut recorder, level, poses.at(frame));
        scene.hard.shade_backward(&mut recorder, &level.camera, &scene.view, &colour, &sums);
        scene.hard.shade_backward(&mut recorder, &level.camera, &scene.view, &seen, &counts);
        recorder.submit()?;
    }
    let (mut colours, counts) = (gpu.read(&sums)?, gpu.read(&counts)?);
    let counts: Vec<f32> = counts.chunks_exact(3).map(|c| c[0]).collect();
    for (colour, &count) in colours.chunks_exact_mut(3).zip(&counts) {
        colour.iter_mut().for_each(|c| *c /= count.max(1.0));
    }
    fill_unseen(faces, &mut colours, &counts);
    Ok(colours)
}

/// Gives each face without pixels the mean colour of the neighbours that have one, ring by ring.
fn fill_unseen(faces: &[[u32; 3]], colours: &mut [f32], counts: &[f32]) {
    let n_vertices = faces.iter().flatten().max().map_or(0, |&v| v as usize + 1);
    let mut known: Vec<bool> = counts.iter().map(|&c| c > 0.0).collect();
    loop {
        let mut at_vertex = vec![[0.0f32; 4]; n_vertices];
        for (f, face) in faces.iter().enumerate().filter(|(f, _)| known[*f]) {
            for &v in face {
                let sum = &mut at_vertex[v as usize];
                (0..3).for_each(|c| sum[c] += colours[3 * f + c]);
                sum[3] += 1.0;
            }
        }
        let mut filled = Vec::new();
        for (f, face) in faces.iter().enumerate().filter(|(f, _)| !known[*f]) {
            let sum = face
                .iter()
                .map(|&v| at_vertex[v as usize])
                .fold([0.0; 4], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]);
            if sum[3] > 0.0 {
                (0..3).for_each(|c| colours[3 * f + c] = sum[c] / sum[3]);
                filled.push(f);
            }
        }
        if filled.is_empty() {
            return;
        }
        filled.into_iter().for_each(|f| known[f] = true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unseen_faces_take_their_neighbours_colour_ring_by_ring() {
        let faces = [[0, 1, 2], [1, 2, 3], [2, 3, 4], [5, 6, 7]];
        let mut colours = vec![0.0; 12];
        colours[..3].copy_from_slice(&[0.2, 0.4, 0.6]);
        fill_unseen(&faces, &mut colours, &[5.0, 0.0, 0.0, 0.0]);
        for f in 1..3 {
            for c in 0..3 {
                assert!((colours[3 * f + c] - colours[c]).abs() < 1e-6, "face {f}");
            }
        }
        assert_eq!(colours[9..], [0.0; 3], "a part of its own that nobody saw stays as it was");
    }
}
