//! Normal equations of a clip: one block a frame, neighbouring frames coupled, all frames coupled with the
//! shared unknowns (an arrow on a block tridiagonal). Solved by a block Cholesky factorisation from the first
//! frame to the last and a Schur complement for the shared unknowns.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::state::Step;

/// Rows of the shared unknowns that one core takes at a time: they stay near it.
const SCHUR_ROWS: usize = 32;

/// `H` and `g` of `½ Σ w r²`; matrices are row-major, of symmetric ones only the lower half is kept.
pub struct Normal {
    n: usize,
    d: usize,
    s: usize,
    /// `[n][d, d]`
    diagonal: Vec<f64>,
    /// `[n − 1][d, d]`: rows of frame t + 1, columns of frame t.
    coupling: Vec<f64>,
    /// `[n][d, s]`
    border: Vec<f64>,
    /// `[s, s]`
    shared: Vec<f64>,
    gradient_frames: Vec<f64>,
    gradient_shared: Vec<f64>,
}

/// The columns and slopes of a residual.
pub type Slopes<'a> = &'a [(usize, f64)];

impl Normal {
    pub fn new(n: usize, d: usize, s: usize) -> Self {
        Self {
            n,
            d,
            s,
            diagonal: vec![0.0; n * d * d],
            coupling: vec![0.0; n.saturating_sub(1) * d * d],
            border: vec![0.0; n * d * s],
            shared: vec![0.0; s * s],
            gradient_frames: vec![0.0; n * d],
            gradient_shared: vec![0.0; s],
        }
    }

    /// A residual of one frame and the shared unknowns.
    pub fn add(&mut self, t: usize, frame: Slopes, shared: Slopes, residual: f64, weight: f64) {
        let (d, s) = (self.d, self.s);
        let block = &mut self.diagonal[t * d * d..][..d * d];
        let border = &mut self.border[t * d * s..][..d * s];
        for &(i, slope) in frame {
            let w = weight * slope;
            self.gradient_frames[t * d + i] += w * residual;
            for &(j, other) in frame {
                if j <= i {
                    block[i * d + j] += w * other;
                }
            }
            for &(j, other) in shared {
                border[i * s + j] += w * other;
            }
        }
        for &(i, slope) in shared {
            let w = weight * slope;
            self.gradient_shared[i] += w * residual;
            for &(j, other) in shared {
                if j <= i {
                    self.shared[i * s + j] += w * other;
                }
            }
        }
    }

    /// A residual of frames t and t + 1.
    pub fn add_pair(&mut self, t: usize, this: Slopes, next: Slopes, residual: f64, weight: f64) {
        let d = self.d;
        self.add(t, this, &[], residual, weight);
        self.add(t + 1, next, &[], residual, weight);
        let block = &mut self.coupling[t * d * d..][..d * d];
        for &(i, slope) in next {
            for &(j, other) in this {
                block[i * d + j] += weight * slope * other;
            }
        }
    }

    /// An entry of a frame's own block.
    pub fn of_frame(&self, t: usize, i: usize, j: usize) -> f64 {
        self.diagonal[(t * self.d + i.max(j)) * self.d + i.min(j)]
    }

    pub fn gradient_of_frame(&self, t: usize, i: usize) -> f64 {
        self.gradient_frames[t * self.d + i]
    }

    /// `H` and `g` where some columns move alike in all frames and the others not at all: those columns, then the shared ones.
    pub fn where_all_frames_move(&self, columns: Range<usize>) -> (DMatrix<f64>, DVector<f64>) {
        let (n, s, m) = (self.n, self.s, columns.len());
        let first = columns.start;
        let over_frames = |of: &dyn Fn(usize) -> f64| (0..n).map(of).sum::<f64>();
        let coupled =
            |i: usize, j: usize| self.coupling.chunks_exact(self.d * self.d).map(|c| c[i * self.d + j]).sum::<f64>();
        let among_frames =
            |i: usize, j: usize| over_frames(&|t| self.of_frame(t, i, j)) + coupled(i, j) + coupled(j, i);
        let h = DMatrix::from_fn(m + s, m + s, |i, j| match (i.max(j), i.min(j)) {
            (i, j) if i < m => among_frames(first + i, first + j),
            (i, j) if j < m => over_frames(&|t| self.border[(t * self.d + first + j) * s + i - m]),
            (i, j) => self.shared[(i - m) * s + j - m],
        });
        let g = DVector::from_fn(m + s, |i, _| match i.checked_sub(m) {
            None => over_frames(&|t| self.gradient_of_frame(t, first + i)),
            Some(k) => self.gradient_shared[k],
        });
        (h, g)
    }

    /// The step `−(H + λ diag H)⁻¹ g`; `None` where the matrix is not positive.
    pub fn solve(&self, lambda: f64) -> Option<Step> {
        let (n, d, s) = (self.n, self.d, self.s);
        let mut factors = self.diagonal.clone();
        let mut links = self.coupling.clone();
        let mut border = self.border.clone();
        let mut rhs: Vec<f64> = self.gradient_frames.iter().map(|g| -g).collect();
        let mut schur = self.shared.clone();
        let mut shared: Vec<f64> = self.gradient_shared.iter().map(|g| -g).collect();
        damp(&mut schur, s, lambda);
        // Unknowns of things first seen later have no share in a frame yet: its border's columns from here on are zero.
        let mut seen = 0;
        let mut seen_by = Vec::with_capacity(n);
        for t in 0..n {
            let (before, from) = factors.split_at_mut(t * d * d);
            let factor = &mut from[..d * d];
            damp(factor, d, lambda);
            let (border_before, border_from) = border.split_at_mut(t * d * s);
            let (rhs_before, rhs_from) = rhs.split_at_mut(t * d);
            let of_frame = &self.border[t * d * s..][..d * s];
            let last = |row: &[f64]| row.iter().rposition(|v| *v != 0.0).map_or(0, |c| c + 1);
            seen = of_frame.chunks_exact(s.max(1)).map(last).fold(seen, usize::max);
            if t > 0 {
                // Y = O L⁻ᵀ of the frame before; S = H − Y Yᵀ, and the same for the right sides.
                let link = &mut links[(t - 1) * d * d..][..d * d];
                let last = &before[(t - 1) * d * d..];
                for row in link.chunks_exact_mut(d) {
                    forward(last, d, row);
                }
                subtract_gram(factor, link, d);
                let previous = &border_before[(t - 1) * d * s..];
                let previous_rhs = &rhs_before[(t - 1) * d..];
                for (i, row) in link.chunks_exact(d).enumerate() {
                    for (k, y) in row.iter().enumerate().filter(|(_, y)| **y != 0.0) {
                        rhs_from[i] -= y * previous_rhs[k];
                        axpy(-y, &previous[k * s..][..seen], &mut border_from[i * s..][..seen]);
                    }
                }
            }
            cholesky(factor, d)?;
            let (z, b) = (&mut border_from[..d * s], &mut rhs_from[..d]);
            forward(factor, d, b);
            forward_rows(factor, d, z, s, seen);
            for (row, value) in z.chunks_exact(s.max(1)).zip(b.iter()) {
                axpy(-value, &row[..seen], &mut shared[..seen]);
            }
            seen_by.push(seen);
        }
        // Every entry takes the frames in their order, whichever core has its row.
        schur.par_chunks_mut(SCHUR_ROWS * s.max(1)).enumerate().for_each(|(block, rows)| {
            for (z, &seen) in border.chunks_exact(d * s.max(1)).zip(&seen_by) {
                let z: Vec<&[f64]> = z.chunks_exact(s.max(1)).map(|row| &row[..seen]).collect();
                z.chunks(4).for_each(|four| subtract_outer(rows, block * SCHUR_ROWS, s, four));
            }
        });
        cholesky(&mut schur, s)?;
        forward(&schur, s, &mut shared);
        backward(&schur, s, &mut shared);
        for t in (0..n).rev() {
            let (head, tail) = rhs.split_at_mut((t + 1) * d);
            let b = &mut head[t * d..];
            for (value, row) in b.iter_mut().zip(border[t * d * s..].chunks_exact(s)) {
                *value -= dot(row, &shared);
            }
            if t + 1 < n {
                for (i, row) in links[t * d * d..][..d * d].chunks_exact(d).enumerate() {
                    axpy(-tail[i], row, b);
                }
            }
            backward(&factors[t * d * d..], d, b);
        }
        Some(Step { frames: rhs, shared })
    }

    /// `Σ g · step`, to check derivatives.
    #[cfg(test)]
    pub fn slope_along(&self, step: &Step) -> f64 {
        dot(&self.gradient_frames, &step.frames) + dot(&self.gradient_shared, &step.shared)
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn axpy(scale: f64, from: &[f64], to: &mut [f64]) {
    for (t, f) in to.iter_mut().zip(from) {
        *t += scale * f;
    }
}

fn damp(matrix: &mut [f64], n: usize, lambda: f64) {
    for i in 0..n {
        matrix[i * n + i] += lambda * matrix[i * n + i] + 1e-9;
    }
}

/// `A = L Lᵀ` in place, lower half.
fn cholesky(a: &mut [f64], n: usize) -> Option<()> {
    for i in 0..n {
        let (above, from) = a.split_at_mut(i * n);
        let row = &mut from[..n];
        for j in 0..i {
            let other = &above[j * n..][..j + 1];
            row[j] = (row[j] - dot(&row[..j], &other[..j])) / other[j];
        }
        let pivot = row[i] - dot(&row[..i], &row[..i]);
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        row[i] = pivot.sqrt();
    }
    Some(())
}

/// `x = L⁻¹ b` in place; leading zeros cost nothing.
fn forward(l: &[f64], n: usize, b: &mut [f64]) {
    let Some(first) = b.iter().position(|v| *v != 0.0) else { return };
    for i in first..n {
        let row = &l[i * n..][..i + 1];
        b[i] = (b[i] - dot(&row[first..i], &b[first..i])) / row[i];
    }
}

/// `X = L⁻¹ B` in place for the first `columns` of `B [n, s]`.
fn forward_rows(l: &[f64], n: usize, b: &mut [f64], s: usize, columns: usize) {
    for i in 0..n {
        let (above, from) = b.split_at_mut(i * s);
        let row = &mut from[..columns];
        for (k, value) in l[i * n..][..i].iter().enumerate() {
            axpy(-value, &above[k * s..][..columns], row);
        }
        let pivot = l[i * n + i];
        row.iter_mut().for_each(|v| *v /= pivot);
    }
}

/// `x = L⁻ᵀ b` in place.
fn backward(l: &[f64], n: usize, b: &mut [f64]) {
    for i in (0..n).rev() {
        b[i] /= l[i * n + i];
        let value = b[i];
        axpy(-value, &l[i * n..][..i], &mut b[..i]);
    }
}

/// `A −= Σ r rᵀ` over up to four rows r, for some rows of `A [n, n]` from `first` on, lower half: four together, since each pass
/// over `A` costs more than the arithmetic.
fn subtract_outer(a: &mut [f64], first: usize, n: usize, rows: &[&[f64]]) {
    let width = rows.first().map_or(0, |row| row.len());
    for (i, to) in (first..width).zip(a.chunks_exact_mut(n)) {
        let to = &mut to[..i + 1];
        match rows {
            [p, q, r, s] => {
                let (x, y, z, w) = (p[i], q[i], r[i], s[i]);
                for ((((t, p), q), r), s) in to.iter_mut().zip(*p).zip(*q).zip(*r).zip(*s) {
                    *t -= x * p + y * q + z * r + w * s;
                }
            }
            few => few.iter().for_each(|row| axpy(-row[i], &row[..=i], to)),
        }
    }
}

/// `A −= Y Yᵀ`, lower half.
fn subtract_gram(a: &mut [f64], y: &[f64], n: usize) {
    for i in 0..n {
        let row = &y[i * n..][..n];
        let Some(first) = row.iter().position(|v| *v != 0.0) else { continue };
        for j in 0..=i {
            a[i * n + j] -= dot(&row[first..], &y[j * n + first..][..n - first]);
        }
    }
}
