//! How far away a posed mesh lies as somebody infinitely far away sees it: parallel rays, nearest and farthest surface a pixel.

use glam::{Vec2, Vec3};

/// Room of the image around the mesh, metres.
const MARGIN_M: f32 = 0.02;

/// A square image of depths.
pub struct DepthMap {
    /// Across, down, away from the viewer.
    axes: [Vec3; 3],
    /// Of the image's first corner, metres.
    low: Vec2,
    side: usize,
    /// Pixels a metre.
    scale: f32,
    /// `[side, side]` both, metres along the third axis; infinite (−infinite) where there is nothing.
    nearest: Vec<f32>,
    farthest: Vec<f32>,
}

impl DepthMap {
    /// The mesh as seen from `direction` (unit) in `side`² pixels. `None` for a mesh without extent, or one that is not finite.
    pub fn of(direction: Vec3, side: usize, vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> Option<Self> {
        let away = -direction;
        let (across, down) = away.any_orthonormal_pair();
        let axes = [across, down, away];
        let points: Vec<Vec3> = vertices.iter().map(|&v| Vec3::from(axes.map(|axis| axis.dot(v.into())))).collect();
        let (low, high) = points.iter().fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(low, high), p| {
            (low.min(p.truncate()), high.max(p.truncate()))
        });
        let (low, high) = (low - MARGIN_M, high + MARGIN_M);
        let extent = (high - low).max_element();
        if !(extent.is_finite() && extent > 0.0) {
            return None;
        }
        let nothing = |depth| vec![depth; side * side];
        let (nearest, farthest) = (nothing(f32::INFINITY), nothing(f32::NEG_INFINITY));
        let mut map = Self { axes, low, side, scale: side as f32 / extent, nearest, farthest };
        let place = |p: Vec3| ((p.truncate() - low) * map.scale).extend(p.z);
        let points: Vec<Vec3> = points.into_iter().map(place).collect();
        faces.iter().for_each(|face| map.draw(face.map(|v| points[v as usize])));
        Some(map)
    }

    /// Keeps the depths of a triangle's pixels.
    fn draw(&mut self, [a, b, c]: [Vec3; 3]) {
        // The pixels whose middles lie between two bounds; casts round towards zero, and below zero to zero.
        let first = |low: f32| (low - 0.5) as usize + usize::from(low - 0.5 > (low - 0.5) as usize as f32);
        let end = |high: f32| if high < 0.5 { 0 } else { ((high - 0.5) as usize + 1).min(self.side) };
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let (columns, rows) = (first(low.x)..end(high.x), first(low.y)..end(high.y));
        let area = (b - a).truncate().perp_dot((c - a).truncate());
        if columns.is_empty() || rows.is_empty() || area == 0.0 {
            return;
        }
        // Weights and depth are linear over the image: from the first corner on, a step across and a step down.
        let (ab, ac, over) = ((b - a).truncate(), (c - a).truncate(), 1.0 / area);
        let (across, down) = (Vec2::new(ac.y, -ab.y) * over, Vec2::new(-ac.x, ab.x) * over);
        let deeper = Vec2::new(b.z - a.z, c.z - a.z);
        for y in rows {
            let in_row = down * (y as f32 + 0.5 - a.y);
            for x in columns.clone() {
                let weights = across * (x as f32 + 0.5 - a.x) + in_row;
                if weights.x >= 0.0 && weights.y >= 0.0 && weights.x + weights.y <= 1.0 {
                    let (at, depth) = (y * self.side + x, a.z + weights.dot(deeper));
                    self.nearest[at] = self.nearest[at].min(depth);
                    self.farthest[at] = self.farthest[at].max(depth);
                }
            }
        }
    }

    /// Metres a pixel.
    pub fn pixel_m(&self) -> f32 {
        1.0 / self.scale
    }

    /// Where in the image a point lies, metres from its first corner, and its depth.
    pub fn place(&self, point: Vec3) -> (Vec2, f32) {
        let [x, y, depth] = self.axes.map(|axis| axis.dot(point));
        (Vec2::new(x, y) - self.low, depth)
    }

    /// The index of the pixel at a place, or of the border's pixel next to it.
    pub fn pixel(&self, place: Vec2) -> usize {
        let pixel = (place * self.scale).clamp(Vec2::ZERO, Vec2::splat(self.side as f32 - 1.0));
        pixel.y as usize * self.side + pixel.x as usize
    }

    /// What lies nearest to the viewer at a pixel; infinite where there is nothing.
    pub fn nearest(&self, pixel: usize) -> f32 {
        self.nearest[pixel]
    }

    /// What lies farthest from the viewer at a pixel; −infinite where there is nothing.
    pub fn farthest(&self, pixel: usize) -> f32 {
        self.farthest[pixel]
    }
}
