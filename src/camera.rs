//! The pinhole camera that clips, operators, avatars and requests share.

/// A pinhole camera in OpenCV's axes; pixel centres at half integers. Frames of a [`Capture`] are undistorted.
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
