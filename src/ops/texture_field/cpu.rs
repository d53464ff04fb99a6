//! Reference twin. Also the way to evaluate a field where there is no device.

use super::{FEATURES, Level, TextureFieldConfig, TextureFieldParams, hash};
use crate::ops::Real;

/// Pixels of one pass through the perceptron: their activations stay in the first cache.
const BATCH: usize = 64;

/// `encoded [P, 2L]` of `coords [P, 3]`.
pub fn encode<T: Real>(config: &TextureFieldConfig, table: &[T], coords: &[T]) -> Vec<T> {
    let levels = config.levels();
    let mut encoded = Vec::with_capacity(coords.len() / 3 * config.encoded_width());
    for x in coords.chunks_exact(3) {
        for level in &levels {
            let cell = Cell::new(level, x);
            let mut feature = [T::zero(); FEATURES];
            for k in 0..8 {
                let weight = cell.weight(k);
                let entry = cell.entry(level, k);
                for (f, sum) in feature.iter_mut().enumerate() {
                    *sum += weight * table[entry * FEATURES + f];
                }
            }
            encoded.extend(feature);
        }
    }
    encoded
}

/// `rgb [P, 3]` of `coords [P, 3]`.
pub fn forward<T: Real>(config: &TextureFieldConfig, params: &TextureFieldParams<T>, coords: &[T]) -> Vec<T> {
    let weights = Transposed::new(config, params);
    let mut rgb = Vec::with_capacity(coords.len());
    for coords in coords.chunks(3 * BATCH) {
        let encoded = encode(config, &params.table, coords);
        rgb.extend(weights.forward(&encoded).rgb);
    }
    rgb
}

/// Adds to `grads` and `grad_coords [P, 3]` what `grad_rgb [P, 3]` says.
pub fn backward<T: Real>(
    config: &TextureFieldConfig,
    params: &TextureFieldParams<T>,
    coords: &[T],
    grad_rgb: &[T],
    grads: &mut TextureFieldParams<T>,
    grad_coords: &mut [T],
) {
    let (e, h) = (config.encoded_width(), config.hidden_width);
    let weights = Transposed::new(config, params);
    for (p, x) in coords.chunks_exact(3).enumerate() {
        let encoded = encode(config, &params.table, x);
        let a = weights.forward(&encoded);
        let d2: Vec<T> = (0..3).map(|c| grad_rgb[3 * p + c] * a.rgb[c] * (T::one() - a.rgb[c])).collect();
        let d1 = layer_backward(&params.w2, &d2, &a.hidden1, &mut grads.w2);
        let d1: Vec<T> = (0..h).map(|i| if a.hidden1[i] > T::zero() { d1[i] } else { T::zero() }).collect();
        let d0 = layer_backward(&params.w1, &d1, &a.hidden0, &mut grads.w1);
        let d0: Vec<T> = (0..h).map(|i| if a.hidden0[i] > T::zero() { d0[i] } else { T::zero() }).collect();
        let grad_encoded = layer_backward(&params.w0, &d0, &encoded, &mut grads.w0);
        debug_assert_eq!(grad_encoded.len(), e);
        encode_backward(config, &params.table, x, &grad_encoded, &mut grads.table, &mut grad_coords[3 * p..][..3]);
    }
}

/// The gradient by a layer's inputs; adds `delta ⊗ inputs` to `grad_w`.
fn layer_backward<T: Real>(w: &[T], delta: &[T], inputs: &[T], grad_w: &mut [T]) -> Vec<T> {
    let mut grad = vec![T::zero(); inputs.len()];
    for (o, &d) in delta.iter().enumerate() {
        for i in 0..inputs.len() {
            grad[i] += w[o * inputs.len() + i] * d;
            grad_w[o * inputs.len() + i] += d * inputs[i];
        }
    }
    grad
}

fn encode_backward<T: Real>(
    config: &TextureFieldConfig,
    table: &[T],
    x: &[T],
    grad_encoded: &[T],
    grad_table: &mut [T],
    grad_x: &mut [T],
) {
    for (level, upstream) in config.levels().iter().zip(grad_encoded.chunks_exact(FEATURES)) {
        let cell = Cell::new(level, x);
        for k in 0..8 {
            let entry = cell.entry(level, k);
            let mut value = T::zero();
            for f in 0..FEATURES {
                grad_table[entry * FEATURES + f] += cell.weight(k) * upstream[f];
                value += table[entry * FEATURES + f] * upstream[f];
            }
            for (axis, grad) in grad_x.iter_mut().enumerate() {
                if x[axis] >= T::zero() && x[axis] <= T::one() {
                    *grad += cell.slope(k, axis) * value * level.scale_of::<T>();
                }
            }
        }
    }
}

/// The cell of a position in a level: its first corner and the place inside, in `[0, 1]`.
struct Cell<T> {
    corner: [u32; 3],
    place: [T; 3],
}

impl<T: Real> Cell<T> {
    fn new(level: &Level, x: &[T]) -> Self {
        let position: [T; 3] =
            std::array::from_fn(|axis| x[axis].max(T::zero()).min(T::one()) * level.scale_of::<T>() + T::of(0.5));
        let corner = position.map(|x| x.floor());
        Self {
            corner: corner.map(|x| x.to_u32().unwrap_or(0)),
            place: std::array::from_fn(|axis| position[axis] - corner[axis]),
        }
    }

    /// The interpolation's weight along an axis; bit `axis` of `k` tells the corner's side.
    fn along(&self, k: usize, axis: usize) -> T {
        if k >> axis & 1 == 1 { self.place[axis] } else { T::one() - self.place[axis] }
    }

    fn weight(&self, k: usize) -> T {
        self.along(k, 0) * self.along(k, 1) * self.along(k, 2)
    }

    /// The derivative of the weight by the position along `axis`.
    fn slope(&self, k: usize, axis: usize) -> T {
        let others = self.along(k, (axis + 1) % 3) * self.along(k, (axis + 2) % 3);
        if k >> axis & 1 == 1 { others } else { -others }
    }

    /// The corner's entry in the table.
    fn entry(&self, level: &Level, k: usize) -> usize {
        let [x, y, z] = [0, 1, 2].map(|axis| self.corner[axis] + (k >> axis & 1) as u32);
        let index = if level.hashed {
            hash([x, y, z]) & (level.entries - 1)
        } else {
            (x + y * level.resolution + z * level.resolution * level.resolution) % level.entries
        };
        (level.offset + index) as usize
    }
}

/// Activations of a batch.
struct Activations<T> {
    hidden0: Vec<T>,
    hidden1: Vec<T>,
    rgb: Vec<T>,
}

/// Weights in input-major order, so that the inner loop over outputs runs through memory.
struct Transposed<T> {
    widths: [usize; 4],
    w: [Vec<T>; 3],
}

impl<T: Real> Transposed<T> {
    fn new(config: &TextureFieldConfig, params: &TextureFieldParams<T>) -> Self {
        let (e, h) = (config.encoded_width(), config.hidden_width);
        let transpose = |w: &[T], inputs: usize| -> Vec<T> {
            let outputs = w.len() / inputs;
            (0..w.len()).map(|k| w[k % outputs * inputs + k / outputs]).collect()
        };
        let w = [transpose(&params.w0, e), transpose(&params.w1, h), transpose(&params.w2, h)];
        Self { widths: [e, h, h, 3], w }
    }

    fn forward(&self, encoded: &[T]) -> Activations<T> {
        let relu = |x: &mut Vec<T>| x.iter_mut().for_each(|x| *x = x.max(T::zero()));
        let mut hidden0 = self.layer(0, encoded);
        relu(&mut hidden0);
        let mut hidden1 = self.layer(1, &hidden0);
        relu(&mut hidden1);
        let mut rgb = self.layer(2, &hidden1);
        rgb.iter_mut().for_each(|x| *x = T::one() / (T::one() + (-*x).exp()));
        Activations { hidden0, hidden1, rgb }
    }

    fn layer(&self, layer: usize, inputs: &[T]) -> Vec<T> {
        let (n_in, n_out) = (self.widths[layer], self.widths[layer + 1]);
        let mut outputs = vec![T::zero(); inputs.len() / n_in * n_out];
        for (x, y) in inputs.chunks_exact(n_in).zip(outputs.chunks_exact_mut(n_out)) {
            for (&x, w) in x.iter().zip(self.w[layer].chunks_exact(n_out)) {
                for (y, &w) in y.iter_mut().zip(w) {
                    *y += x * w;
                }
            }
        }
        outputs
    }
}
