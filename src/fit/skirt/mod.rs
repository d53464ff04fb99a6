//! Cloth that hangs from leg to leg: a skirt, a dress, a long coat. The body's legs are two, so a fit that follows the masks
//! leaves a valley between them, in front and behind, that no silhouette shows, walls inside where the legs meet, and legs that
//! take half of the cloth each with them when they part. None of it is in the paper. Here such cloth is found, its valleys are
//! filled, its walls are cut out, and it is carried by both legs.

mod outline;
mod standing;

use glam::Vec3;

use self::outline::Outline;
use self::standing::Standing;
use super::state::FitState;
use crate::body::joints::{LEFT_HIP, LEFT_KNEE, RIGHT_HIP, RIGHT_KNEE};
use crate::body::{Body, N_INFLUENCES, N_JOINTS};
use crate::math::smoothstep;
use crate::ops::Topology;

/// Joints of both legs, left and right.
const THIGHS: [usize; 2] = [LEFT_HIP, RIGHT_HIP];
const SHANKS: [usize; 2] = [LEFT_KNEE, RIGHT_KNEE];

/// Heights that are looked at, between hip (0) and ankle (1).
const ROWS: usize = 48;
/// Where the legs of a naked body part, from hip (0) to ankle (1).
const CROTCH: f32 = 0.1;
/// How near the middle a surface must come to close the gap between the legs, of the distance from the middle to a leg's axis.
const MIDDLE: f32 = 0.15;
/// Cloth is no trousers where it closes a gap that is this wide between the naked legs, metres. Skirts to the knees and longer
/// close 18 cm and more; overalls with a low crotch, wide trousers and heavy thighs less than 7 (docs/lab/skirt.md).
const GAP_M: f32 = 0.1;
/// As much of that gap as would be there if the legs hung straight down from the hips, metres: somebody who stands astride has a wide gap
/// close below the crotch, which any trousers close. Skirts close 11 cm of it, trousers 3 at most.
const HUNG_GAP_M: f32 = 0.04;
/// Legs that stand close leave no such gap. There cloth is a skirt where, closed, it is by this much wider and deeper together than the naked
/// legs, metres, from this far below the hip on. Skirts, dresses and coats are by 17 cm and more, trousers that are closed by 5 at most,
/// wide ones that are not by 8.
const FLARE_M: f32 = 0.11;
const FLARE_FROM: f32 = 0.25;
/// Height over which filling begins below the hip, and filling and carrying end at the hem, of a leg's length.
const FADE: f32 = 0.04;
/// Width over which filling ends towards a leg's axis, of the distance from the middle to that axis.
const FADE_ACROSS: f32 = 0.15;
/// Height over which carrying begins above the hip, of a leg's length.
const FADE_ABOVE: f32 = 0.15;
/// Rounds of smoothing of what filling moves: without it, of a made coat's inner side 52 vertices stick out, with it less than 8.
const ROUNDS: usize = 4;

/// How near the middle both legs' surface is where it is a wall, of the distance from the middle to a leg's axis.
const WALL: f32 = 0.25;
/// How far a wall lies behind the cloth's front and before its back, of the way from one to the other.
const BEHIND: f32 = 0.1;

/// How far from the middle between front and back a surface stays there, of the way from one to the other.
const MIDST: f32 = 0.1;

/// How far from the middle legs begin below the hem, of the distance from the middle to a leg's axis.
const LEG: f32 = 0.6;
/// By how much what is between them is lifted, of a leg's length.
const TUCK: f32 = 0.05;

/// Such cloth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skirt {
    /// Where it ends, from hip (0) to ankle (1)
    pub hem: f32,
}

impl Skirt {
    /// Looks at the surface in the clip's mean pose.
    pub fn find(body: &Body, state: &FitState) -> Option<Self> {
        let dressed = Standing::new(body, state, &state.offsets);
        let naked = Standing::new(body, state, &vec![0.0; state.offsets.len()]);
        let rows = (0..ROWS).map(|row| row as f32 / ROWS as f32).skip_while(|&along| along < CROTCH);
        let closed = rows.take_while(|&along| dressed.section(along).iter().any(|p| p.x.abs() < MIDDLE));
        let (mut hem, mut is_wide) = (None, false);
        for along in closed {
            is_wide |= along >= FLARE_FROM && dressed.extent(along) - naked.extent(along) > FLARE_M;
            let nearest = naked.section(along).iter().map(|p| p.x.abs()).fold(f32::INFINITY, f32::min);
            if nearest.is_finite() {
                let half = naked.half_width(along);
                let leg = (1.0 - nearest) * half * naked.slant();
                is_wide |= 2.0 * nearest * half > GAP_M && 2.0 * (naked.half_width(0.0) - leg) > HUNG_GAP_M;
            }
            hem = Some(along);
        }
        hem.filter(|_| is_wide).map(|hem| Self { hem })
    }

    /// Makes one piece of what the fit has shaped of two legs. `body` loses faces and changes its weights, `state` those faces'
    /// colours; its offsets change so that the surface of the clip's mean pose stays but for valleys and walls.
    pub fn tailor(&self, body: &mut Body, state: &mut FitState) {
        self.fill(body, state, |_, outline, x, z| outline.stretched(x, z), ROUNDS);
        let seam = self.cut(body, state);
        self.close(body, state, &seam);
    }

    /// Makes a front and a back of what the cut has left, without walls between them: they go all the way. Sewn first, since the
    /// halves of a pair may lie at different depths, of which only one would go to the front.
    fn close(&self, body: &mut Body, state: &mut FitState, seam: &[[usize; 2]]) {
        sew(body, state, seam);
        let mut sewn = vec![false; body.n_vertices()];
        seam.iter().flatten().for_each(|&v| sewn[v] = true);
        // Of the seam nothing stays half way: it would be a slit down the cloth.
        let goes =
            |v: usize, outline: &Outline, x: f32, z: f32| outline.outermost(x, z, if sewn[v] { 0.0 } else { MIDST });
        self.fill(body, state, goes, 0);
        self.tuck(body, state);
        self.hang(body, state);
    }

    /// Brings the surface between the legs out to where cloth would hang that touches both, in front and behind: `goes` tells
    /// where from a vertex, a section, x and z; the way is smoothed in so many rounds.
    fn fill(&self, body: &Body, state: &mut FitState, goes: impl Fn(usize, &Outline, f32, f32) -> f32, rounds: usize) {
        let standing = Standing::new(body, state, &state.offsets);
        let outlines = self.outlines(&standing);
        let moves: Vec<Option<f32>> = (0..body.n_vertices())
            .map(|v| {
                let (z, place) = (standing.posed.vertices[v][2], standing.place(v));
                let weight =
                    self.weight(place.y) * smoothstep((1.0 - place.x.abs()) / FADE_ACROSS) * smoothstep(place.y / FADE);
                let outline = nearest(&outlines, place.y).filter(|_| weight > 0.0 && !standing.of_arm[v])?;
                Some(weight * (goes(v, outline, place.x, z) - z))
            })
            .collect();
        let moves = smoothed(&Topology::new(body.n_vertices(), &body.faces), moves, rounds);
        let moved = |(&v, dz): (&[f32; 3], &Option<f32>)| Vec3::from(v) + dz.unwrap_or(0.0) * Vec3::Z;
        let vertices: Vec<Vec3> = standing.posed.vertices.iter().zip(&moves).map(moved).collect();
        standing.lay(body, state, &vertices);
    }

    /// Leaves out the faces of the legs' inner sides that lie between the cloth's front and back: nobody sees them, and cloth has
    /// none there. Returns the pairs of vertices, left and right, along the cut.
    fn cut(&self, body: &mut Body, state: &mut FitState) -> Vec<[usize; 2]> {
        let standing = Standing::new(body, state, &state.offsets);
        let outlines = self.outlines(&standing);
        let is_inside = |v: usize| {
            let (z, place) = (standing.posed.vertices[v][2], standing.place(v));
            let hidden = (0.0..self.hem).contains(&place.y) && place.x.abs() < WALL && !standing.of_arm[v];
            let depth = nearest(&outlines, place.y).filter(|_| hidden).map_or(0.0, |o| o.depth(place.x, z));
            (BEHIND..1.0 - BEHIND).contains(&depth)
        };
        let mirror = |v: usize| body.mirror[v] as usize;
        let wall: Vec<bool> =
            (0..body.n_vertices()).map(|v| mirror(v) != v && is_inside(v) && is_inside(mirror(v))).collect();
        let stays: Vec<bool> = body.faces.iter().map(|face| !face.iter().any(|&v| wall[v as usize])).collect();
        let mut seam: Vec<[usize; 2]> = Vec::new();
        for (face, _) in body.faces.iter().zip(&stays).filter(|(_, stays)| !**stays) {
            let edge = face.iter().map(|&v| v as usize).filter(|&v| !wall[v] && mirror(v) != v);
            seam.extend(edge.map(|v| [v.min(mirror(v)), v.max(mirror(v))]));
        }
        seam.sort_unstable();
        seam.dedup();
        retain(&mut body.faces, &stays);
        retain(&mut body.uv_faces, &stays);
        let mut colours = state.face_colours.as_chunks::<3>().0.to_vec();
        retain(&mut colours, &stays);
        state.face_colours = colours.concat();
        seam
    }

    /// Lifts what closes the cloth from below into it, between the legs: no silhouette shows how far it hangs down there, behind
    /// the hem's front.
    fn tuck(&self, body: &Body, state: &mut FitState) {
        let standing = Standing::new(body, state, &state.offsets);
        let outlines = self.outlines(&standing);
        let leg = standing.height(0) - standing.height(2);
        let mut vertices: Vec<Vec3> = standing.posed.vertices.iter().map(|&v| v.into()).collect();
        for v in (0..body.n_vertices()).filter(|&v| !standing.of_arm[v]) {
            let place = standing.place(v);
            let Some(outline) = nearest(&outlines, place.y).filter(|_| (place.y - self.hem).abs() < 2.0 * TUCK) else {
                continue;
            };
            let depth = outline.depth(place.x, vertices[v].z);
            let within = smoothstep((LEG - place.x.abs()) / 0.3) * smoothstep(depth.min(1.0 - depth) / BEHIND - 1.0);
            vertices[v].y += within * TUCK * leg;
        }
        standing.lay(body, state, &vertices);
    }

    /// Sections from hip to hem, by their height.
    fn outlines(&self, standing: &Standing) -> Vec<(f32, Outline)> {
        let heights = (0..=ROWS).map(|row| self.hem * row as f32 / ROWS as f32);
        heights.filter_map(|along| Some((along, Outline::of(&standing.section(along))?))).collect()
    }

    /// Lets both thighs carry the cloth, between them each the more the nearer it is; what hangs beyond a leg goes with that one. No knee
    /// bends it. The surface of the clip's mean pose stays.
    fn hang(&self, body: &mut Body, state: &mut FitState) {
        let standing = Standing::new(body, state, &state.offsets);
        for v in (0..body.n_vertices()).filter(|&v| !standing.of_arm[v]) {
            let place = standing.place(v);
            let hanging = self.weight(place.y) * smoothstep((place.y + FADE_ABOVE) / FADE_ABOVE);
            let mut weights = weights(body, v);
            for (thigh, shank) in THIGHS.into_iter().zip(SHANKS) {
                let hangs = hanging * weights[shank];
                (weights[thigh], weights[shank]) = (weights[thigh] + hangs, weights[shank] - hangs);
            }
            for [left, right] in [THIGHS, SHANKS] {
                let both = weights[left] + weights[right];
                if both > 0.0 {
                    let share = weights[left] / both;
                    let share = share + hanging * (smoothstep(0.5 + 0.5 * place.x) - share);
                    (weights[left], weights[right]) = (both * share, both * (1.0 - share));
                }
            }
            (body.lbs_joints[v], body.lbs_weights[v]) = strongest(&weights);
        }
        let vertices: Vec<Vec3> = standing.posed.vertices.iter().map(|&v| v.into()).collect();
        standing.lay(body, state, &vertices);
    }

    /// One on the cloth, zero below the hem.
    fn weight(&self, along: f32) -> f32 {
        smoothstep((self.hem + 0.25 * FADE - along) / FADE)
    }
}

/// Closes the cut: each pair meets half way in the clip's mean pose, with weights half way as well, so that it stays closed in all
/// others (but for blend shapes of the pose, if the body has any: they may differ by side).
fn sew(body: &mut Body, state: &mut FitState, seam: &[[usize; 2]]) {
    let standing = Standing::new(body, state, &state.offsets);
    let mut vertices: Vec<Vec3> = standing.posed.vertices.iter().map(|&v| v.into()).collect();
    for &[a, b] in seam {
        let middle = vertices[a].midpoint(vertices[b]);
        let (of_a, of_b) = (weights(body, a), weights(body, b));
        let mean = strongest(&std::array::from_fn(|j| 0.5 * (of_a[j] + of_b[j])));
        for v in [a, b] {
            vertices[v] = middle;
            (body.lbs_joints[v], body.lbs_weights[v]) = mean;
        }
    }
    standing.lay(body, state, &vertices);
}

/// The section that is nearest to a height.
fn nearest(outlines: &[(f32, Outline)], along: f32) -> Option<&Outline> {
    let nearest = outlines.iter().min_by(|a, b| (a.0 - along).abs().total_cmp(&(b.0 - along).abs()));
    nearest.map(|(_, outline)| outline)
}

/// Keeps the rows that stay; there may be none at all.
fn retain<T>(rows: &mut Vec<T>, stays: &[bool]) {
    let mut stays = stays.iter();
    rows.retain(|_| *stays.next().expect("a row for each"));
}

/// Numbers of vertices, each drawn towards its neighbours' mean; those that have none count as zero and stay.
fn smoothed(topology: &Topology, mut values: Vec<Option<f32>>, rounds: usize) -> Vec<Option<f32>> {
    for _ in 0..rounds {
        let mean = |v: usize| {
            let around = topology.neighbours.row(v);
            let sum: f32 = around.iter().map(|&n| values[n as usize].unwrap_or(0.0)).sum();
            sum / around.len().max(1) as f32
        };
        values = values.iter().enumerate().map(|(v, value)| value.map(|value| 0.5 * (value + mean(v)))).collect();
    }
    values
}

/// The weights of a vertex by joint.
fn weights(body: &Body, v: usize) -> [f32; N_JOINTS] {
    let mut weights = [0.0; N_JOINTS];
    for (&joint, weight) in body.lbs_joints[v].iter().zip(body.lbs_weights[v]) {
        weights[joint as usize] += weight;
    }
    weights
}

/// The greatest weights of all joints, with a sum of one.
fn strongest(weights: &[f32; N_JOINTS]) -> ([u32; N_INFLUENCES], [f32; N_INFLUENCES]) {
    let mut order: Vec<usize> = (0..N_JOINTS).filter(|&j| weights[j] > 0.0).collect();
    order.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]));
    order.truncate(N_INFLUENCES);
    let sum: f32 = order.iter().map(|&j| weights[j]).sum();
    let kept = |k: usize| order.get(k).map_or((0, 0.0), |&j| (j as u32, weights[j] / sum));
    (std::array::from_fn(|k| kept(k).0), std::array::from_fn(|k| kept(k).1))
}

#[cfg(test)]
mod tests;
