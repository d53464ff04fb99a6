//! Bodies of unusual build, in the directions of a body's own shape space.

use crate::body::Body;
use crate::math::normal;
use rand_pcg::Pcg64;

/// Standard deviations from the mean body.
const UNUSUAL: f64 = 2.5;

/// How a made person is built.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Build {
    /// Anyone
    #[default]
    Any,
    /// As small as the shape space lets one expect: 2.5 standard deviations towards less height
    Small,
    /// 2.5 standard deviations towards more volume at the same height
    Heavy,
}

impl Build {
    /// `[S]` betas.
    pub(super) fn betas(self, body: &Body, rng: &mut Pcg64) -> Vec<f32> {
        let any: Vec<f32> = (0..body.n_betas).map(|_| (0.7 * normal(rng)).clamp(-1.5, 1.5) as f32).collect();
        let height = || slope(body, height);
        match self {
            Build::Any => any,
            Build::Small => along(&height(), -UNUSUAL),
            Build::Heavy => {
                let (volume, height) = (slope(body, volume), height());
                let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
                let part = dot(&volume, &height) / dot(&height, &height);
                along(&volume.iter().zip(&height).map(|(v, h)| v - part * h).collect::<Vec<_>>(), UNUSUAL)
            }
        }
    }
}

/// `[S]`: how a measure grows with each beta.
fn slope(body: &Body, measure: fn(&Body, &[f32]) -> f64) -> Vec<f64> {
    let mean = measure(body, &vec![0.0; body.n_betas]);
    let grown = |k: usize| {
        let mut betas = vec![0.0; body.n_betas];
        betas[k] = 1.0;
        measure(body, &betas) - mean
    };
    (0..body.n_betas).map(grown).collect()
}

fn along(direction: &[f64], length: f64) -> Vec<f32> {
    let norm = direction.iter().map(|d| d * d).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    direction.iter().map(|d| (length * d / norm) as f32).collect()
}

/// Metres.
fn height(body: &Body, betas: &[f32]) -> f64 {
    let vertices = body.shaped_vertices(betas);
    let ys = vertices.iter().map(|v| f64::from(v[1]));
    let (low, high) = ys.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), y| (l.min(y), h.max(y)));
    high - low
}

/// Cubic metres, by the divergence theorem.
fn volume(body: &Body, betas: &[f32]) -> f64 {
    let vertices = body.shaped_vertices(betas);
    let of = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| glam::Vec3::from(vertices[v as usize]).as_dvec3());
        a.dot(b.cross(c)) / 6.0
    };
    body.faces.iter().map(of).sum()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn the_small_are_small_and_the_heavy_as_tall_as_the_mean() {
        let body = Body::test_body();
        let mut rng = Pcg64::seed_from_u64(1);
        let mean = vec![0.0; body.n_betas];
        let small = Build::Small.betas(&body, &mut rng);
        assert!(height(&body, &small) < 0.97 * height(&body, &mean), "{}", height(&body, &small));
        let heavy = Build::Heavy.betas(&body, &mut rng);
        assert!((height(&body, &heavy) / height(&body, &mean) - 1.0).abs() < 0.03, "{}", height(&body, &heavy));
        assert!(volume(&body, &heavy) > 1.05 * volume(&body, &mean), "{}", volume(&body, &heavy));
        for betas in [small, heavy] {
            assert!((betas.iter().map(|b| b * b).sum::<f32>().sqrt() - 2.5).abs() < 1e-4, "{betas:?}");
        }
    }
}
