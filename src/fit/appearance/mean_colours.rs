//! One colour a face in closed form, and the light with it: for fixed geometry and light the albedo that fits best is a
//! weighted mean over all pixels that show the face, and needs no learning rate. Stage 1 starts from it and goes on by
//! gradient.

use super::Lit;
use super::albedo::{Observation, albedos};
use super::lamp::{of_face, solve_light, solve_shadowed_light};
use super::shadows::PosedClip;
use super::sky::Sky;
use super::unseen;
use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::gpu::{Buffer, GpuError};
use crate::mask::is_foreground;
use crate::ops::light::{Exposure, Light};

/// What [`solve_face_colours`] found.
pub struct FaceAlbedos {
    /// `[F, 3]`
    pub colours: Vec<f32>,
    /// `[F]`: pixels well inside the masks that showed a face, in the dark less: there a shade that is a little wrong makes
    /// an albedo that is far off
    pub counts: Vec<f32>,
}

/// Colours over all frames at `level`, for the scene's shape, and with `lit` the light, which is told from the
/// colours, unless it stands, and put into `lit` with its shadows. A face that no pixel showed takes the mean of its neighbours, from the seen ones outwards.
pub fn solve_face_colours(
    scene: &Scene,
    faces: &[[u32; 3]],
    lit: Option<&mut Lit>,
    poses: &PoseGroups,
    level: usize,
) -> Result<FaceAlbedos, GpuError> {
    let mut clip = PosedClip::new(faces);
    let observations = observe(scene, faces.len(), lit.as_deref(), poses, level, &mut clip)?;
    let (mut light, mut exposures) = (Light::EVEN, Vec::new());
    if let Some(lit) = lit {
        (light, exposures) = match lit.stands {
            true => (lit.light, clip.exposures(&lit.light)),
            false => solve(scene, faces, &observations, level, &clip),
        };
        lit.set(&scene.gpu, light, &exposures);
    }
    let reaching = |o: &Observation| {
        exposures.get(o.frame as usize).map_or(Exposure::FULL, |e| of_face(e, faces[o.face as usize]))
    };
    let counts = lit_counts(&observations, faces.len(), &light, reaching);
    let (mut colours, seen) = albedos(&observations, faces.len(), &light, reaching);
    colours.iter_mut().for_each(|c| *c = c.min(1.0));
    unseen::spread(faces, &mut colours, seen.iter().map(|&n| n > 0.0).collect());
    Ok(FaceAlbedos { colours, counts })
}

/// The light that explains the observations best, and what of it reaches each vertex in each frame.
pub(super) fn solve(
    scene: &Scene,
    faces: &[[u32; 3]],
    observations: &[Observation],
    level: usize,
    clip: &PosedClip<'_>,
) -> (Light, Vec<Vec<Exposure>>) {
    let sky = sky(scene, level);
    let light = solve_light(observations, faces.len(), &sky);
    if light.has_lamp() {
        return solve_shadowed_light(observations, faces, &light, &sky, clip);
    }
    (light, clip.exposures(&light))
}

/// One camera takes the whole clip; its y points down and its z forward.
pub(super) fn sky(scene: &Scene, level: usize) -> Sky {
    let [_, _, _, ux, uy, uz, fx, fy, fz] = scene.frames[0].levels[level].camera.rotation.map(|x| x as f32);
    Sky::new([-ux, -uy, -uz], [fx, fy, fz])
}

/// `[F]`: the pixels well inside the masks that showed each face, each by the square of its shade: its weight in the least squares
/// that tell the albedo. None counts more than once.
fn lit_counts(
    observations: &[Observation],
    n_faces: usize,
    light: &Light,
    exposure: impl Fn(&Observation) -> Exposure,
) -> Vec<f32> {
    let mut counts = vec![0.0; n_faces];
    for o in observations {
        let shade = light.shade(o.normal, exposure(o))[1].min(1.0);
        counts[o.face as usize] += o.inside * shade * shade;
    }
    counts
}

/// What each frame shows of each face. With `lit` each frame's body goes to `clip`; without it the normals are zero.
pub(super) fn observe(
    scene: &Scene,
    n_faces: usize,
    lit: Option<&Lit>,
    poses: &PoseGroups,
    level: usize,
    clip: &mut PosedClip<'_>,
) -> Result<Vec<Observation>, GpuError> {
    let gpu = &scene.gpu;
    let (sums, counts) =
        (gpu.zeros::<f32>("fit/colour_sums", n_faces * 3), gpu.zeros("fit/colour_counts", n_faces * 3));
    let mut observations = Vec::new();
    for (frame, images) in scene.frames.iter().enumerate() {
        let level = &images.levels[level];
        let (mut colour, mut seen) = (Vec::new(), Vec::new());
        let pixels: Vec<[u8; 4]> = gpu.read(&level.target)?.into_iter().map(u32::to_le_bytes).collect();
        for (pixel, well_inside) in pixels.iter().zip(well_inside(&pixels, level.width as usize)) {
            let inside = if is_foreground(pixel[3]) { 1.0f32 } else { 0.0 };
            colour.extend([0, 1, 2].map(|c| inside * pixel[c] as f32 / 255.0));
            // Three channels: the first counts all pixels, the second those well inside.
            seen.extend([inside, f32::from(u8::from(well_inside)), 0.0]);
        }
        let colour = gpu.upload("fit/target_colour", &colour);
        let seen = gpu.upload("fit/target_seen", &seen);
        let mut recorder = gpu.recorder("fit/observe");
        let totals: [&Buffer<f32>; 2] = [&sums, &counts];
        totals.into_iter().for_each(|buffer| recorder.clear(buffer));
        scene.forward(&mut recorder, level, poses.at(frame));
        if let Some(lit) = lit {
            lit.start_frame(&mut recorder, scene, frame);
        }
        scene.hard.shade_backward(&mut recorder, &level.camera, &scene.view, &colour, &sums);
        scene.hard.shade_backward(&mut recorder, &level.camera, &scene.view, &seen, &counts);
        recorder.submit()?;
        let (sums, counts) = (gpu.read(&sums)?, gpu.read(&counts)?);
        let normals = lit.map(|lit| lit.read_face_normals(gpu)).transpose()?;
        if lit.is_some() {
            clip.push_posed(scene)?;
        }
        for face in (0..n_faces).filter(|face| counts[3 * face] > 0.0) {
            let weight = counts[3 * face];
            observations.push(Observation {
                frame: frame as u32,
                face: face as u32,
                weight,
                inside: counts[3 * face + 1],
                colour: std::array::from_fn(|k| sums[3 * face + k] / weight),
                normal: normals.as_ref().map_or([0.0; 3], |normals| normals[face]),
            });
        }
    }
    Ok(observations)
}

/// Which pixels lie inside the mask with all four neighbours: its border mixes the person with the background, and the texture
/// must not learn that.
pub fn well_inside(pixels: &[[u8; 4]], width: usize) -> impl Iterator<Item = bool> {
    let height = pixels.len().checked_div(width).unwrap_or(0);
    let inside = move |x: usize, y: usize| x < width && y < height && is_foreground(pixels[y * width + x][3]);
    let well = move |(x, y): (usize, usize)| {
        let around = [(1, 1), (0, 1), (2, 1), (1, 0), (1, 2)];
        around.iter().all(|&(dx, dy)| inside((x + dx).wrapping_sub(1), (y + dy).wrapping_sub(1)))
    };
    (0..height).flat_map(move |y| (0..width).map(move |x| (x, y))).map(well)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_in_the_dark_counts_as_little_known() {
        let observation = |face: u32, frame: u32| Observation {
            frame,
            face,
            weight: 5.0,
            inside: 4.0,
            colour: [0.5; 3],
            normal: [0.0, 1.0, 0.0],
        };
        // An open face and one in a corner in two frames each; a third that only the first frame shows, brighter than the mean.
        let observations = [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0)].map(|(face, frame)| observation(face, frame));
        let reaches = [1.0, 0.5, 1.5];
        let exposure = |o: &Observation| Exposure { ambient: reaches[o.face as usize], lamp: 1.0 };
        assert_eq!(lit_counts(&observations, 4, &Light::EVEN, exposure), [8.0, 2.0, 4.0, 0.0]);
    }
}
