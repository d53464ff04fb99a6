//! What no frame shows: armpits, soles, the back of somebody who turned half way. A texture is trained where pixels are, and
//! elsewhere shows whatever its table holds; here it learns the colour of its surroundings and of the other half of the body.

use std::collections::HashMap;

use super::model::TextureModel;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::math::median_f32;
use crate::ops::interpolate::{Interpolate, Sampling};
use crate::ops::rgb_l1::{Pixels, RgbL1};
use crate::ops::{LossSlot, Target, pack_pixel};

/// Pixels well inside the mask that have to show a face, over the clip, for its colour to be known, and their share of what a
/// face of its area gets in the middle of all: what is seen by less lies in a fold, in its dark, and under pixels that show its
/// neighbours too.
const MIN_PIXELS: f32 = 3.0;
const MIN_SHARE: f32 = 0.15;
/// Rounds of relaxation; a colour spreads by a ring each.
const ROUNDS: usize = 200;
/// The other half's colour against the mean of the neighbours': beyond some 1 / √0.03 ≈ 6 rings it outweighs them, so that
/// borders have no seam and the middle of a large part is what its mirror image is.
const MIRROR: f32 = 0.03;
/// Points of a face that learn its colour, at most; where many faces are unseen, fewer, but one at least. As many as it has cells of
/// the finest grid would be best: what is learnt at a few points alone is noise between them.
const POINTS_A_FACE: usize = 48;
/// What all of them count together, over a frame's pixels.
const WEIGHT: f32 = 0.2;
/// Points in all, but one a face at least, and those that a step looks at, about: where half of the body is unseen, all of them
/// would cost more than the frames.
const MAX_POINTS: usize = 32768;
const POINTS_A_STEP: f64 = 2048.0;

/// Point `k` of a face, evenly spread for any number of them: the sequence R2 (Roberts 2018, "The unreasonable effectiveness of
/// quasirandom sequences"), folded into the triangle.
fn point(k: usize) -> [f32; 3] {
    const PLASTIC: f64 = 1.324_717_957_244_746;
    let [u, v] = [PLASTIC, PLASTIC * PLASTIC].map(|step| (0.5 + (k + 1) as f64 / step).fract() as f32);
    if u + v <= 1.0 { [u, v, 1.0 - u - v] } else { [1.0 - u, 1.0 - v, u + v - 1.0] }
}

/// Gives each face that is not `known` a colour (`[F, 3]`) between those of its neighbours and that of the face on the other
/// side of the body, where that one is known. A part of the surface that touches nothing known keeps its colours.
pub fn fill(faces: &[[u32; 3]], mirror: &[u32], known: &[bool], colours: &mut [f32]) {
    // From the known outwards, so that the relaxation starts near its end.
    let filled = spread(faces, colours, known.to_vec());
    let colours = colours.as_chunks_mut::<3>().0;
    let neighbours = neighbours(faces);
    let others = mirrored(faces, mirror);
    let other = |f: usize| others[f].filter(|&other| known[other]);
    let mean = |of: &[usize], colours: &[[f32; 3]]| -> Option<[f32; 3]> {
        let of: Vec<[f32; 3]> = of.iter().filter(|&&n| filled[n]).map(|&n| colours[n]).collect();
        (!of.is_empty()).then(|| std::array::from_fn(|k| of.iter().map(|c| c[k]).sum::<f32>() / of.len() as f32))
    };
    let open: Vec<usize> = (0..faces.len()).filter(|&f| !known[f] && filled[f]).collect();
    for _ in 0..ROUNDS {
        for &f in &open {
            let Some(around) = mean(&neighbours[f], colours) else { continue };
            colours[f] = match other(f) {
                Some(other) => std::array::from_fn(|k| (around[k] + MIRROR * colours[other][k]) / (1.0 + MIRROR)),
                None => around,
            };
        }
    }
}

/// Gives each face that is not `known` the mean colour of the neighbours that have one, ring by ring. Returns which faces have
/// one then.
pub fn spread(faces: &[[u32; 3]], colours: &mut [f32], mut known: Vec<bool>) -> Vec<bool> {
    let n_vertices = faces.iter().flatten().max().map_or(0, |&v| v as usize + 1);
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
            return known;
        }
        filled.into_iter().for_each(|f| known[f] = true);
    }
}

/// The faces whose colour is known: `counts [F]` pixels showed them, of a mesh with `vertices [V, 3]`.
pub fn known(faces: &[[u32; 3]], vertices: &[[f32; 3]], counts: &[f32]) -> Vec<bool> {
    let area = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| glam::Vec3::from(vertices[v as usize]));
        (b - a).cross(c - a).length().max(f32::MIN_POSITIVE)
    };
    let densities: Vec<f32> = faces.iter().zip(counts).map(|(face, count)| count / area(face)).collect();
    let seen = densities.iter().zip(counts).filter(|(_, n)| **n > 0.0).map(|(d, _)| *d);
    let least = MIN_SHARE * median_f32(seen).unwrap_or(0.0);
    densities.iter().zip(counts).map(|(&density, &n)| n >= MIN_PIXELS && density >= least).collect()
}

/// The faces across each edge of a face.
fn neighbours(faces: &[[u32; 3]]) -> Vec<Vec<usize>> {
    let mut at_edge: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
    let edges = |face: [u32; 3]| [0, 1, 2].map(|k| [face[k].min(face[(k + 1) % 3]), face[k].max(face[(k + 1) % 3])]);
    for (f, &face) in faces.iter().enumerate() {
        edges(face).into_iter().for_each(|edge| at_edge.entry(edge).or_default().push(f));
    }
    let across = |(f, &face): (usize, &[u32; 3])| {
        edges(face).iter().flat_map(|edge| &at_edge[edge]).copied().filter(|&n| n != f).collect()
    };
    faces.iter().enumerate().map(across).collect()
}

/// The face on the other side of the body, where there is one.
fn mirrored(faces: &[[u32; 3]], mirror: &[u32]) -> Vec<Option<usize>> {
    let sorted = |mut face: [u32; 3]| {
        face.sort_unstable();
        face
    };
    let by_vertices: HashMap<[u32; 3], usize> = faces.iter().enumerate().map(|(f, &face)| (sorted(face), f)).collect();
    let other = |(f, face): (usize, &[u32; 3])| {
        by_vertices.get(&sorted(face.map(|v| mirror[v as usize]))).copied().filter(|&other| other != f)
    };
    faces.iter().enumerate().map(other).collect()
}

/// The faces that no frame shows, as an image that the texture is trained on besides the frames.
pub struct Unseen {
    interpolate: Interpolate,
    rgb: RgbL1,
    pix_to_face: Buffer<i32>,
    bary_coords: Buffer<f32>,
    target: Buffer<u32>,
    image: Buffer<f32>,
    grad_image: Buffer<f32>,
    grad_rgb: Buffer<f32>,
    grad_coords: Buffer<f32>,
    loss: Buffer<f32>,
    n: usize,
    /// Room for a step's points.
    rows: usize,
    /// The part of the points that a step looks at.
    rate: f64,
}

impl Unseen {
    /// Every one of `faces` learns its colour of `colours [F, 3]`; `None` where there are no faces. A step looks at `max_rows` points
    /// at most.
    pub fn new(gpu: &Gpu, faces: &[u32], colours: &[f32], max_rows: usize) -> Option<Self> {
        let a_face = (MAX_POINTS / faces.len().max(1)).clamp(1, POINTS_A_FACE);
        let points = || faces.iter().flat_map(|&f| (0..a_face).map(move |k| (f, point(k))));
        let n = points().count();
        if n == 0 {
            return None;
        }
        // Twice what a step has in the mean: it never has more.
        let rows = n.min(max_rows).min(2 * POINTS_A_STEP as usize);
        let rate = (POINTS_A_STEP.min(0.5 * max_rows as f64) / n as f64).min(1.0);
        let byte = |f: u32| [0, 1, 2].map(|k| (255.0 * colours[3 * f as usize + k]).round().clamp(0.0, 255.0) as u8);
        let pix_to_face: Vec<i32> = points().map(|(f, _)| f as i32).collect();
        let bary: Vec<f32> = points().flat_map(|(_, bary)| bary).collect();
        let target: Vec<u32> = points().map(|(f, _)| pack_pixel(byte(f), 255)).collect();
        let zeros = |name: &str, len: usize| gpu.zeros::<f32>(&format!("fit/unseen/{name}"), len);
        Some(Self {
            interpolate: Interpolate::new(gpu, n, rows, 0),
            rgb: RgbL1::new(gpu, n),
            pix_to_face: gpu.upload("fit/unseen/pix_to_face", &pix_to_face),
            bary_coords: gpu.upload("fit/unseen/bary_coords", &bary),
            target: gpu.upload("fit/unseen/target", &target),
            image: zeros("image", RgbL1::room(n)),
            grad_image: zeros("grad_image", RgbL1::room(n)),
            grad_rgb: zeros("grad_rgb", 3 * rows),
            grad_coords: zeros("grad_coords", 3 * rows),
            loss: zeros("loss", 1),
            n,
            rows,
            rate,
        })
    }

    /// Records the gradients of the texture, from a sample of the points that `step` decides; `weight` is that of the frames'
    /// colours. Coordinates stay where they are.
    pub fn record(
        &self,
        recorder: &mut Recorder<'_>,
        model: &TextureModel,
        faces: &Buffer<u32>,
        texcoords: &Buffer<f32>,
        weight: f32,
        step: u32,
    ) {
        let Self { interpolate, n, rows, .. } = self;
        let sampling = Sampling { rate: self.rate, seed: step.wrapping_mul(0x9e37_79b9) };
        interpolate.forward(recorder, *n, &self.pix_to_face, &self.bary_coords, faces, texcoords, sampling);
        model.forward(recorder, &interpolate.coords, &interpolate.count, *rows);
        interpolate.scatter(recorder, *n, model.rgb(), [0.0; 3], &self.image);
        let target = Target::Packed { pixels: &self.target, offset: 0, background: None };
        let lambda = WEIGHT * weight / (*n as f64 * sampling.rate) as f32;
        let slot = LossSlot::new(&self.loss, 0);
        self.rgb.forward_backward(recorder, *n, &self.image, target, Pixels::All, slot, lambda, &self.grad_image);
        interpolate.gather(recorder, *n, &self.grad_image, &self.grad_rgb);
        recorder.clear(&self.grad_coords);
        model.backward(recorder, &interpolate.coords, &interpolate.count, *rows, &self.grad_rgb, &self.grad_coords);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of `n` pairs of triangles along x, and its mirror image: vertices in columns of two.
    fn strip(n: u32) -> (Vec<[u32; 3]>, Vec<u32>) {
        let half = |first: u32| {
            (0..n).flat_map(move |k| {
                let v = first + 2 * k;
                [[v, v + 1, v + 2], [v + 2, v + 1, v + 3]]
            })
        };
        let per_half = 2 * n + 2;
        let mirror = (0..2 * per_half).map(|v| (v + per_half) % (2 * per_half)).collect();
        (half(0).chain(half(per_half)).collect(), mirror)
    }

    #[test]
    fn a_gap_takes_the_colours_of_its_edges_and_knows_no_step() {
        let (faces, mirror) = strip(10);
        let mut known = vec![true; 40];
        let mut colours = [[0.2f32, 0.4, 0.6].repeat(10), [0.8, 0.4, 0.0].repeat(10), [0.5; 60].to_vec()].concat();
        for f in (4..16).chain(24..36) {
            known[f] = false;
            (0..3).for_each(|k| colours[3 * f + k] = 9.0);
        }
        fill(&faces, &mirror, &known, &mut colours);
        for f in 4..17 {
            let step = colours[3 * f] - colours[3 * f - 3];
            assert!((0.0..0.1).contains(&step), "face {f}: {step}");
            assert!((colours[3 * f + 1] - 0.4).abs() < 1e-5, "all edges are of one green");
        }
    }

    #[test]
    fn the_middle_of_a_large_gap_is_like_the_other_half() {
        let (faces, mirror) = strip(40);
        let mut known = vec![true; 160];
        let mut colours = vec![0.2f32; 3 * 160];
        for f in 10..70 {
            known[f] = false;
            (0..3).for_each(|k| colours[3 * (80 + f) + k] = 0.9);
        }
        fill(&faces, &mirror, &known, &mut colours);
        assert!((colours[3 * 40] - 0.9).abs() < 0.05, "{}", colours[3 * 40]);
        assert!((colours[3 * 10] - 0.2).abs() < 0.2, "{}", colours[3 * 10]);
    }

    #[test]
    fn a_face_is_known_by_enough_pixels_for_its_area() {
        // Two small faces and one of four times their area.
        let vertices =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let faces = [[0, 1, 2], [1, 3, 2], [0, 4, 5]];
        assert_eq!(known(&faces, &vertices, &[40.0, 2.0, 160.0]), [true, false, true]);
        assert_eq!(known(&faces, &vertices, &[40.0, 38.0, 20.0]), [true, true, false]);
        assert_eq!(known(&faces, &vertices, &[0.0; 3]), [false; 3]);
    }

    #[test]
    fn any_number_of_points_of_a_face_are_spread_over_it() {
        for n in [1, 4, 12, POINTS_A_FACE] {
            let points: Vec<[f32; 3]> = (0..n).map(point).collect();
            for at in &points {
                assert!(at.iter().all(|&w| w >= 0.0) && (at.iter().sum::<f32>() - 1.0).abs() < 1e-6, "{at:?}");
            }
            let mean: [f32; 3] = std::array::from_fn(|k| points.iter().map(|at| at[k]).sum::<f32>() / n as f32);
            assert!(n == 1 || mean.iter().all(|m| (m - 1.0 / 3.0).abs() < 0.12), "{n}: {mean:?}");
            // No two lie nearer than a third of what a grid would have.
            let apart = |a: &[f32; 3], b: &[f32; 3]| (a[0] - b[0]).hypot(a[1] - b[1]);
            let nearest = points.iter().enumerate().flat_map(|(i, a)| points[..i].iter().map(move |b| apart(a, b)));
            assert!(nearest.fold(1.0, f32::min) > 0.3 / (2.0 * n as f32).sqrt(), "{n}");
        }
    }

    #[test]
    fn a_part_that_nobody_saw_keeps_its_colours() {
        let (faces, mirror) = strip(3);
        let mut colours: Vec<f32> = (0..36).map(|k| k as f32).collect();
        let before = colours.clone();
        fill(&faces, &mirror, &[false; 12], &mut colours);
        assert_eq!(colours, before);
    }

    #[test]
    fn unseen_faces_take_their_neighbours_colour_ring_by_ring() {
        let faces = [[0, 1, 2], [1, 2, 3], [2, 3, 4], [5, 6, 7]];
        let mut colours = vec![0.0; 12];
        colours[..3].copy_from_slice(&[0.2, 0.4, 0.6]);
        let known = spread(&faces, &mut colours, vec![true, false, false, false]);
        assert_eq!(known, [true, true, true, false]);
        for f in 1..3 {
            for c in 0..3 {
                assert!((colours[3 * f + c] - colours[c]).abs() < 1e-6, "face {f}");
            }
        }
        assert_eq!(colours[9..], [0.0; 3], "a part of its own that nobody saw stays as it was");
    }
}
