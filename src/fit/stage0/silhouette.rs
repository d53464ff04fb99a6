//! Binary silhouettes and their signed distance, for masks and for the posed model alike.

use glam::DVec2;

use crate::distance::signed_distance;

/// Most cells along the longer side: finer masks are thinned.
const MOST_CELLS: usize = 400;
/// Cells round the person's box, so that a model that sticks out still finds its way.
const PAD: usize = 24;

/// Where a field lies in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// The first cell's corner, pixels.
    pub origin: DVec2,
    /// Pixels a cell.
    pub step: f64,
    pub width: usize,
    pub height: usize,
}

impl Grid {
    /// Covers a box of the image, and a margin.
    pub fn around(x0: u32, y0: u32, width: u32, height: u32) -> Self {
        let step = (width.max(height) as usize).div_ceil(MOST_CELLS).max(1);
        let pad = (PAD * step) as f64;
        Self {
            origin: DVec2::new(f64::from(x0) - pad, f64::from(y0) - pad),
            step: step as f64,
            width: (width as usize).div_ceil(step) + 2 * PAD,
            height: (height as usize).div_ceil(step) + 2 * PAD,
        }
    }

    pub fn centre(&self, column: usize, row: usize) -> DVec2 {
        self.origin + DVec2::new(column as f64 + 0.5, row as f64 + 0.5) * self.step
    }

    /// Image to cells; cell centres are at half integers.
    fn cells(&self, at: DVec2) -> DVec2 {
        (at - self.origin) / self.step
    }
}

/// Signed distance to a silhouette's edge: positive outside, pixels.
pub struct Field {
    pub grid: Grid,
    distance: Vec<f32>,
}

impl Field {
    /// `None` where nothing or everything is inside. `inside [height, width]`.
    pub fn new(grid: Grid, inside: &[bool]) -> Option<Self> {
        let mut distance = signed_distance(inside, grid.width, grid.height)?;
        distance.iter_mut().for_each(|cells| *cells *= grid.step as f32);
        Some(Self { grid, distance })
    }

    /// Bilinear; `None` outside the grid.
    pub fn at(&self, place: DVec2) -> Option<f64> {
        let p = self.grid.cells(place) - 0.5;
        let (x, y) = (p.x.floor(), p.y.floor());
        if x < 0.0 || y < 0.0 || x >= (self.grid.width - 1) as f64 || y >= (self.grid.height - 1) as f64 {
            return None;
        }
        let (fx, fy) = ((p.x - x) as f32, (p.y - y) as f32);
        let first = y as usize * self.grid.width + x as usize;
        let row = |start: usize| self.distance[start] * (1.0 - fx) + self.distance[start + 1] * fx;
        Some(f64::from(row(first) * (1.0 - fy) + row(first + self.grid.width) * fy))
    }

    /// The distance and the direction in which it grows, unit length.
    pub fn slope(&self, place: DVec2) -> Option<(f64, DVec2)> {
        let reach = 1.5 * self.grid.step;
        let along = |d: DVec2| Some(self.at(place + d * reach)? - self.at(place - d * reach)?);
        let normal = DVec2::new(along(DVec2::X)?, along(DVec2::Y)?).try_normalize()?;
        Some((self.at(place)?, normal))
    }
}

/// Fills the triangles of a projected mesh: cells whose centre a triangle covers.
pub fn fill(grid: &Grid, image: &[DVec2], faces: &[[u32; 3]]) -> Vec<bool> {
    let mut inside = vec![false; grid.width * grid.height];
    for face in faces {
        let [a, b, c] = face.map(|v| grid.cells(image[v as usize]));
        let low = a.min(b).min(c);
        let high = a.max(b).max(c);
        let rows = cell_range(low.y, high.y, grid.height);
        for row in rows {
            let y = row as f64 + 0.5;
            let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if (p.y <= y) != (q.y <= y) {
                    let x = p.x + (y - p.y) / (q.y - p.y) * (q.x - p.x);
                    (from, to) = (from.min(x), to.max(x));
                }
            }
            let columns = cell_range(from, to, grid.width);
            inside[row * grid.width..][columns].fill(true);
        }
    }
    inside
}

/// Cells whose centres lie in `[low, high]`.
fn cell_range(low: f64, high: f64, n: usize) -> std::ops::Range<usize> {
    let start = (low - 0.5).ceil().clamp(0.0, n as f64) as usize;
    let end = ((high - 0.5).floor() + 1.0).clamp(0.0, n as f64) as usize;
    start..end.max(start)
}
