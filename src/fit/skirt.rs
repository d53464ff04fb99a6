//! Cloth that hangs from leg to leg: a skirt, a dress, a long coat. The body's legs are two, so a fit that follows the masks
//! leaves a valley between them, in front and behind, that no silhouette shows, and legs that take half of the cloth each with
//! them when they part. Neither is in the paper. Here such cloth is found, its valleys are filled, and it is carried by both legs.

use glam::{Mat3, Vec2, Vec3};

use super::state::FitState;
use crate::body::{Body, N_INFLUENCES, N_JOINTS};
use crate::ops::Topology;
use crate::ops::skinning::cpu::{Posed, Transform, forward};

/// Numbers of a pose
const N_POSE: usize = 3 * N_JOINTS;
/// Hip, knee, ankle: left, right.
const LEGS: [[usize; 3]; 2] = [[1, 4, 7], [2, 5, 8]];
/// Thighs and shanks: left, right.
const CARRYING: [[usize; 2]; 2] = [[1, 2], [4, 5]];
/// From the upper arms on.
const ARMS: std::ops::Range<u32> = 16..24;

/// Heights that are looked at, between hip (0) and ankle (1).
const ROWS: usize = 48;
/// Where the legs of a naked body part, and how near the middle a surface must come to close it, of a leg's distance from it.
const CROTCH: f32 = 0.1;
const MIDDLE: f32 = 0.15;
/// Cloth is no trousers where it closes a gap that is this wide between the naked legs, metres. Skirts to the knees and longer
/// close 18 cm and more; overalls with a low crotch, wide trousers and heavy thighs less than 7 (docs/lab/skirt.md).
const GAP_M: f32 = 0.1;
/// Heights over which filling begins below the hip, and filling and carrying end at the hem, of a leg.
const FADE: f32 = 0.04;
/// The same towards a leg's axis, of its distance from the middle, and for carrying above the hip, of a leg.
const FADE_ACROSS: f32 = 0.15;
const FADE_ABOVE: f32 = 0.15;
/// Places across a section at which its front and back are told.
const PLACES: usize = 41;
/// Rounds of smoothing of what filling moves: without it, of a made coat's inner side 52 vertices stick out, with it less than 8.
const ROUNDS: usize = 4;

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
        let (mut hem, mut widest) = (None, 0.0f32);
        for along in closed {
            let nearest = naked.section(along).iter().map(|p| p.x.abs()).fold(f32::INFINITY, f32::min);
            if nearest.is_finite() {
                widest = widest.max(2.0 * nearest * naked.half_width(along));
            }
            hem = Some(along);
        }
        hem.filter(|_| widest > GAP_M).map(|hem| Self { hem })
    }

    /// Brings the surface between the legs out to where cloth would hang that touches both, in front and behind.
    pub fn fill(&self, body: &Body, state: &mut FitState) {
        let standing = Standing::new(body, state, &state.offsets);
        let rows: Vec<(f32, Outline)> = (0..=ROWS)
            .map(|row| self.hem * row as f32 / ROWS as f32)
            .filter_map(|along| Some((along, Outline::of(&standing.section(along))?)))
            .collect();
        let moves: Vec<Option<f32>> = (0..body.n_vertices())
            .map(|v| {
                let (z, place) = (standing.posed.vertices[v][2], standing.place(v));
                let weight =
                    self.weight(place.y) * smooth((1.0 - place.x.abs()) / FADE_ACROSS) * smooth(place.y / FADE);
                let nearest = rows.iter().min_by(|a, b| (a.0 - place.y).abs().total_cmp(&(b.0 - place.y).abs()));
                let (_, outline) = nearest.filter(|_| weight > 0.0 && !standing.of_arm[v])?;
                Some(weight * (outline.filled(place.x, z) - z))
            })
            .collect();
        let moves = smoothed(&Topology::new(body.n_vertices(), &body.faces), moves);
        let moved = |(&v, dz): (&[f32; 3], &Option<f32>)| Vec3::from(v) + dz.unwrap_or(0.0) * Vec3::Z;
        let vertices: Vec<Vec3> = standing.posed.vertices.iter().zip(&moves).map(moved).collect();
        standing.lay(body, state, &vertices);
    }

    /// Lets both legs carry the cloth between them, each the more the nearer it is; what hangs beyond a leg goes with that one.
    /// The surface of the clip's mean pose stays.
    pub fn hang(&self, body: &mut Body, state: &mut FitState) {
        let standing = Standing::new(body, state, &state.offsets);
        for v in (0..body.n_vertices()).filter(|&v| !standing.of_arm[v]) {
            let place = standing.place(v);
            let hanging = self.weight(place.y) * smooth((place.y + FADE_ABOVE) / FADE_ABOVE);
            let mut weights = [0.0f32; N_JOINTS];
            for (&joint, weight) in body.lbs_joints[v].iter().zip(body.lbs_weights[v]) {
                weights[joint as usize] += weight;
            }
            for [left, right] in CARRYING {
                let both = weights[left] + weights[right];
                if both > 0.0 {
                    let share = weights[left] / both;
                    let share = share + hanging * (smooth(0.5 + 0.5 * place.x) - share);
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
        smooth((self.hem + 0.25 * FADE - along) / FADE)
    }
}

fn smooth(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Numbers of vertices, each drawn towards its neighbours' mean; those that have none count as zero and stay.
fn smoothed(topology: &Topology, mut values: Vec<Option<f32>>) -> Vec<Option<f32>> {
    for _ in 0..ROUNDS {
        let mean = |v: usize| {
            let around = topology.neighbours.row(v);
            let sum: f32 = around.iter().map(|&n| values[n as usize].unwrap_or(0.0)).sum();
            sum / around.len().max(1) as f32
        };
        values = values.iter().enumerate().map(|(v, value)| value.map(|value| 0.5 * (value + mean(v)))).collect();
    }
    values
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

/// The body in the clip's mean pose, upright: x to its left, y up, z ahead.
struct Standing {
    posed: Posed<f32>,
    of_arm: Vec<bool>,
    /// Edges of the surface without arms
    edges: Vec<[u32; 2]>,
}

impl Standing {
    fn new(body: &Body, state: &FitState, offsets: &[f32]) -> Self {
        let n = state.n_frames().max(1) as f32;
        let mut pose = [0.0; N_POSE];
        for frame in state.poses.chunks(N_POSE) {
            pose.iter_mut().zip(frame).for_each(|(mean, angle)| *mean += angle / n);
        }
        pose[..3].fill(0.0);
        let posed = forward(body, &state.betas, Some(offsets.as_chunks().0), &pose, [0.0; 3]);
        let is_of_arm = |v| body.weight_of(v, |joint| ARMS.contains(&joint)) > 0.5;
        let of_arm: Vec<bool> = (0..body.n_vertices()).map(is_of_arm).collect();
        let edges = body.faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let edges = edges.filter(|edge| edge.iter().all(|&v| !of_arm[v as usize])).collect();
        Self { posed, of_arm, edges }
    }

    fn joint(&self, side: usize, k: usize) -> Vec3 {
        self.posed.joints[LEGS[side][k]].into()
    }

    /// Height of hips, of knees, of ankles: the mean of both.
    fn height(&self, k: usize) -> f32 {
        0.5 * (self.joint(0, k).y + self.joint(1, k).y)
    }

    /// x of both legs' axes; above the hips, that of the hips.
    fn axes(&self, along: f32) -> [f32; 2] {
        let knee = (self.height(0) - self.height(1)) / (self.height(0) - self.height(2));
        let between = |side: usize, k: usize, t: f32| self.joint(side, k).lerp(self.joint(side, k + 1), t).x;
        [0, 1].map(|side| match along < knee {
            true => between(side, 0, (along / knee).max(0.0)),
            false => between(side, 1, (along - knee) / (1.0 - knee)),
        })
    }

    /// Half of the distance between the legs' axes, metres.
    fn half_width(&self, along: f32) -> f32 {
        let [left, right] = self.axes(along);
        (0.5 * (left - right)).max(1e-3)
    }

    /// x between the legs' axes (−1 the right one's, 1 the left one's), y from hip (0) to ankle (1).
    fn place(&self, v: usize) -> Vec2 {
        let [x, y, _] = self.posed.vertices[v];
        let along = (self.height(0) - y) / (self.height(0) - self.height(2));
        Vec2::new(self.across(x, along), along)
    }

    fn across(&self, x: f32, along: f32) -> f32 {
        let [left, right] = self.axes(along);
        (x - 0.5 * (left + right)) / self.half_width(along)
    }

    /// Where the surface crosses a height: x as of [`Standing::place`], and z in metres.
    fn section(&self, along: f32) -> Vec<Vec2> {
        let y = self.height(0) + along * (self.height(2) - self.height(0));
        let at = |v: u32| Vec3::from(self.posed.vertices[v as usize]);
        let crossing = |[a, b]: [u32; 2]| {
            let (a, b) = (at(a), at(b));
            let point = a.lerp(b, (y - a.y) / (b.y - a.y));
            ((a.y < y) != (b.y < y)).then(|| Vec2::new(self.across(point.x, along), point.z))
        };
        self.edges.iter().filter_map(|&edge| crossing(edge)).collect()
    }

    /// Sets the offsets so that the body, by its present weights, has these vertices in this pose.
    fn lay(&self, body: &Body, state: &mut FitState, vertices: &[Vec3]) {
        for (v, (offset, &vertex)) in state.offsets.as_chunks_mut::<3>().0.iter_mut().zip(vertices).enumerate() {
            let (rotation, translation) = blend(&self.posed.transforms, &body.lbs_joints[v], &body.lbs_weights[v]);
            let rest = rotation.inverse() * (vertex - translation);
            // Blend shapes of the pose are added between offset and skinning, and are as they were.
            *offset = (Vec3::from(*offset) + rest - Vec3::from(self.posed.v_posed[v])).into();
        }
    }
}

/// Linear blend skinning's transform of one vertex.
fn blend(transforms: &[Transform<f32>], joints: &[u32], weights: &[f32]) -> (Mat3, Vec3) {
    let mut sum = (Mat3::ZERO, Vec3::ZERO);
    for (&joint, &weight) in joints.iter().zip(weights) {
        let Transform { rotation, translation } = &transforms[joint as usize];
        // Rows, as the operators keep them.
        sum.0 += weight * Mat3::from_cols_array_2d(rotation).transpose();
        sum.1 += weight * Vec3::from(*translation);
    }
    sum
}

/// Front and back of a section between the legs' axes.
struct Outline {
    /// `[PLACES]` from the right axis to the left: back and front of the surface
    surface: Vec<[f32; 2]>,
    /// The same of its convex hull
    hull: Vec<[f32; 2]>,
}

impl Outline {
    /// `None` where a leg is not there.
    fn of(section: &[Vec2]) -> Option<Self> {
        let mut points: Vec<Vec2> = section.iter().copied().filter(|p| p.x.abs() < 1.2).collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        if points.first()?.x > -0.9 || points.last()?.x < 0.9 {
            return None;
        }
        let (front, back) = (upper_hull(&points, 1.0), upper_hull(&points, -1.0));
        let width = 2.0 / (PLACES - 1) as f32;
        let (mut surface, mut hull) = (Vec::new(), Vec::new());
        for k in 0..PLACES {
            let x = -1.0 + width * k as f32;
            let here = points.iter().filter(|p| (p.x - x).abs() <= 1.5 * width).map(|p| p.y);
            let (low, high) = here.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
            let outer = [-height_at(&back, x), height_at(&front, x)];
            hull.push(outer);
            surface.push(if low < high { [low, high] } else { outer });
        }
        Some(Self { surface, hull })
    }

    /// Where `z` goes when the surface at `x` is stretched to the hull.
    fn filled(&self, x: f32, z: f32) -> f32 {
        let at = (0.5 * (x + 1.0)).clamp(0.0, 1.0) * (PLACES - 1) as f32;
        let (k, t) = ((at as usize).min(PLACES - 2), at - (at as usize).min(PLACES - 2) as f32);
        let between = |of: &[[f32; 2]], side: usize| of[k][side] + t * (of[k + 1][side] - of[k][side]);
        let [back, front] = [0, 1].map(|side| between(&self.surface, side));
        let [hull_back, hull_front] = [0, 1].map(|side| between(&self.hull, side));
        let part = ((z - back) / (front - back).max(0.01)).clamp(0.0, 1.0);
        hull_back + part * (hull_front - hull_back)
    }
}

/// The upper convex hull of points that are sorted by x, their y times `sign`.
fn upper_hull(points: &[Vec2], sign: f32) -> Vec<Vec2> {
    let mut hull: Vec<Vec2> = Vec::new();
    for point in points.iter().map(|p| Vec2::new(p.x, sign * p.y)) {
        while let [.., a, b] = hull[..]
            && (b - a).perp_dot(point - a) >= 0.0
        {
            hull.pop();
        }
        hull.push(point);
    }
    hull
}

/// The height of a line of points sorted by x.
fn height_at(line: &[Vec2], x: f32) -> f32 {
    let next = line.partition_point(|p| p.x < x).clamp(1, line.len() - 1);
    let (a, b) = (line[next - 1], line[next]);
    a.y + (b.y - a.y) * ((x - a.x) / (b.x - a.x).max(1e-6)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::texture_field::TextureFieldConfig;

    /// Legs apart as in an A-pose, in two frames that differ a little.
    fn standing(body: &Body) -> FitState {
        let pose = |more: f32| {
            let mut pose = [0.0; N_POSE];
            pose[1] = 2.0 + more;
            (pose[5], pose[8]) = (0.12 + 0.01 * more, -0.12 - 0.01 * more);
            pose
        };
        let betas = vec![0.0; body.n_betas];
        let poses = [pose(-1.0), pose(1.0)];
        FitState::new(body, betas, &poses, &[[0.0, 0.0, 3.0]; 2], TextureFieldConfig::default(), 0)
    }

    /// Draws the insides of both legs to the middle, from the crotch to `hem`, with a valley there.
    fn wear(body: &Body, state: &mut FitState, hem: f32) {
        let standing = Standing::new(body, state, &state.offsets);
        let dressed: Vec<Vec3> = (0..body.n_vertices())
            .map(|v| {
                let (place, point) = (standing.place(v), Vec3::from(standing.posed.vertices[v]));
                let inside = place.x.abs() < 1.0 && (0.0..hem).contains(&place.y) && !standing.of_arm[v];
                let [left, right] = standing.axes(place.y);
                let (middle, half) = (0.5 * (left + right), standing.half_width(place.y));
                // A leg's inside is less than half as far from its axis as the middle is.
                let near = (1.0 - 2.6 * (1.0 - place.x.abs())).max(0.0);
                let dressed =
                    Vec3 { x: middle + half * near * place.x.signum(), z: point.z * (0.4 + 0.6 * near), ..point };
                if inside { dressed } else { point }
            })
            .collect();
        standing.lay(body, state, &dressed);
    }

    fn largest_change(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
        a.iter().zip(b).map(|(&a, &b)| Vec3::from(a).distance(b.into())).fold(0.0, f32::max)
    }

    #[test]
    fn a_skirt_is_found_and_bare_legs_are_none() {
        let body = Body::test_body();
        let mut state = standing(&body);
        assert_eq!(Skirt::find(&body, &state), None);
        wear(&body, &mut state, 0.6);
        let hem = Skirt::find(&body, &state).expect("a skirt").hem;
        assert!((0.45..0.65).contains(&hem), "{hem}");
    }

    #[test]
    fn legs_that_touch_are_no_skirt() {
        let body = Body::test_body();
        let mut state = standing(&body);
        for closer in [-0.04, -0.08, -0.12] {
            for pose in state.poses.chunks_mut(N_POSE) {
                (pose[5], pose[8]) = (closer, -closer);
            }
            assert_eq!(Skirt::find(&body, &state), None, "{closer}");
        }
        let standing = Standing::new(&body, &state, &state.offsets);
        let between = standing.section(0.9).iter().map(|p| p.x.abs()).fold(f32::INFINITY, f32::min);
        assert!(between * standing.half_width(0.9) < 0.01, "the shanks touch");
    }

    #[test]
    fn a_hung_skirt_stays_where_it_was_and_stays_closed_when_legs_part() {
        let mut body = Body::test_body();
        let mut state = standing(&body);
        wear(&body, &mut state, 0.6);
        let skirt = Skirt::find(&body, &state).unwrap();
        let before = Standing::new(&body, &state, &state.offsets);
        let parted = |body: &Body, state: &FitState| {
            let mut pose = [0.0; N_POSE];
            (pose[5], pose[8]) = (0.5, -0.5);
            let posed = forward(body, &state.betas, Some(state.offsets.as_chunks().0), &pose, [0.0; 3]);
            // Of what lay in the middle: how far from it the farthest is now.
            let middle = (0..body.n_vertices()).filter(|&v| {
                let place = before.place(v);
                place.x.abs() < 0.02 && (0.25..skirt.hem - FADE).contains(&place.y) && !before.of_arm[v]
            });
            middle.map(|v| posed.vertices[v][0].abs()).fold(0.0, f32::max)
        };
        let open = parted(&body, &state);
        skirt.hang(&mut body, &mut state);
        body.check().unwrap();
        let after = Standing::new(&body, &state, &state.offsets);
        assert!(largest_change(&before.posed.vertices, &after.posed.vertices) < 1e-4);
        let closed = parted(&body, &state);
        assert!(open > 0.05 && closed < 0.2 * open, "{closed} m, {open} without");
    }

    #[test]
    fn valleys_between_the_legs_are_filled_and_nothing_else_moves() {
        let body = Body::test_body();
        let mut state = standing(&body);
        wear(&body, &mut state, 0.6);
        let skirt = Skirt::find(&body, &state).unwrap();
        let before = Standing::new(&body, &state, &state.offsets);
        skirt.fill(&body, &mut state);
        let after = Standing::new(&body, &state, &state.offsets);
        let extent = |standing: &Standing| {
            let section = standing.section(0.5 * skirt.hem);
            let z = section.iter().filter(|p| p.x.abs() < MIDDLE).map(|p| p.y);
            let (low, high) = z.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
            high - low
        };
        assert!(extent(&after) > 1.5 * extent(&before), "{} m deep, {} before", extent(&after), extent(&before));
        for v in 0..body.n_vertices() {
            let place = before.place(v);
            let moved = largest_change(&before.posed.vertices[v..=v], &after.posed.vertices[v..=v]);
            assert!(moved < 1e-4 || place.x.abs() < 1.0 && (0.0..0.7).contains(&place.y), "{place} moved by {moved} m");
        }
    }

    #[test]
    fn hulls_have_no_valleys() {
        let points: Vec<Vec2> =
            [(-1.0, 0.2), (-0.5, 0.6), (0.0, 0.1), (0.5, 0.6), (1.0, 0.0)].map(|(x, z)| Vec2::new(x, z)).to_vec();
        let front = upper_hull(&points, 1.0);
        assert_eq!([-0.5, 0.0, 0.25].map(|x| height_at(&front, x)), [0.6; 3]);
        assert!((-height_at(&upper_hull(&points, -1.0), 0.0) - 0.1).abs() < 1e-6);
    }
}
