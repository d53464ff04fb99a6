//! Cloth that hangs around both legs: a surface of its own, which no displacement of a body has.

use std::f32::consts::TAU;
use std::ops::Range;

use glam::Vec3;

use super::clothes::{Dress, Outfit, REGIONS, Region, step};
use crate::body::Body;

/// The cut of a skirt, or of a coat's lower half.
pub(super) struct Skirt {
    /// Height of the hem, from hip (0) to ankle (1)
    hem: f32,
    /// Metres at the hem beyond the fit
    flare: f32,
    region: Region,
}

impl Skirt {
    pub fn of(outfit: Outfit) -> Option<Self> {
        match outfit {
            Outfit::Skirt => Some(Self { hem: 0.5, flare: 0.06, region: Region::Bottom }),
            Outfit::Coat => Some(Self { hem: 0.72, flare: 0.04, region: Region::Top }),
            _ => None,
        }
    }
}

const ROWS: usize = 32;
const COLUMNS: usize = 96;
/// Metres between the cloth and the widest part of the body above it
const EASE: f32 = 0.006;
/// Folds around the hem, and their part of the radius there
const FOLDS: (f32, f32) = (9.0, 0.04);
/// The section is a superellipse: wide enough for both legs side by side.
const SECTION: f32 = 2.6;
/// Legs are seen this far up from the hem, metres.
const SEEN_UNDER_HEM: f32 = 0.06;

/// The body of shape `betas` with the skirt sewn on, its vertices after the body's, and the dress with it. Faces of the
/// body that the skirt hides are left out: nobody sees them, and they are no part of a dressed person's surface.
pub(super) fn sew(body: &Body, betas: &[f32], mut dress: Dress, skirt: &Skirt) -> (Body, Dress) {
    let joints: Vec<Vec3> = body.shaped_joints(betas).into_iter().map(Vec3::from).collect();
    let waist = 0.5 * (joints[0].y + joints[3].y);
    let hem = joints[1].y - skirt.hem * (joints[1].y - joints[7].y);
    let of_arm: Vec<bool> =
        (0..body.n_vertices()).map(|v| body.weight_of(v, |joint| (16..24).contains(&joint)) > 0.5).collect();

    let cloth = surface(&dress.rest, &body.faces, &of_arm, waist..hem, skirt.flare);

    let mut body = body.clone();
    let hidden = |&v: &u32| {
        let y = dress.rest[v as usize][1];
        !of_arm[v as usize] && y < waist - EASE && y > hem + SEEN_UNDER_HEM
    };
    body.faces.retain(|face| !face.iter().all(hidden));

    let first = body.n_vertices();
    let claim: [f32; 5] = std::array::from_fn(|k| if REGIONS[k] == skirt.region { 1.0 } else { 0.0 });
    for (i, &point) in cloth.iter().enumerate() {
        let (row, column) = (i / COLUMNS, i % COLUMNS);
        let (joints, weights) = skinning(point, waist, joints[1]);
        body.lbs_joints.push(joints);
        body.lbs_weights.push(weights);
        body.mirror.push((first + row * COLUMNS + COLUMNS - 1 - column) as u32);
        body.v_template.push(point.into());
        dress.rest.push(point.into());
        dress.offsets.push([0.0; 3]);
        dress.claims.push(claim);
    }
    let vertex = |row: usize, column: usize| (first + row * COLUMNS + column % COLUMNS) as u32;
    for (row, column) in (0..ROWS).flat_map(|row| (0..COLUMNS).map(move |column| (row, column))) {
        let (lower, right) = (vertex(row + 1, column), vertex(row + 1, column + 1));
        let (upper, across) = (vertex(row, column), vertex(row, column + 1));
        body.faces.extend([[lower, right, across], [lower, across, upper]]);
    }
    // The cloth neither grows with the body nor bulges with its joints.
    body.shapedirs.resize(body.v_template.len() * 3 * body.n_betas, 0.0);
    if !body.posedirs.is_empty() {
        let rows = body.posedirs.chunks(first * 3);
        let still = vec![0.0; cloth.len() * 3];
        body.posedirs = rows.flat_map(|row| row.iter().chain(&still)).copied().collect();
    }
    body.uvs.clear();
    body.uv_faces.clear();
    (body, dress)
}

/// Rows from waist to hem, each from the back's left round the front to its right: it hangs from the widest place above.
fn surface(
    rest: &[[f32; 3]],
    faces: &[[u32; 3]],
    of_arm: &[bool],
    Range { start: waist, end: hem }: Range<f32>,
    flare: f32,
) -> Vec<Vec3> {
    let edges: Vec<[Vec3; 2]> = faces
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .filter(|edge| edge.iter().all(|&v| !of_arm[v as usize]))
        .map(|edge| edge.map(|v| Vec3::from(rest[v as usize])))
        .collect();
    let step = (waist - hem) / ROWS as f32;
    let mut rows = Vec::with_capacity((ROWS + 1) * COLUMNS);
    let (mut side, mut back, mut front) = (0.0f32, f32::INFINITY, f32::NEG_INFINITY);
    for row in 0..=ROWS {
        let down = row as f32 / ROWS as f32;
        let y = waist - step * row as f32;
        for [a, b] in edges.iter().filter(|[a, b]| (a.y < y) != (b.y < y)) {
            let v = a.lerp(*b, (y - a.y) / (b.y - a.y));
            (side, back, front) = (side.max(v.x.abs()), back.min(v.z), front.max(v.z));
        }
        let wider = EASE + flare * down;
        let (a, b, middle) = (side + wider, 0.5 * (front - back) + wider, 0.5 * (front + back));
        for column in 0..COLUMNS {
            let angle = TAU * (column as f32 + 0.5) / COLUMNS as f32;
            let (x, z) = (-angle.sin(), -angle.cos());
            let edge = (x.abs().powf(SECTION) + z.abs().powf(SECTION)).powf(-1.0 / SECTION);
            let fold = 1.0 + FOLDS.1 * down * (FOLDS.0 * (angle + 0.5 * TAU)).cos();
            rows.push(Vec3::new(a * edge * fold * x, y, middle + b * edge * fold * z));
        }
    }
    rows
}

/// Held by the pelvis at the waist and carried by the thighs below, in front and behind by both.
fn skinning(point: Vec3, waist: f32, hip: Vec3) -> ([u32; 4], [f32; 4]) {
    let carried = step(waist, hip.y - 0.12, point.y);
    let width = 1.5 * hip.x.abs();
    let left = step(-width, width, point.x);
    ([0, 1, 2, 0], [1.0 - carried, carried * left, carried * (1.0 - left), 0.0])
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::super::clothes::dress;
    use super::*;

    #[test]
    fn a_skirt_hangs_around_both_legs_and_hides_them() {
        let body = Body::test_body();
        let betas = vec![0.0; body.n_betas];
        let bare = dress(&body, &betas, Outfit::Skirt, &mut Pcg64::seed_from_u64(1));
        let (sewn, dressed) = sew(&body, &betas, bare, &Skirt::of(Outfit::Skirt).unwrap());
        sewn.check().unwrap();
        assert_eq!(sewn.n_vertices(), body.n_vertices() + (ROWS + 1) * COLUMNS);
        assert_eq!(dressed.rest.len(), sewn.n_vertices());

        let cloth = &sewn.v_template[body.n_vertices()..];
        let joints = sewn.shaped_joints(&betas);
        for knee_side in [joints[1], joints[2]] {
            let below_hip = knee_side[1] - 0.1;
            let ring: Vec<_> = cloth.iter().filter(|v| (v[1] - below_hip).abs() < 0.03).collect();
            assert!(ring.iter().any(|v| v[0] > knee_side[0] + 0.03) && ring.iter().any(|v| v[0] < knee_side[0] - 0.03));
        }
        // Outwards, whichever side; and mirrored.
        for face in sewn.faces.iter().filter(|face| face[0] as usize >= body.n_vertices()) {
            let [a, b, c] = face.map(|v| Vec3::from(sewn.v_template[v as usize]));
            let outwards = Vec3::new(a.x + b.x + c.x, 0.0, a.z + b.z + c.z);
            assert!((b - a).cross(c - a).dot(outwards) > 0.0, "{face:?}");
        }
        for v in body.n_vertices()..sewn.n_vertices() {
            let (here, there) = (sewn.v_template[v], sewn.v_template[sewn.mirror[v] as usize]);
            assert!((here[0] + there[0]).abs() < 1e-4 && (here[1] - there[1]).abs() < 1e-6, "{here:?} {there:?}");
        }
    }
}
