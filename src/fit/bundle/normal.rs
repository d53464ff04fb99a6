//! The normal equations of all frames at once. They are never formed: conjugate gradients (Hestenes and Stiefel 1952) ask only what they
//! make of a vector.

use glam::DVec3;
use rayon::prelude::*;

use super::kinematics::N_DOF;
use super::looks::CHANNELS;
use super::prior::Prior;
use super::view::View;
use crate::body::Body;
use crate::fit::stage0::geman_mcclure;
use crate::math::{DEVIATION_OVER_MEDIAN, median_f32};

/// What the rows of one frame have: residuals, moves, weights.
#[derive(Clone)]
pub struct Rows {
    /// `[samples]`
    pub looks: Vec<[f64; CHANNELS]>,
    /// `[rims]`
    pub rims: Vec<f64>,
}

impl Rows {
    fn times(&self, weights: &Self) -> Self {
        let product = |(a, b): (&[f64; CHANNELS], &[f64; CHANNELS])| [0, 1, 2].map(|c| a[c] * b[c]);
        Self {
            looks: self.looks.iter().zip(&weights.looks).map(product).collect(),
            rims: self.rims.iter().zip(&weights.rims).map(|(a, b)| a * b).collect(),
        }
    }
}

/// Samples of neighbouring faces and frames have their errors in common, rims of neighbouring pixels as well: so much of each is told. Codecs
/// keep colours at half the pictures' resolution.
const LOOKS_TOLD: [f64; CHANNELS] = [0.1, 0.03, 0.03];
const RIMS_TOLD: f64 = 0.1;
/// How far an outline lies from the mask's edge by chance, pixels.
const RIM_SIGMA: f64 = 0.5;
/// Geman and McClure's scale: of looks in multiples of their spread, of rims in pixels.
const LOOKS_REACH: f64 = 2.0;
const RIM_REACH: f64 = 2.0;
/// Rounds in which a point's mean looks and what each sight of it counts are found.
const MEANS: usize = 3;
/// Differences of looks below are none.
const LEAST_SPREAD: f64 = 1e-3;

/// All frames, linearised, and what their rows count.
pub struct Normal<'a> {
    body: &'a Body,
    views: &'a [View<'a>],
    prior: &'a Prior,
    weights: Vec<Rows>,
    residuals: Vec<Rows>,
    /// `[F]`: of the weights of each face's looks.
    totals: Vec<[f64; CHANNELS]>,
}

impl<'a> Normal<'a> {
    /// `spreads`: of the looks; found where there are none yet.
    pub fn new(body: &'a Body, views: &'a [View<'a>], prior: &'a Prior, spreads: &mut Option<[f64; CHANNELS]>) -> Self {
        let values = |view: &View<'_>| Rows {
            looks: view.samples.iter().map(|sample| sample.values.map(f64::from)).collect(),
            rims: view.rims.iter().map(|rim| rim.off.into()).collect(),
        };
        let values: Vec<Rows> = views.iter().map(values).collect();
        let ones =
            |rows: &Rows| Rows { looks: vec![[1.0; CHANNELS]; rows.looks.len()], rims: vec![1.0; rows.rims.len()] };
        let weights = values.iter().map(ones).collect();
        let mut normal = Self { body, views, prior, weights, residuals: Vec::new(), totals: Vec::new() };
        for _ in 0..MEANS {
            normal.sum_weights();
            normal.residuals = normal.less_means(values.clone());
            let sigmas = *spreads.get_or_insert_with(|| normal.spreads());
            let weight = |r: f64, reach: f64| geman_mcclure(r * r, reach).1;
            normal.weights = (normal.residuals.iter())
                .map(|rows| Rows {
                    looks: (rows.looks.iter())
                        .map(|r| {
                            [0, 1, 2].map(|c| LOOKS_TOLD[c] / sigmas[c].powi(2) * weight(r[c], LOOKS_REACH * sigmas[c]))
                        })
                        .collect(),
                    rims: rows.rims.iter().map(|&r| RIMS_TOLD / RIM_SIGMA.powi(2) * weight(r, RIM_REACH)).collect(),
                })
                .collect();
        }
        normal.sum_weights();
        normal.residuals = normal.less_means(values);
        normal
    }

    fn spreads(&self) -> [f64; CHANNELS] {
        let of =
            |c: usize| self.residuals.iter().flat_map(move |rows| rows.looks.iter().map(move |r| r[c].abs() as f32));
        [0, 1, 2].map(|c| (DEVIATION_OVER_MEDIAN * f64::from(median_f32(of(c)).unwrap_or(0.0))).max(LEAST_SPREAD))
    }

    fn sum_weights(&mut self) {
        let mut totals = vec![[0.0; CHANNELS]; self.body.n_faces()];
        for (view, weights) in self.views.iter().zip(&self.weights) {
            for (sample, weight) in view.samples.iter().zip(&weights.looks) {
                totals[sample.face as usize].iter_mut().zip(weight).for_each(|(total, w)| *total += w);
            }
        }
        self.totals = totals;
    }

    /// Looks less each point's weighted mean over the frames: how it looks is the best that there is, whatever moves (variable
    /// projection; Golub and Pereyra 1973).
    fn less_means(&self, mut all: Vec<Rows>) -> Vec<Rows> {
        let mut means = vec![[0.0; CHANNELS]; self.body.n_faces()];
        for ((view, weights), rows) in self.views.iter().zip(&self.weights).zip(&all) {
            for ((sample, weight), look) in view.samples.iter().zip(&weights.looks).zip(&rows.looks) {
                let (mean, total) = (&mut means[sample.face as usize], &self.totals[sample.face as usize]);
                (0..CHANNELS).filter(|&c| total[c] > 0.0).for_each(|c| mean[c] += weight[c] * look[c] / total[c]);
            }
        }
        for (view, rows) in self.views.iter().zip(&mut all) {
            for (sample, look) in view.samples.iter().zip(&mut rows.looks) {
                look.iter_mut().zip(&means[sample.face as usize]).for_each(|(look, mean)| *look -= mean);
            }
        }
        all
    }

    /// What tells whether a step was one: half the squares of looks and of rims, as Geman and McClure count them, each as a mean, and what
    /// is expected of the whole `correction` so far. Steps lower the sum, in which there are more looks than rims: this may end them
    /// early, and lets none pass that makes it worse.
    pub fn cost(&self, correction: &[f64], spreads: &[f64; CHANNELS]) -> f64 {
        let bounded = |r: f64, reach: f64| geman_mcclure(r * r, reach).0;
        let (mut looks, mut rims, mut n_looks, mut n_rims) = (0.0, 0.0, 0, 0);
        for rows in &self.residuals {
            for r in &rows.looks {
                looks += (0..CHANNELS).map(|c| LOOKS_TOLD[c] * bounded(r[c] / spreads[c], LOOKS_REACH)).sum::<f64>();
            }
            rims += rows.rims.iter().map(|r| bounded(r / RIM_SIGMA, RIM_REACH / RIM_SIGMA)).sum::<f64>();
            (n_looks, n_rims) = (n_looks + rows.looks.len(), n_rims + rows.rims.len());
        }
        let prior: f64 = self.prior.times(correction).iter().zip(correction).map(|(a, b)| 0.5 * a * b).sum();
        let rows = (n_looks + n_rims).max(1) as f64;
        // From round to round somewhat other points are seen.
        looks / n_looks.max(1) as f64 + RIMS_TOLD * rims / n_rims.max(1) as f64 + prior / rows
    }

    /// Of the unknowns of all frames `[N * N_DOF]` and the `[V]` that they share.
    pub fn gradient(&self, correction: &[f64]) -> Vec<f64> {
        let rows: Vec<Rows> = self.residuals.iter().zip(&self.weights).map(|(r, w)| r.times(w)).collect();
        let mut gradient = self.prior.times(correction);
        gradient.iter_mut().zip(self.transposed(&rows)).for_each(|(g, t)| *g += t);
        self.prior.hold(&mut gradient);
        gradient
    }

    /// The matrix by `step`.
    pub fn times(&self, step: &[f64]) -> Vec<f64> {
        let moves = self.less_means(self.moves(step));
        let rows: Vec<Rows> = moves.iter().zip(&self.weights).map(|(m, w)| m.times(w)).collect();
        let mut product = self.prior.times(step);
        product.iter_mut().zip(self.transposed(&rows)).for_each(|(p, t)| *p += t);
        self.prior.hold(&mut product);
        product
    }

    fn moves(&self, step: &[f64]) -> Vec<Rows> {
        let raised = &step[self.views.len() * N_DOF..];
        let of = |(t, view): (usize, &View<'a>)| {
            let velocities = view.kinematics.velocities(&step[t * N_DOF..][..N_DOF], raised);
            let at = |face: u32, bary: [f64; 3]| -> DVec3 {
                self.body.faces[face as usize].iter().zip(bary).map(|(&v, b)| b * velocities[v as usize]).sum()
            };
            Rows {
                looks: (view.samples.iter())
                    .map(|sample| {
                        let moves = at(sample.face, MIDDLE);
                        sample.slopes.map(|slope| slope.as_dvec3().dot(moves))
                    })
                    .collect(),
                rims: (view.rims.iter())
                    .map(|rim| rim.slope.as_dvec3().dot(at(rim.face, rim.bary.map(f64::from))))
                    .collect(),
            }
        };
        self.views.par_iter().enumerate().map(of).collect()
    }

    fn transposed(&self, rows: &[Rows]) -> Vec<f64> {
        let n_vertices = self.body.n_vertices();
        let of = |(view, rows): (&View<'a>, &Rows)| {
            let mut forces = vec![DVec3::ZERO; n_vertices];
            let mut push = |face: u32, bary: [f64; 3], force: DVec3| {
                let corners = self.body.faces[face as usize];
                corners.iter().zip(bary).for_each(|(&v, b)| forces[v as usize] += b * force);
            };
            for (sample, row) in view.samples.iter().zip(&rows.looks) {
                push(sample.face, MIDDLE, sample.slopes.iter().zip(row).map(|(s, r)| *r * s.as_dvec3()).sum());
            }
            for (rim, row) in view.rims.iter().zip(&rows.rims) {
                push(rim.face, rim.bary.map(f64::from), *row * rim.slope.as_dvec3());
            }
            let (mut step, mut raised) = (vec![0.0; N_DOF], vec![0.0; n_vertices]);
            view.kinematics.pull_back(&forces, &mut step, &mut raised);
            (step, raised)
        };
        let parts: Vec<(Vec<f64>, Vec<f64>)> = self.views.par_iter().zip(rows).map(of).collect();
        let mut all = Vec::with_capacity(self.views.len() * N_DOF + n_vertices);
        parts.iter().for_each(|(step, _)| all.extend(step));
        let mut shared = vec![0.0; n_vertices];
        // In order: sums of floats depend on it.
        parts.iter().for_each(|(_, raised)| shared.iter_mut().zip(raised).for_each(|(sum, part)| *sum += part));
        all.extend(shared);
        all
    }

    /// About the matrix's diagonal.
    fn diagonal(&self) -> Vec<f64> {
        let n_vertices = self.body.n_vertices();
        let of = |(view, weights): (&View<'a>, &Rows)| {
            let (mut step, mut raised) = (vec![0.0; N_DOF], vec![0.0; n_vertices]);
            let mut add = |face: u32, bary: [f64; 3], slope: DVec3, weight: f64| {
                view.kinematics.add_squares(
                    self.body.faces[face as usize],
                    bary,
                    slope,
                    weight,
                    &mut step,
                    &mut raised,
                );
            };
            for (sample, weight) in view.samples.iter().zip(&weights.looks) {
                (0..CHANNELS).for_each(|c| add(sample.face, MIDDLE, sample.slopes[c].as_dvec3(), weight[c]));
            }
            for (rim, weight) in view.rims.iter().zip(&weights.rims) {
                add(rim.face, rim.bary.map(f64::from), rim.slope.as_dvec3(), *weight);
            }
            (step, raised)
        };
        let parts: Vec<(Vec<f64>, Vec<f64>)> = self.views.par_iter().zip(&self.weights).map(of).collect();
        let mut all: Vec<f64> = parts.iter().flat_map(|(step, _)| step.iter().copied()).collect();
        let mut shared = vec![0.0; n_vertices];
        parts.iter().for_each(|(_, raised)| shared.iter_mut().zip(raised).for_each(|(sum, part)| *sum += part));
        all.extend(shared);
        all.iter_mut().zip(self.prior.diagonal()).for_each(|(d, p)| *d += p);
        all
    }

    /// The step that solves the equations about a `correction` so far, as far as so many iterations come; `None` where `go_on` ends
    /// them.
    pub fn solve(&self, correction: &[f64], iterations: usize, go_on: &mut dyn FnMut() -> bool) -> Option<Vec<f64>> {
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let diagonal = self.diagonal();
        let scaled = |r: &[f64]| -> Vec<f64> { r.iter().zip(&diagonal).map(|(r, d)| r / d).collect() };
        let mut residual: Vec<f64> = self.gradient(correction).iter().map(|g| -g).collect();
        let mut step = vec![0.0; residual.len()];
        let mut along = scaled(&residual);
        let first = dot(&residual, &along);
        let mut left = first;
        for _ in 0..iterations {
            if left <= ENOUGH * first {
                break;
            }
            if !go_on() {
                return None;
            }
            let product = self.times(&along);
            let length = left / dot(&along, &product);
            step.iter_mut().zip(&along).for_each(|(s, a)| *s += length * a);
            residual.iter_mut().zip(&product).for_each(|(r, p)| *r -= length * p);
            let next = scaled(&residual);
            let now = dot(&residual, &next);
            along.iter_mut().zip(&next).for_each(|(a, n)| *a = n + now / left * *a);
            left = now;
        }
        Some(step)
    }
}

const MIDDLE: [f64; 3] = [1.0 / 3.0; 3];
/// What may be left of the gradient's square.
const ENOUGH: f64 = 1e-6;
