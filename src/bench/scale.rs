//! How much there is to do: bytes and operations that the operators' contracts cannot do without. Every input is read
//! once, every result written once, gathers and scatters counted each; a fused multiply-add is two operations, an
//! exponential or a division one. Operations of the rasterisers were counted off their formulas.

use crate::camera::Camera;

/// What a piece of work needs.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Counts {
    pub bytes: f64,
    pub flops: f64,
}

/// The numbers of a scene.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Scale {
    pub vertices: f64,
    pub faces: f64,
    pub betas: f64,
    pub pixels: f64,
    /// Pixels with a face.
    pub covered: f64,
    /// Pairs of a face and a pixel centre inside it.
    pub hard_fragments: f64,
    /// Pairs of a face and a pixel within the soft rasteriser's reach.
    pub soft_fragments: f64,
    pub levels: f64,
    pub encoded: f64,
    pub hidden: f64,
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn sub(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

/// Squared distance from `p` to the segment `ab`.
fn distance2(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let (d, q) = (sub(b, a), sub(p, a));
    let t = ((q[0] * d[0] + q[1] * d[1]) / (d[0] * d[0] + d[1] * d[1]).max(1e-20)).clamp(0.0, 1.0);
    (q[0] - t * d[0]).powi(2) + (q[1] - t * d[1]).powi(2)
}

/// Pixel centres inside a triangle on the image, and those within `reach` of it, pixels.
fn fragments(corners: [[f64; 2]; 3], camera: &Camera, reach: f64) -> [u64; 2] {
    let [a, b, c] = corners;
    let range = |k: usize, size: u32| {
        let low = a[k].min(b[k]).min(c[k]) - reach - 0.5;
        let high = a[k].max(b[k]).max(c[k]) + reach - 0.5;
        low.ceil().max(0.0) as i64..=high.floor().min(f64::from(size) - 1.0) as i64
    };
    let mut found = [0; 2];
    for y in range(1, camera.height) {
        for x in range(0, camera.width) {
            let p = [x as f64 + 0.5, y as f64 + 0.5];
            let sides = [[a, b], [b, c], [c, a]].map(|[a, b]| cross(sub(b, a), sub(p, a)));
            let inside = sides.iter().all(|&s| s >= 0.0) || sides.iter().all(|&s| s <= 0.0);
            let near = || [[a, b], [b, c], [c, a]].iter().any(|&[a, b]| distance2(p, a, b) < reach * reach);
            found[0] += u64::from(inside);
            found[1] += u64::from(inside || near());
        }
    }
    found
}

/// Fragments of all faces, inside and within reach; `view [V, 3]` in camera space, before the camera.
pub fn count_fragments(view: &[f32], faces: &[[u32; 3]], camera: &Camera, reach: f64) -> [f64; 2] {
    let point = |v: u32| camera.project([0, 1, 2].map(|k| f64::from(view[3 * v as usize + k])));
    let mut sum = [0; 2];
    for face in faces {
        let found = fragments(face.map(point), camera, reach);
        sum = [sum[0] + found[0], sum[1] + found[1]];
    }
    sum.map(|n| n as f64)
}

impl Scale {
    pub fn skinning(&self) -> Counts {
        let (v, b) = (self.vertices, self.betas);
        // The directions of shape, four joints with weights, and five points a vertex; blending of four transforms.
        Counts { bytes: v * (12.0 * b + 32.0 + 60.0), flops: v * (6.0 * b + 4.0 * 24.0 + 18.0) }
    }

    pub fn hard_forward(&self) -> Counts {
        Counts { bytes: 48.0 * self.faces + 24.0 * self.pixels, flops: 30.0 * self.hard_fragments }
    }

    pub fn hard_backward(&self) -> Counts {
        Counts { bytes: 120.0 * self.faces + 16.0 * self.pixels, flops: 80.0 * self.covered }
    }

    pub fn soft_forward(&self) -> Counts {
        Counts { bytes: 60.0 * self.faces + 16.0 * self.pixels, flops: 80.0 * self.soft_fragments }
    }

    pub fn soft_backward(&self) -> Counts {
        Counts { bytes: 108.0 * self.faces + 32.0 * self.pixels, flops: 160.0 * self.soft_fragments }
    }

    pub fn interpolate_forward(&self) -> Counts {
        Counts { bytes: 4.0 * self.pixels + 76.0 * self.covered, flops: 18.0 * self.covered }
    }

    pub fn interpolate_scatter(&self) -> Counts {
        Counts { bytes: 12.0 * (self.pixels + self.covered), flops: 0.0 }
    }

    pub fn interpolate_gather(&self) -> Counts {
        Counts { bytes: 28.0 * self.covered, flops: 0.0 }
    }

    pub fn interpolate_backward(&self) -> Counts {
        Counts { bytes: 116.0 * self.covered, flops: 18.0 * self.covered }
    }

    fn mlp_flops(&self) -> f64 {
        2.0 * (self.encoded * self.hidden + self.hidden * self.hidden + 3.0 * self.hidden)
    }

    /// Eight entries of two features a level; what the backward pass needs is kept.
    pub fn texture_forward(&self) -> Counts {
        let bytes = 24.0 + 64.0 * self.levels + 4.0 * (self.encoded + 2.0 * self.hidden);
        Counts { bytes: self.covered * bytes, flops: self.covered * (self.mlp_flops() + 32.0 * self.levels) }
    }

    /// The entries are read for the coordinates' gradient, and read and written for their own.
    pub fn texture_backward(&self) -> Counts {
        let bytes = 48.0 + 3.0 * 64.0 * self.levels + 4.0 * (self.encoded + 2.0 * self.hidden);
        Counts { bytes: self.covered * bytes, flops: self.covered * (2.0 * self.mlp_flops() + 96.0 * self.levels) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fragments_lie_inside_or_within_reach() {
        let camera = Camera::pinhole(8, 8, [8.0, 8.0, 4.0, 4.0]);
        // Half of the square from (2, 2) to (6, 6), diagonal included: 10 centres. Within 0.6: a row along each leg, and
        // the next diagonal.
        let view = [-0.25, -0.25, 1.0, 0.25, -0.25, 1.0, -0.25, 0.25, 1.0];
        let [inside, near] = count_fragments(&view, &[[0, 1, 2]], &camera, 0.6);
        assert_eq!(inside, 10.0);
        assert_eq!(near, 10.0 + 4.0 + 4.0);
        let [inside, near] = count_fragments(&view, &[[0, 1, 2]], &camera, 0.1);
        assert_eq!([inside, near], [10.0, 10.0]);
    }
}
