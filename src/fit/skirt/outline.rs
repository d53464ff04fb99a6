//! A section through cloth and legs: what lies in front, what behind.

use glam::Vec2;

use crate::math::smoothstep;

/// Places across a section at which its front and back are told.
const PLACES: usize = 41;

/// Front and back of a section between the legs' axes.
pub(super) struct Outline {
    /// `[PLACES]` from the right axis to the left: back and front of the surface
    surface: Vec<[f32; 2]>,
    /// The same of its convex hull
    hull: Vec<[f32; 2]>,
}

impl Outline {
    /// `None` where a leg is not there.
    pub(super) fn of(section: &[Vec2]) -> Option<Self> {
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
    pub(super) fn stretched(&self, x: f32, z: f32) -> f32 {
        let [back, front] = between(&self.hull, x);
        back + self.depth(x, z) * (front - back)
    }

    /// Where `z` goes when front and back, told apart by the hull, go onto it; what lies within `midst` of the middle stays, of the way
    /// from one to the other.
    pub(super) fn outermost(&self, x: f32, z: f32, midst: f32) -> f32 {
        let [back, front] = between(&self.hull, x);
        let depth = (z - back) / (front - back).max(0.01);
        let outer = if depth < 0.5 { back } else { front };
        z + smoothstep(((depth - 0.5).abs() - midst) / midst.max(1e-3)) * (outer - z)
    }

    /// How far `z` lies from the surface's back (0) to its front (1) at `x`.
    pub(super) fn depth(&self, x: f32, z: f32) -> f32 {
        let [back, front] = between(&self.surface, x);
        ((z - back) / (front - back).max(0.01)).clamp(0.0, 1.0)
    }
}

/// Back and front at `x`.
fn between(places: &[[f32; 2]], x: f32) -> [f32; 2] {
    let at = (0.5 * (x + 1.0)).clamp(0.0, 1.0) * (PLACES - 1) as f32;
    let k = (at as usize).min(PLACES - 2);
    [0, 1].map(|side| places[k][side] + (at - k as f32) * (places[k + 1][side] - places[k][side]))
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

    #[test]
    fn hulls_have_no_valleys() {
        let points: Vec<Vec2> =
            [(-1.0, 0.2), (-0.5, 0.6), (0.0, 0.1), (0.5, 0.6), (1.0, 0.0)].map(|(x, z)| Vec2::new(x, z)).to_vec();
        let front = upper_hull(&points, 1.0);
        assert_eq!([-0.5, 0.0, 0.25].map(|x| height_at(&front, x)), [0.6; 3]);
        assert!((-height_at(&upper_hull(&points, -1.0), 0.0) - 0.1).abs() < 1e-6);
    }

    #[test]
    fn a_valley_goes_to_the_hull_and_the_middle_stays_or_is_stretched() {
        let across = (-11..=11).map(|k| 0.1 * k as f32);
        let section: Vec<Vec2> =
            across.flat_map(|x| [Vec2::new(x, 0.15 - 0.06 * (1.0 - x.abs()).max(0.0)), Vec2::new(x, -0.15)]).collect();
        let outline = Outline::of(&section).unwrap();
        let near = |have: f32, want: f32| assert!((have - want).abs() < 0.01, "{have}, expected {want}");
        for (z, outermost, stretched) in [(0.09, 0.15, 0.15), (-0.15, -0.15, -0.15), (0.0, 0.0, 0.0375)] {
            near(outline.outermost(0.0, z, 0.1), outermost);
            near(outline.stretched(0.0, z), stretched);
        }
        near(outline.outermost(0.0, 0.03, 0.0), 0.15);
        near(outline.depth(0.0, 0.0), 0.625);
        assert!(Outline::of(&section[..20]).is_none(), "one leg");
    }
}
