//! Whether the fitted surface is clean: spikes, folded faces, and what no frame has shown.

use glam::Vec3;
use serde::Serialize;

use super::flag::{Flag, Kind};
use crate::ops::Topology;

/// An edge this many times as long as the body's own, or a vertex this many edges further out of its neighbours' middle than
/// the body's own, is a spike: cloth stretches and folds by less.
const STRETCH: f32 = 5.0;
const STICK_OUT: f32 = 1.5;
/// Edges below count as this long: eyelids and nails have edges of which folds are many times as long.
const SHORTEST_EDGE_M: f32 = 0.005;
/// Of the surface.
const FLIPPED: f64 = 0.005;
const UNSEEN: f64 = 0.1;
/// Of the vertices.
const SPIKES: f64 = 0.001;

/// What was found on the avatar in the T-pose.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SurfaceCheck {
    pub vertices: usize,
    /// Vertices that stick out.
    pub spikes: usize,
    /// The ten farthest of them, by index, the worst first.
    pub worst_spikes: Vec<u32>,
    /// The longest edge over the body's own.
    pub largest_stretch: f64,
    /// Faces that look against the same face of the undressed body.
    pub flipped_faces: usize,
    /// Parts of the surface's area, 0 to 1.
    pub flipped_area: f64,
    pub unseen_area: f64,
}

/// `dressed` and `undressed` `[V, 3]` are the T-pose with and without the offsets, metres; `seen [F]` says which faces a
/// fitted frame shows.
///
/// # Panics
/// When the lengths differ.
pub fn check_surface(dressed: &[[f32; 3]], undressed: &[[f32; 3]], faces: &[[u32; 3]], seen: &[bool]) -> SurfaceCheck {
    assert_eq!((dressed.len(), faces.len()), (undressed.len(), seen.len()), "lengths");
    let topology = Topology::new(dressed.len(), faces);
    let (dressed, undressed) = (points(dressed), points(undressed));
    let mut spikes: Vec<(f32, u32)> = Vec::new();
    let mut largest = 0.0f32;
    for (v, neighbours) in topology.neighbours.iter().enumerate().filter(|(_, n)| !n.is_empty()) {
        let (out, stretch) = sticks_out(&dressed, &undressed, v, neighbours);
        largest = largest.max(stretch);
        let excess = (out / STICK_OUT).max(stretch / STRETCH);
        if excess > 1.0 {
            spikes.push((excess, v as u32));
        }
    }
    spikes.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut flipped_faces, mut area, mut flipped, mut unseen) = (0, 0.0, 0.0, 0.0);
    for (face, seen) in faces.iter().zip(seen) {
        let [now, own] = [&dressed, &undressed].map(|points| normal(points, face));
        let weight = f64::from(now.length());
        area += weight;
        if now.dot(own) < 0.0 {
            flipped_faces += 1;
            flipped += weight;
        }
        unseen += if *seen { 0.0 } else { weight };
    }
    let area = area.max(f64::MIN_POSITIVE);
    SurfaceCheck {
        vertices: dressed.len(),
        spikes: spikes.len(),
        worst_spikes: spikes.iter().take(10).map(|(_, v)| *v).collect(),
        largest_stretch: f64::from(largest),
        flipped_faces,
        flipped_area: flipped / area,
        unseen_area: unseen / area,
    }
}

fn points(rows: &[[f32; 3]]) -> Vec<Vec3> {
    rows.iter().map(|&row| Vec3::from(row)).collect()
}

fn normal(points: &[Vec3], face: &[u32; 3]) -> Vec3 {
    let [a, b, c] = face.map(|i| points[i as usize]);
    (b - a).cross(c - a)
}

/// How many of its edges a vertex lies further out of its neighbours' middle than the body's own, and how many times as long
/// its longest edge is.
fn sticks_out(dressed: &[Vec3], undressed: &[Vec3], v: usize, neighbours: &[u32]) -> (f32, f32) {
    let n = neighbours.len() as f32;
    let out = |points: &[Vec3]| points[v] - neighbours.iter().map(|&i| points[i as usize]).sum::<Vec3>() / n;
    let edge = |points: &[Vec3], i: u32| points[v].distance(points[i as usize]);
    let mean = neighbours.iter().map(|&i| edge(undressed, i)).sum::<f32>() / n;
    let stretches = neighbours.iter().map(|&i| edge(dressed, i) / edge(undressed, i).max(SHORTEST_EDGE_M));
    let beyond = out(dressed).length() - out(undressed).length();
    (beyond / mean.max(SHORTEST_EDGE_M), stretches.fold(0.0, f32::max))
}

/// The flags that a surface raises.
pub fn surface_flags(check: &SurfaceCheck) -> Vec<Flag> {
    let mut flags = Vec::new();
    let most = (SPIKES * check.vertices as f64).floor();
    if check.spikes as f64 > most {
        let message = format!("{} vertices of the surface stick out", check.spikes);
        flags.push(Flag::of_clip(Kind::Spikes, message, check.spikes as f64, most));
    }
    let percent = |part: f64| 100.0 * part;
    if check.flipped_area > FLIPPED {
        let message = format!("{:.1} % of the surface are folded over", percent(check.flipped_area));
        flags.push(Flag::of_clip(Kind::FlippedFaces, message, check.flipped_area, FLIPPED));
    }
    if check.unseen_area > UNSEEN {
        let message = format!("no frame shows {:.0} % of the surface", percent(check.unseen_area));
        flags.push(Flag::of_clip(Kind::UnseenArea, message, check.unseen_area, UNSEEN));
    }
    flags
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::Body;

    #[test]
    fn a_clean_body_has_nothing_to_say() {
        let body = Body::test_body();
        let check = check_surface(&body.v_template, &body.v_template, &body.faces, &vec![true; body.n_faces()]);
        assert_eq!((check.spikes, check.flipped_faces, check.unseen_area), (0, 0, 0.0));
        assert!((check.largest_stretch - 1.0).abs() < 0.01 || check.largest_stretch < 1.0, "{check:?}");
        assert_eq!(surface_flags(&check), []);
    }

    #[test]
    fn spikes_folds_and_unseen_parts_are_found() {
        let body = Body::test_body();
        let mut dressed = body.v_template.clone();
        dressed[100][2] += 0.6;
        let mut seen = vec![true; body.n_faces()];
        seen[..body.n_faces() / 2].fill(false);
        let check = check_surface(&dressed, &body.v_template, &body.faces, &seen);
        assert_eq!(check.worst_spikes[0], 100, "{check:?}");
        assert!(check.unseen_area > 0.2 && check.unseen_area < 0.8);
        let codes: Vec<&str> = surface_flags(&check).iter().map(|f| f.code).collect();
        assert_eq!((codes[0], *codes.last().unwrap()), ("spikes", "unseen_area"));
        // The body turned inside out.
        let mirrored: Vec<[f32; 3]> = body.v_template.iter().map(|&[x, y, z]| [-x, y, z]).collect();
        let check = check_surface(&mirrored, &body.v_template, &body.faces, &vec![true; body.n_faces()]);
        assert!(check.flipped_area > 0.3, "{check:?}");
        assert_eq!(check.spikes, 0);
    }
}
