//! Corners that no frame showed in good light, in the albedo that leaves the program without the clip's light.
//!
//! An albedo is a picture's colour over the shade that the light model has there. Where a surface is smoother than the cloth it
//! stands for, a crotch for one, the model's shade can be too low in every frame, and the albedo too bright by as much; with that
//! shade it looks right, and without it is a pale patch (docs/lab/light.md). All that is known of such a place is that its albedo lies
//! between the picture's colour and that over the best shade: of these, the one nearest to its surroundings is taken. Nothing gets
//! brighter, and what was seen in good light stays.

use glam::Vec3;

use super::AvatarModel;
use super::pose::vertex_normals;
use crate::body::joints::{HEAD, NECK};
use crate::math::{median_f32, smoothstep};
use crate::ops::Topology;

/// Frames that are looked at, at most.
const FRAMES: usize = 8;
/// The least cosine between a normal and the way to the camera at which a frame shows a vertex.
const FACING: f32 = 0.3;
/// Best shades, of the median of all: from the first down what is around counts, from the second on alone.
const GOOD: f32 = 0.9;
const POOR: f32 = 0.8;
/// Of all vertices: a larger part of the surface is no corner. Crotches have 4 to 5 %, armpits and soles 1 to 2; hands, in which much is
/// hidden and little differs, 8.
const CORNER: f32 = 0.06;
/// Rounds in which surroundings spread; a ring each.
const ROUNDS: usize = 60;

/// `[V]`: what of each vertex's `albedo` stays, above 0, at most 1. Faces of people stay as they are: eyes and lips lie in corners.
pub(super) fn trims(model: &AvatarModel, albedo: &[[f32; 3]]) -> Vec<f32> {
    let topology = Topology::new(model.body.n_vertices(), &model.body.faces);
    let (joints, weights) = (&model.body.lbs_joints, &model.body.lbs_weights);
    let of_head = |v: usize| {
        let of_head = |(&joint, weight): (&u32, &f32)| [HEAD, NECK].contains(&(joint as usize)).then_some(*weight);
        joints[v].iter().zip(&weights[v]).filter_map(of_head).sum::<f32>() > 0.5
    };
    let mut best = best_shades(model);
    (0..best.len()).filter(|&v| of_head(v)).for_each(|v| best[v] = Some(1.0));
    let luma: Vec<f32> = albedo.iter().map(|rgb| rgb.iter().sum::<f32>() / 3.0).collect();
    of(&topology, &best, &luma)
}

/// The best of the frames' shades, over the median of all vertices; `None` for what no frame shows.
fn best_shades(model: &AvatarModel) -> Vec<Option<f32>> {
    let faces = &model.body.faces;
    let camera = Vec3::from(model.camera.centre().map(|x| x as f32));
    let mut best: Vec<Option<f32>> = vec![None; model.body.n_vertices()];
    let step = model.poses.len().div_ceil(FRAMES);
    for k in (0..model.poses.len()).step_by(step) {
        let vertices = model.posed(&model.poses[k], model.transl[k]).vertices;
        let normals = vertex_normals(&vertices, faces);
        for (v, exposure) in model.light.exposures(&vertices, faces).into_iter().enumerate() {
            let to_camera = (camera - Vec3::from(vertices[v])).normalize_or_zero();
            if Vec3::from(normals[v]).dot(to_camera) > FACING {
                let shade = model.light.shade(normals[v], exposure).iter().sum::<f32>() / 3.0;
                best[v] = Some(best[v].map_or(shade, |best| best.max(shade)));
            }
        }
    }
    let usual = median_f32(best.iter().flatten().copied()).unwrap_or(1.0).max(f32::MIN_POSITIVE);
    best.into_iter().map(|shade| shade.map(|shade| shade / usual)).collect()
}

fn of(topology: &Topology, best: &[Option<f32>], luma: &[f32]) -> Vec<f32> {
    let is_good = |v: usize| best[v].is_some_and(|best| best >= GOOD);
    let corners = corners(topology, is_good);
    // From what was seen well inwards.
    let mut around: Vec<Option<f32>> = (0..luma.len()).map(|v| is_good(v).then_some(luma[v])).collect();
    for _ in 0..ROUNDS {
        let mean = |v: usize| {
            let known = topology.neighbours.row(v).iter().filter_map(|&n| around[n as usize]);
            let (sum, count) = known.fold((0.0, 0.0), |(sum, count), luma| (sum + luma, count + 1.0));
            if count > 0.0 { Some(sum / count) } else { around[v] }
        };
        around = (0..luma.len()).map(|v| if is_good(v) { around[v] } else { mean(v) }).collect();
    }
    let trim = |v: usize| {
        let (Some(best), Some(around), true) = (best[v], around[v], corners[v]) else { return 1.0 };
        let nearest = (around / luma[v].max(1e-3)).clamp(best.min(1.0), 1.0);
        1.0 + smoothstep((GOOD - best) / (GOOD - POOR)) * (nearest - 1.0)
    };
    let seen: Vec<f32> = (0..luma.len()).map(trim).collect();
    // What no frame shows has learned its colour from the corner around it.
    let mut trims = seen.clone();
    for _ in 0..ROUNDS {
        let mean = |v: usize| {
            let around = topology.neighbours.row(v);
            around.iter().map(|&n| trims[n as usize]).sum::<f32>() / around.len().max(1) as f32
        };
        let hidden = |v: usize| best[v].is_none() && !topology.neighbours.row(v).is_empty();
        trims = (0..luma.len()).map(|v| if hidden(v) { mean(v) } else { seen[v] }).collect();
    }
    trims
}

/// `[V]`: whether a vertex lies in a small part of the surface that is not `good`. A large one is a side that a lamp never reached, as
/// of somebody who did not turn all the way, and its albedo is what the light model says.
fn corners(topology: &Topology, good: impl Fn(usize) -> bool) -> Vec<bool> {
    let n = topology.neighbours.len();
    let most = (CORNER * n as f32) as usize;
    let (mut corners, mut reached) = (vec![false; n], (0..n).map(&good).collect::<Vec<bool>>());
    for start in 0..n {
        if reached[start] {
            continue;
        }
        reached[start] = true;
        let mut part = vec![start];
        let mut next = 0;
        while next < part.len() {
            for &around in topology.neighbours.row(part[next]) {
                if !std::mem::replace(&mut reached[around as usize], true) {
                    part.push(around as usize);
                }
            }
            next += 1;
        }
        if part.len() <= most {
            part.into_iter().for_each(|v| corners[v] = true);
        }
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::testing::turning_avatar;
    use crate::ops::light::Light;

    #[test]
    fn a_side_that_no_lamp_reached_is_no_corner() {
        let (topology, n) = (strip(50), 100);
        let parts =
            |dark: [std::ops::Range<usize>; 2]| corners(&topology, |v| dark.iter().all(|part| !part.contains(&v)));
        let found = parts([20..24, 40..60]);
        assert!((0..n).all(|v| found[v] == (20..24).contains(&v)), "{found:?}");
    }

    /// A strip of triangles, two vertices a column.
    fn strip(columns: u32) -> Topology {
        let pair = |k: u32| [[2 * k, 2 * k + 1, 2 * k + 2], [2 * k + 2, 2 * k + 1, 2 * k + 3]];
        Topology::new(2 * columns as usize, &(0..columns - 1).flat_map(pair).collect::<Vec<_>>())
    }

    #[test]
    fn a_pale_corner_takes_the_colour_around_it_as_far_as_its_shade_allows() {
        let (topology, middle) = (strip(50), 50..54);
        let column = |inside: f32, outside: f32| -> Vec<f32> {
            (0..100).map(|v| if middle.contains(&v) { inside } else { outside }).collect()
        };
        let best = |inside: f32| -> Vec<Option<f32>> { column(inside, 1.0).into_iter().map(Some).collect() };
        let near = |trims: Vec<f32>, inside: f32| {
            for (v, trim) in trims.into_iter().enumerate() {
                let want = if middle.contains(&v) { inside } else { 1.0 };
                assert!((trim - want).abs() < 1e-4, "{v}: {trim}, expected {want}");
            }
        };
        near(of(&topology, &best(0.7), &column(0.5, 0.4)), 0.8);
        near(of(&topology, &best(0.7), &column(0.8, 0.4)), 0.7);
        near(of(&topology, &best(0.7), &column(0.3, 0.4)), 1.0);
        near(of(&topology, &best(0.95), &column(0.5, 0.4)), 1.0);
        // What is hidden is as its surroundings: these, and those of a corner.
        let mut hidden = best(1.0);
        hidden[51] = None;
        near(of(&topology, &hidden, &column(0.5, 0.4)), 1.0);
        let mut hidden = best(0.7);
        (hidden[51], hidden[52]) = (None, None);
        let trims = of(&topology, &hidden, &column(0.5, 0.4));
        assert!(trims[51] < 0.95 && trims[52] < 0.95 && trims[50] < 0.81, "{trims:?}");
    }

    #[test]
    fn in_even_light_nothing_is_trimmed() {
        let model = AvatarModel { light: Light::EVEN, ..turning_avatar() };
        let albedo = vec![[0.5; 3]; model.body.n_vertices()];
        assert!(trims(&model, &albedo).iter().all(|&trim| trim == 1.0));
    }
}
