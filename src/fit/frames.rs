//! The clip on the device: each frame's crop as packed pixels, at full and at half resolution.

use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::gpu::{Buffer, Gpu};
use crate::mask::is_foreground;
use crate::ops::{PixelList, Target, pack_pixel};

/// One resolution of one frame's crop.
pub struct FrameLevel {
    pub width: u32,
    pub height: u32,
    /// The capture's camera, scaled and shifted to the crop: pixel (0, 0) is the crop's first.
    pub camera: Camera,
    /// `[height, width]`, see [`pack_pixel`].
    pub target: Buffer<u32>,
    /// Pixels inside the mask.
    pub inside: PixelList,
}

impl FrameLevel {
    /// The masked ground truth over a background (paper §3.5).
    pub fn masked(&self, background: [f32; 3]) -> Target<'_> {
        Target::Packed { pixels: &self.target, offset: 0, background: Some(background) }
    }
}

/// A frame on the device.
pub struct DeviceFrame {
    /// Full resolution first, then each half of the one before.
    pub levels: Vec<FrameLevel>,
}

/// The packed pixels of one crop on the host.
struct Packed {
    x0: i64,
    y0: i64,
    width: usize,
    height: usize,
    rgbm: Vec<[u8; 4]>,
}

impl Packed {
    /// The crop grown to even corners, so that its half is aligned with the half image. New pixels are background.
    fn of(frame: &Frame, white: u8) -> Self {
        let (x0, y0) = (frame.x0 & !1, frame.y0 & !1);
        let right = (frame.x0 + frame.width).next_multiple_of(2);
        let bottom = (frame.y0 + frame.height).next_multiple_of(2);
        let (width, height) = ((right - x0) as usize, (bottom - y0) as usize);
        let mut rgbm = vec![[0; 4]; width * height];
        for y in 0..frame.height as usize {
            for x in 0..frame.width as usize {
                let from = y * frame.width as usize + x;
                let to = (y + (frame.y0 - y0) as usize) * width + x + (frame.x0 - x0) as usize;
                let rgb = &frame.rgb[from * 3..][..3];
                let [r, g, b] = [rgb[0], rgb[1], rgb[2]].map(|c| if c >= white { 255 } else { c });
                rgbm[to] = [r, g, b, frame.mask[from]];
            }
        }
        Self { x0: x0 as i64, y0: y0 as i64, width, height, rgbm }
    }

    /// Half the resolution. Colours are the mean of the foreground where there is any, so that the background does not
    /// bleed in; a pixel is foreground when half of it was.
    fn half(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut rgbm = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (2 * x + dx, 2 * y + dy)).map(|(x, y)| {
                    if x < self.width && y < self.height { self.rgbm[y * self.width + x] } else { [0; 4] }
                });
                let inside = four.iter().filter(|p| is_foreground(p[3])).count();
                let counted = |p: &&[u8; 4]| inside == 0 || is_foreground(p[3]);
                let n = four.iter().filter(counted).count() as u32;
                let mean = |c: usize| {
                    let sum: u32 = four.iter().filter(counted).map(|p| p[c] as u32).sum();
                    ((sum + n / 2) / n) as u8
                };
                rgbm.push([mean(0), mean(1), mean(2), if inside >= 2 { 255 } else { 0 }]);
            }
        }
        Self { x0: self.x0.div_euclid(2), y0: self.y0.div_euclid(2), width, height, rgbm }
    }

    /// Upload with the camera that sees it; `scale` is this level's size over the full image's.
    fn upload(&self, gpu: &Gpu, label: &str, camera: &Camera, scale: f64) -> FrameLevel {
        let camera = Camera {
            width: self.width as u32,
            height: self.height as u32,
            fx: camera.fx * scale,
            fy: camera.fy * scale,
            cx: camera.cx * scale - self.x0 as f64,
            cy: camera.cy * scale - self.y0 as f64,
            ..camera.clone()
        };
        let packed: Vec<u32> = self.rgbm.iter().map(|&[r, g, b, mask]| pack_pixel([r, g, b], mask)).collect();
        FrameLevel {
            width: self.width as u32,
            height: self.height as u32,
            camera,
            target: gpu.upload(label, &packed),
            inside: PixelList::new(gpu, label, self.rgbm.iter().map(|p| is_foreground(p[3]))),
        }
    }
}

/// Uploads a capture's frames with `n_levels` resolutions each. Channels from `white` on become 255: what a camera has cut
/// off, and compression has made a little darker again, is then met by everything brighter (see [`crate::ops::light`]).
pub fn upload(gpu: &Gpu, capture: &Capture, camera: &Camera, n_levels: usize, white: u8) -> Vec<DeviceFrame> {
    let frames = capture.frames.iter();
    frames
        .map(|frame| {
            let mut packed = Packed::of(frame, white);
            let mut levels = Vec::with_capacity(n_levels);
            let mut scale = 1.0;
            for level in 0..n_levels {
                if level > 0 {
                    packed = packed.half();
                    scale *= 0.5;
                }
                let label = format!("fit/frame_{}/level_{level}", frame.index);
                levels.push(packed.upload(gpu, &label, camera, scale));
            }
            DeviceFrame { levels }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(x0: u32, y0: u32, width: u32, height: u32) -> Frame {
        let n = (width * height) as usize;
        let rgb = (0..n).flat_map(|i| [i as u8, 100, 200]).collect();
        Frame { index: 0, x0, y0, width, height, rgb, mask: vec![255; n], keypoints: Vec::new() }
    }

    #[test]
    fn an_odd_crop_grows_to_even_corners_with_background() {
        let packed = Packed::of(&frame(3, 5, 4, 4), 200);
        assert_eq!((packed.x0, packed.y0, packed.width, packed.height), (2, 4, 6, 6));
        assert_eq!(packed.rgbm[0], [0; 4]);
        assert_eq!(packed.rgbm[7], [0, 100, 255, 255]);
    }

    #[test]
    fn halving_keeps_the_background_out_of_the_colours() {
        let mut full = Packed { x0: 4, y0: 2, width: 2, height: 2, rgbm: vec![[10, 20, 30, 255]; 4] };
        full.rgbm[0] = [250, 250, 250, 0];
        let half = full.half();
        assert_eq!((half.x0, half.y0, half.width, half.height), (2, 1, 1, 1));
        assert_eq!(half.rgbm, [[10, 20, 30, 255]]);
    }
}
