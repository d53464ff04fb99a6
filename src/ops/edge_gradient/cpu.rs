//! Reference twin: `grad_screen [H, W, 2]`, which [`hard_rasterize`](crate::ops::hard_rasterize::cpu::screen_backward)
//! takes to the vertices.

use crate::ops::Real;
use crate::ops::hard_rasterize::cpu::Image;

/// What a silhouette operator reads.
pub struct Pixels<'a, T> {
    pub width: usize,
    pub height: usize,
    pub hard: &'a Image<T>,
    /// Image and gradient, `[H, W, 3]`.
    pub rgb: Option<(&'a [T], &'a [T])>,
    pub grad_alpha: &'a [T],
    /// Metres.
    pub min_step: T,
}

impl<T: Real> Pixels<'_, T> {
    /// r, g, b, alpha.
    pub fn seen(&self, i: usize) -> [T; 4] {
        channels(self.rgb.map(|(image, _)| image), &self.hard.alpha, i)
    }

    pub fn grad(&self, i: usize) -> [T; 4] {
        channels(self.rgb.map(|(_, grad)| grad), self.grad_alpha, i)
    }

    /// Whether the surface of pixel `p` ends before its neighbour `q`, and hides what `q` shows.
    pub fn occludes(&self, p: usize, q: usize) -> bool {
        let (fp, fq) = (self.hard.pix_to_face[p], self.hard.pix_to_face[q]);
        let step = self.hard.zbuf[q] - self.hard.zbuf[p];
        fp >= 0 && (fq < 0 || fp != fq && step > self.min_step)
    }

    /// `grad_screen` from the derivative `of(p, direction, ahead, behind)` of the loss for `p`'s border in a direction,
    /// with so many pixels ahead of and behind `p` in the image.
    pub fn screen(&self, of: impl Fn(usize, isize, usize, usize) -> T) -> Vec<T> {
        let row = self.width as isize;
        let pixel = |p: usize| {
            let (x, y) = (p % self.width, p / self.width);
            let (right, below) = (self.width - 1 - x, self.height - 1 - y);
            let side = |step: isize, ahead: usize, behind: usize| {
                let counts = ahead > 0 && self.occludes(p, p.wrapping_add_signed(step));
                if counts { of(p, step, ahead, behind) } else { T::zero() }
            };
            [side(1, right, x) - side(-1, x, right), side(row, below, y) - side(-row, y, below)]
        };
        (0..self.width * self.height).flat_map(pixel).collect()
    }
}

fn channels<T: Real>(rgb: Option<&[T]>, alpha: &[T], i: usize) -> [T; 4] {
    let [r, g, b] = rgb.map_or([T::zero(); 3], |rgb| [rgb[i * 3], rgb[i * 3 + 1], rgb[i * 3 + 2]]);
    [r, g, b, alpha[i]]
}

/// `[H, W, 2]`: the gradient of each pixel's place on the screen, x and y.
pub fn grad_screen<T: Real>(pixels: &Pixels<'_, T>) -> Vec<T> {
    pixels.screen(|p, step, _, _| {
        let q = p.wrapping_add_signed(step);
        let (gp, gq, ip, iq) = (pixels.grad(p), pixels.grad(q), pixels.seen(p), pixels.seen(q));
        (0..4).map(|c| T::of(0.5) * (gp[c] + gq[c]) * (ip[c] - iq[c])).sum()
    })
}
