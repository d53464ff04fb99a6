//! How bright what a camera has cut off was: in a bright frame white says "at least so much", and how much that is on average the darker
//! frames show, which see the same person and cut off less.

use crate::capture::Frame;
use crate::mask::is_foreground;

/// What the darker half of a clip shows, evened out.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CutOff {
    /// From there on a channel is cut off.
    white: u8,
    /// A channel: pixels of the person by their value
    shown: [[u32; 256]; 3],
}

impl CutOff {
    pub fn of(frames: &[Frame], gains: &[[f32; 3]], white: u8) -> Self {
        let mut shown = [[0; 256]; 3];
        for (frame, gain) in frames.iter().zip(gains) {
            let pixels = frame.rgb.as_chunks::<3>().0.iter().zip(&frame.mask);
            for (rgb, _) in pixels.filter(|(_, mask)| is_foreground(**mask)) {
                for k in (0..3).filter(|&k| gain[k] <= 1.0) {
                    let value = if rgb[k] >= white { u8::MAX } else { divided(rgb[k], gain[k]) };
                    shown[k][usize::from(value)] += 1;
                }
            }
        }
        Self { white, shown }
    }

    /// What each value of a channel becomes that was filmed `gain` times as bright.
    pub fn evened(&self, channel: usize, gain: f32) -> [u8; 256] {
        let cut = self.cut(channel, gain);
        std::array::from_fn(|value| if value >= usize::from(self.white) { cut } else { divided(value as u8, gain) })
    }

    /// For how bright a channel is taken that was cut off: as what the darker frames show beyond that on average; white where they show
    /// nothing beyond it, and where the frame itself is one of them.
    fn cut(&self, channel: usize, gain: f32) -> u8 {
        let least = usize::from(divided(self.white, gain));
        let beyond =
            || self.shown[channel].iter().enumerate().skip(least).map(|(value, &n)| (value as f64, f64::from(n)));
        let pixels: f64 = beyond().map(|(_, n)| n).sum();
        if gain <= 1.0 || pixels == 0.0 {
            return u8::MAX;
        }
        (beyond().map(|(value, n)| value * n).sum::<f64>() / pixels).round() as u8
    }
}

fn divided(value: u8, gain: f32) -> u8 {
    (f32::from(value) / gain).round().min(255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(rgb: &[[u8; 3]]) -> Frame {
        let (width, mask) = (rgb.len() as u32, vec![255; rgb.len()]);
        Frame {
            index: 0,
            x0: 0,
            y0: 0,
            width,
            height: 1,
            rgb: rgb.as_flattened().to_vec(),
            mask,
            keypoints: Vec::new(),
        }
    }

    #[test]
    fn what_a_bright_frame_cut_off_is_as_bright_as_in_the_dark_ones() {
        // A shirt of 230 and 220 beside a hand of 100: as it is, at 0.8 and cut off at 1.25.
        let dark = frame(&[[184, 176, 80], [176, 184, 80], [80, 80, 80]]);
        let cut_off = CutOff::of(&[dark, frame(&[[255, 255, 125]; 3])], &[[0.8; 3], [1.25; 3]], 250);
        let [red, blue] = [0, 2].map(|channel| cut_off.evened(channel, 1.25));
        assert_eq!((red[125], red[249], red[250], red[255]), (100, 199, 225, 225));
        assert_eq!(blue[250], 255, "no dark frame shows so much blue");
        // A darker frame's white may be anything beyond, as before.
        let red = cut_off.evened(0, 0.8);
        assert_eq!((red[80], red[210], red[250]), (100, 255, 255));
    }

    #[test]
    fn what_is_no_person_is_not_asked() {
        let mut beside = frame(&[[240; 3], [100; 3]]);
        beside.mask[0] = 0;
        assert_eq!(CutOff::of(&[beside], &[[1.0; 3]], 250).evened(0, 1.25)[255], 255);
    }
}
