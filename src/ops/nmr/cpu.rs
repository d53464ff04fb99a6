//! Reference twin: `grad_screen [H, W, 2]`, which [`hard_rasterize`](crate::ops::hard_rasterize::cpu::screen_backward)
//! takes to the vertices.

use crate::ops::Real;
use crate::ops::edge_gradient::cpu::Pixels;

/// `max_sweep` pixels bound each sweep.
pub fn grad_screen<T: Real>(pixels: &Pixels<'_, T>, max_sweep: usize) -> Vec<T> {
    pixels.screen(|p, step, ahead, behind| {
        let at = |d: usize| p.wrapping_add_signed(step * d as isize);
        let back = |d: usize| p.wrapping_add_signed(-step * d as isize);
        let lowers = |r: usize, other: [T; 4]| {
            let (seen, grad) = (pixels.seen(r), pixels.grad(r));
            (0..4).map(|c| (seen[c] - other[c]) * grad[c]).sum::<T>().max(T::zero())
        };
        let (within, without) = (pixels.seen(p), pixels.seen(at(1)));
        let face = |r: usize| pixels.hard.pix_to_face[r];
        let outward = (1..=ahead.min(max_sweep)).map(|d| lowers(at(d), within) / T::of(d as f64 - 0.5));
        let inside = (0..=behind.min(max_sweep)).take_while(|&d| face(back(d)) == face(p));
        let inward = inside.map(|d| lowers(back(d), without) / T::of(d as f64 + 0.5));
        inward.sum::<T>() - outward.sum::<T>()
    })
}
