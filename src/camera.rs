//! The pinhole camera that clips, operators, avatars and requests share.

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
    [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
}

impl Camera {
    /// A camera at the world's origin without distortion.
    pub const fn pinhole(width: u32, height: u32, [fx, fy, cx, cy]: [f64; 4]) -> Self {
        let rotation = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        Camera { width, height, fx, fy, cx, cy, distortion: [0.0; 5], rotation, translation: [0.0; 3] }
    }

    /// Pixels of the image.
    pub fn n_pixels(&self) -> usize {
        self.width as usize * self.height as usize
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_keeps_its_place_in_crops_and_scaled_images() {
        let camera: Camera =
            serde_json::from_str(r#"{"width": 640, "height": 480, "fx": 500, "fy": 510, "cx": 321, "cy": 242}"#)
                .unwrap();
        let pixel = |c: &Camera| [c.fx * 0.1 + c.cx, c.fy * -0.2 + c.cy];
        let [u, v] = pixel(&camera);
        assert_eq!(pixel(&camera.cropped(100, -20, 64, 64)), [u - 100.0, v + 20.0]);
        let [a, b] = pixel(&camera.scaled(320, 120));
        assert!((a - u / 2.0).abs() < 1e-12 && (b - v / 4.0).abs() < 1e-12);
    }
}
