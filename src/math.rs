//! What several folders compute of numbers.

use rand::RngExt as _;

/// The middle of the values in their order, of an even number the upper of the two in the middle; NaN is above all numbers. `None`
/// of nothing.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// [`median`] in single precision.
pub fn median_f32(values: impl IntoIterator<Item = f32>) -> Option<f32> {
    median(values.into_iter().map(f64::from)).map(|middle| middle as f32)
}

/// Of a normal distribution: its standard deviation over the median of its absolute values.
pub const DEVIATION_OVER_MEDIAN: f64 = 1.4826;

/// From 0 at zero and below to 1 at one and above, without a corner.
pub fn smoothstep(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A number from the normal distribution of deviation 1 (Box and Muller).
pub fn normal(rng: &mut impl rand::Rng) -> f64 {
    let (u, v) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_median_is_one_of_the_values() {
        assert_eq!(median([]), None);
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median([f64::NAN, 1.0, 2.0]), Some(2.0));
        assert_eq!(median_f32([0.1, 0.3, 0.2]), Some(0.2));
    }

    #[test]
    fn a_smooth_step_ends_level() {
        assert_eq!([-1.0, 0.0, 0.5, 1.0, 2.0].map(smoothstep), [0.0, 0.0, 0.5, 1.0, 1.0]);
        assert!(smoothstep(0.01) < 0.001 && smoothstep(0.99) > 0.999);
    }

    #[test]
    fn normal_numbers_have_their_mean_and_deviation() {
        use rand::SeedableRng as _;
        let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
        let all: Vec<f64> = (0..20_000).map(|_| normal(&mut rng)).collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let variance = all.iter().map(|x| x * x).sum::<f64>() / all.len() as f64;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.04, "{mean}, {variance}");
    }
}
