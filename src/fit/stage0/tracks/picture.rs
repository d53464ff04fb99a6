//! A frame as the tracker sees it: brightness at several sizes, and where the person is.

use glam::DVec2;

use crate::capture::Frame;
use crate::mask::is_foreground;

/// One size of a frame.
pub struct Level {
    pub width: usize,
    pub height: usize,
    /// `[height, width]`, 0..255
    grey: Vec<f32>,
    inside: Vec<bool>,
}

/// A frame's crop, full size first, each further level half as large.
pub struct Picture {
    /// The crop's first corner in the image, pixels.
    pub origin: DVec2,
    pub levels: Vec<Level>,
}

impl Picture {
    pub fn new(frame: &Frame, levels: usize) -> Self {
        // Rec. 601's luma.
        let luma = |p: &[u8]| 0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2]);
        let mut pyramid = vec![Level {
            width: frame.width as usize,
            height: frame.height as usize,
            grey: frame.rgb.chunks_exact(3).map(luma).collect(),
            inside: frame.mask.iter().map(|m| is_foreground(*m)).collect(),
        }];
        while pyramid.len() < levels {
            let half = pyramid[pyramid.len() - 1].half();
            pyramid.push(half);
        }
        Self { origin: DVec2::new(frame.x0.into(), frame.y0.into()), levels: pyramid }
    }
}

impl Level {
    /// Each pixel the mean of four; inside where all four are.
    fn half(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let of = |x: usize, y: usize| {
            [(0, 0), (1, 0), (0, 1), (1, 1)]
                .map(|(i, j)| (2 * y + j).min(self.height - 1) * self.width + (2 * x + i).min(self.width - 1))
        };
        let pixels = || (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
        Self {
            width,
            height,
            grey: pixels().map(|(x, y)| of(x, y).iter().map(|i| self.grey[*i]).sum::<f32>() / 4.0).collect(),
            inside: pixels().map(|(x, y)| of(x, y).iter().all(|i| self.inside[*i])).collect(),
        }
    }

    pub fn is_inside(&self, at: DVec2) -> bool {
        let (x, y) = (at.x.floor(), at.y.floor());
        let within = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        within && self.inside[y as usize * self.width + x as usize]
    }

    /// Bilinear brightness; pixel centres are at halves. Beyond the border the border's.
    pub fn at(&self, at: DVec2) -> f64 {
        let (columns, u) = neighbours(at.x - 0.5, self.width);
        let (rows, v) = neighbours(at.y - 0.5, self.height);
        let [above, below] = rows.map(|row| {
            let row = row * self.width;
            let [left, right] = columns.map(|column| f64::from(self.grey[row + column]));
            left * (1.0 - u) + right * u
        });
        above * (1.0 - v) + below * v
    }

    /// Central differences.
    pub fn slope(&self, at: DVec2) -> DVec2 {
        let along = |step: DVec2| 0.5 * (self.at(at + step) - self.at(at - step));
        DVec2::new(along(DVec2::X), along(DVec2::Y))
    }
}

/// The two of `n` values that lie next to a place, those at the border where it is beyond, and the place between them. Whole
/// numbers round faster than the library's `floor`, and this is most of what following points costs.
#[inline]
fn neighbours(place: f64, n: usize) -> ([usize; 2], f64) {
    let first = place as isize - isize::from(place < 0.0);
    let last = n as isize - 1;
    ([first.clamp(0, last) as usize, (first + 1).clamp(0, last) as usize], place - first as f64)
}
