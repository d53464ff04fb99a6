//! The pinhole camera that clips, operators, avatars and requests share, and where it sees a place.
//!
//! The operators have this arithmetic once more, in the precision of their parameters and with its gradients.

mod json;

pub use json::from_json;

/// Rows of the world's own axes.
const IDENTITY: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// A pinhole camera in OpenCV's axes; pixel centres at half integers. Frames of a [`Capture`](crate::capture::Capture) are
/// undistorted.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Camera {
    pub width: u32,
    pub height: u32,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    /// OpenCV's k1 k2 p1 p2 k3, all zero where absent.
    #[serde(default)]
    pub distortion: [f64; 5],
    /// Row-major; `x_cam = R x_world + t`.
    #[serde(default = "identity")]
    pub rotation: [f64; 9],
    #[serde(default)]
    pub translation: [f64; 3],
}

fn identity() -> [f64; 9] {
    IDENTITY
}

impl Camera {
    /// A camera at the world's origin without distortion.
    pub const fn pinhole(width: u32, height: u32, [fx, fy, cx, cy]: [f64; 4]) -> Self {
        let (rotation, translation) = (IDENTITY, [0.0; 3]);
        Camera { width, height, fx, fy, cx, cy, distortion: [0.0; 5], rotation, translation }
    }

    /// Pixels of the image.
    pub fn n_pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// From the world to camera space, metres.
    pub fn view(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let row = |k: usize| self.rotation[3 * k] * x + self.rotation[3 * k + 1] * y + self.rotation[3 * k + 2] * z;
        [0, 1, 2].map(|k| row(k) + self.translation[k])
    }

    /// Where it stands in the world, metres.
    pub fn centre(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| -(0..3).map(|row| self.rotation[3 * row + k] * self.translation[row]).sum::<f64>())
    }

    /// The pixel of a place in camera space, without the lens. What lies behind the camera is for the caller to leave out.
    pub fn project(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        [self.fx * x / z + self.cx, self.fy * y / z + self.cy]
    }

    /// The place in camera space, at depth 1, that [`Camera::project`] puts on the pixel `[x, y]`.
    pub fn ray(&self, [x, y]: [f64; 2]) -> [f64; 3] {
        [(x - self.cx) / self.fx, (y - self.cy) / self.fy, 1.0]
    }

    pub fn has_lens(&self) -> bool {
        self.distortion != [0.0; 5]
    }

    /// Where the lens puts the place `[u, v]` at depth 1. OpenCV's model: with r² = u² + v² and radial = 1 + k1 r² + k2 r⁴ + k3 r⁶,
    /// `u' = u·radial + 2 p1 u v + p2 (r² + 2u²)`, `v' = v·radial + p1 (r² + 2v²) + 2 p2 u v`.
    pub fn distorted(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = u * u + v * v;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        [
            u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u),
            v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v,
        ]
    }

    /// d/dr of `r·radial`, of which the lens makes `r`, at r² = `r2`: where it is not positive, the image folds over.
    pub fn radial_growth(&self, r2: f64) -> f64 {
        let [k1, k2, _, _, k3] = self.distortion;
        1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3))
    }

    /// The camera of the part of its image that starts at pixel (`x`, `y`); both may be negative.
    pub fn cropped(&self, x: i32, y: i32, width: u32, height: u32) -> Camera {
        Camera { width, height, cx: self.cx - f64::from(x), cy: self.cy - f64::from(y), ..self.clone() }
    }

    /// The camera of its image resampled to `width` × `height`.
    pub fn scaled(&self, width: u32, height: u32) -> Camera {
        let x = f64::from(width) / f64::from(self.width);
        let y = f64::from(height) / f64::from(self.height);
        Camera { width, height, fx: self.fx * x, fy: self.fy * y, cx: self.cx * x, cy: self.cy * y, ..self.clone() }
    }
}

/// `R Rᵀ = 1` and `det R = 1`, to the precision of numbers that were written as text.
pub fn is_rotation(r: &[f64; 9]) -> bool {
    let row = |i: usize| [r[3 * i], r[3 * i + 1], r[3 * i + 2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let off = (0..3).flat_map(|i| (0..3).map(move |j| (i, j)));
    let unit = |(i, j): (usize, usize)| (dot(row(i), row(j)) - f64::from(i == j)).abs() < 1e-3;
    r.iter().all(|v| v.is_finite()) && off.into_iter().all(unit) && dot(row(0), cross(row(1), row(2))) > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_keeps_its_place_in_crops_and_scaled_images() {
        let camera: Camera =
            serde_json::from_str(r#"{"width": 640, "height": 480, "fx": 500, "fy": 510, "cx": 321, "cy": 242}"#)
                .unwrap();
        let pixel = |c: &Camera| c.project([0.1, -0.2, 1.0]);
        let [u, v] = pixel(&camera);
        assert_eq!(pixel(&camera.cropped(100, -20, 64, 64)), [u - 100.0, v + 20.0]);
        let [a, b] = pixel(&camera.scaled(320, 120));
        assert!((a - u / 2.0).abs() < 1e-12 && (b - v / 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_place_of_the_world_is_turned_moved_and_projected() {
        // A quarter turn about z: the world's x is the camera's y.
        let rotation = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let camera =
            Camera { rotation, translation: [0.5, 0.0, 1.0], ..Camera::pinhole(64, 48, [40.0, 50.0, 32.0, 24.0]) };
        let seen = camera.view([2.0, 1.0, 3.0]);
        assert_eq!(seen, [-0.5, 2.0, 4.0]);
        assert_eq!(camera.project(seen), [32.0 - 5.0, 24.0 + 25.0]);
        assert_eq!(camera.ray([27.0, 49.0]), seen.map(|x| x / 4.0));
        assert_eq!(camera.view(camera.centre()), [0.0; 3]);
    }

    #[test]
    fn the_radial_growth_is_the_slope_of_what_the_lens_does_to_a_radius() {
        let distortion = [-0.3, 0.05, 0.0, 0.0, 0.02];
        let lens = Camera { distortion, ..Camera::pinhole(64, 48, [40.0, 40.0, 32.0, 24.0]) };
        assert!(lens.has_lens());
        let (r, step) = (0.6, 1e-6);
        let [[high, _], [low, _]] = [r + step, r - step].map(|r| lens.distorted([r, 0.0]));
        assert!((lens.radial_growth(r * r) - (high - low) / (2.0 * step)).abs() < 1e-8);
    }
}
