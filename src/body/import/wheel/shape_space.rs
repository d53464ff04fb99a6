//! The linear shape space: principal components of sampled bodies.
//!
//! With the centred samples as columns of `X` and the eigenvectors `u` of the small matrix `Xᵀ A X / (N − 1)` (`A`
//! weighs each vertex with its share of the surface, so that the dense face and hands count no more than what they
//! cover), the components are `X u / √(N − 1)` and the samples' betas `√(N − 1) u`: of zero mean and unit variance by
//! construction. Joints get their components from the same betas.

use nalgebra::{DMatrix, SymmetricEigen};

/// A body in the zero pose.
pub(super) struct Sample {
    /// `[V, 3]`
    pub vertices: Vec<[f32; 3]>,
    /// `[24, 3]`
    pub joints: Vec<[f32; 3]>,
}

pub(super) struct ShapeSpace {
    /// `[V, 3]`
    pub v_template: Vec<[f32; 3]>,
    /// `[V, 3, B]`
    pub shapedirs: Vec<f32>,
    /// `[24, 3]`
    pub j_template: Vec<[f32; 3]>,
    /// `[24, 3, B]`
    pub j_shapedirs: Vec<f32>,
    /// Share of the samples' variance that each component carries, falling.
    pub explained: Vec<f64>,
    /// `[V]`, mean 1.
    areas: Vec<f32>,
}

/// How well bodies that the space was not made from are reconstructed, millimetres.
#[derive(Debug)]
pub(super) struct Errors {
    pub mean_vertex: f64,
    pub worst_body: f64,
    pub mean_joint: f64,
    pub worst_joint: f64,
}

/// Columns of centred samples, and the mean.
fn centred(columns: &[&[f32]]) -> (DMatrix<f32>, Vec<f32>) {
    let rows = columns[0].len();
    let mean: Vec<f32> = (0..rows)
        .map(|i| (columns.iter().map(|c| f64::from(c[i])).sum::<f64>() / columns.len() as f64) as f32)
        .collect();
    let matrix = DMatrix::from_fn(rows, columns.len(), |i, j| columns[j][i] - mean[i]);
    (matrix, mean)
}

fn rows(matrix: &DMatrix<f32>) -> Vec<f32> {
    matrix.transpose().as_slice().to_vec()
}

/// Surface of the faces round each vertex, mean 1.
fn vertex_areas(vertices: &[[f32; 3]], faces: &[[u32; 3]]) -> Vec<f32> {
    let mut areas = vec![0.0; vertices.len()];
    for face in faces {
        let [a, b, c] = face.map(|i| glam::Vec3::from(vertices[i as usize]));
        let area = (b - a).cross(c - a).length();
        face.iter().for_each(|&i| areas[i as usize] += area);
    }
    let mean = areas.iter().sum::<f32>() / areas.len() as f32;
    areas.iter().map(|area| area / mean).collect()
}

impl ShapeSpace {
    pub(super) fn fit(samples: &[Sample], faces: &[[u32; 3]], n_betas: usize) -> Self {
        let columns: Vec<&[f32]> = samples.iter().map(|s| s.vertices.as_flattened()).collect();
        let (x, mean) = centred(&columns);
        let v_template: Vec<[f32; 3]> = mean.as_chunks().0.to_vec();
        let areas = vertex_areas(&v_template, faces);
        let degrees = samples.len() as f32 - 1.0;

        let mut weighted = x.clone();
        for (i, mut row) in weighted.row_iter_mut().enumerate() {
            row *= (areas[i / 3] / degrees).sqrt();
        }
        let gram = (weighted.transpose() * &weighted).cast::<f64>();
        drop(weighted);
        let total = gram.trace();
        let eigen = SymmetricEigen::new(gram);
        let mut order: Vec<usize> = (0..samples.len()).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        order.truncate(n_betas);

        let mut u =
            DMatrix::from_fn(samples.len(), n_betas, |i, k| eigen.eigenvectors[(i, order[k])] as f32 / degrees.sqrt());
        let mut shapedirs = &x * &u;
        // An eigenvector's sign is arbitrary; ours makes a body grow taller with its beta.
        for k in 0..n_betas {
            let grows: f32 = shapedirs.column(k).iter().zip(&mean).skip(1).step_by(3).map(|(d, y)| d * y).sum();
            if grows < 0.0 {
                shapedirs.column_mut(k).neg_mut();
                u.column_mut(k).neg_mut();
            }
        }
        let joints: Vec<&[f32]> = samples.iter().map(|s| s.joints.as_flattened()).collect();
        let (j, j_mean) = centred(&joints);
        Self {
            v_template,
            shapedirs: rows(&shapedirs),
            j_template: j_mean.as_chunks().0.to_vec(),
            j_shapedirs: rows(&(j * u)),
            explained: order.iter().map(|&k| eigen.eigenvalues[k] / total).collect(),
            areas,
        }
    }

    fn n_betas(&self) -> usize {
        self.explained.len()
    }

    /// The betas whose body lies nearest: components are orthogonal under the areas' weights.
    fn betas(&self, vertices: &[[f32; 3]]) -> Vec<f64> {
        let b = self.n_betas();
        let (mut dots, mut norms) = (vec![0.0; b], vec![0.0; b]);
        let coordinates = vertices.as_flattened().iter().zip(self.v_template.as_flattened());
        for (i, (x, mean)) in coordinates.enumerate() {
            let area = f64::from(self.areas[i / 3]);
            for (k, &d) in self.shapedirs[i * b..][..b].iter().enumerate() {
                let d = f64::from(d);
                dots[k] += area * d * f64::from(x - mean);
                norms[k] += area * d * d;
            }
        }
        dots.iter().zip(norms).map(|(dot, norm)| dot / norm).collect()
    }

    pub(super) fn errors(&self, samples: &[Sample]) -> Errors {
        let mut errors = Errors { mean_vertex: 0.0, worst_body: 0.0, mean_joint: 0.0, worst_joint: 0.0 };
        for sample in samples {
            let betas: Vec<f32> = self.betas(&sample.vertices).iter().map(|&b| b as f32).collect();
            let distances = |template: &[[f32; 3]], dirs: &[f32], truth: &[[f32; 3]]| -> Vec<f64> {
                let shaped = crate::body::shaped(template, dirs, self.n_betas(), &betas);
                let pairs = shaped.iter().zip(truth);
                pairs.map(|(a, b)| f64::from(glam::Vec3::from(*a).distance((*b).into())) * 1e3).collect()
            };
            let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
            let vertices = distances(&self.v_template, &self.shapedirs, &sample.vertices);
            let joints = distances(&self.j_template, &self.j_shapedirs, &sample.joints);
            errors.mean_vertex += mean(&vertices) / samples.len() as f64;
            errors.worst_body = errors.worst_body.max(mean(&vertices));
            errors.mean_joint += mean(&joints) / samples.len() as f64;
            errors.worst_joint = joints.iter().fold(errors.worst_joint, |a, &b| a.max(b));
        }
        errors
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bodies on a plane of two hidden parameters, with unlike spreads.
    fn samples() -> (Vec<Sample>, Vec<[u32; 3]>) {
        let body = crate::body::Body::test_body();
        let make = |i: usize| {
            let t = i as f32;
            let betas = [2.0 * (1.3 * t).sin(), 0.5 * (0.7 * t).cos()];
            Sample { vertices: body.shaped_vertices(&betas), joints: body.shaped_joints(&betas) }
        };
        ((0..24).map(make).collect(), body.faces)
    }

    #[test]
    fn two_components_explain_bodies_of_two_parameters() {
        let (samples, faces) = samples();
        let space = ShapeSpace::fit(&samples, &faces, 2);
        assert!(space.explained[0] > space.explained[1] && space.explained.iter().sum::<f64>() > 0.9999);
        let errors = space.errors(&samples);
        assert!(errors.mean_vertex < 1e-2 && errors.worst_joint < 1e-2, "{errors:?}");
    }

    #[test]
    fn betas_have_zero_mean_and_unit_variance() {
        let (samples, faces) = samples();
        let space = ShapeSpace::fit(&samples, &faces, 2);
        let betas: Vec<Vec<f64>> = samples.iter().map(|s| space.betas(&s.vertices)).collect();
        for k in 0..2 {
            let mean = betas.iter().map(|b| b[k]).sum::<f64>() / betas.len() as f64;
            let variance = betas.iter().map(|b| (b[k] - mean).powi(2)).sum::<f64>() / (betas.len() - 1) as f64;
            assert!(mean.abs() < 1e-3 && (variance - 1.0).abs() < 1e-3, "{mean} {variance}");
        }
    }
}
