//! What is looked at in every frame: whether the mask holds a person, and whether keypoints and poses are that person's and stand as it does.

mod figure;
mod keypoints;
mod masks;
mod poses;

pub(super) use figure::FigureCheck;
pub(super) use keypoints::{KeypointCheck, check_not_normalised};
pub(super) use masks::MaskCheck;
pub(super) use poses::PoseCheck;

#[cfg(test)]
mod testing {
    use crate::capture::rectify::Rect;
    use crate::capture::source::Picture;

    /// 100×80, foreground where 40 ≤ x < 60 and 10 ≤ y < 70.
    pub fn mask() -> Picture {
        let inside = |i: usize| (40..60).contains(&(i % 100)) && (10..70).contains(&(i / 100));
        let data = (0..100 * 80).map(|i| if inside(i) { 200 } else { 20 }).collect();
        Picture { width: 100, height: 80, data }
    }

    /// Of its foreground.
    pub const BOUNDS: Rect = Rect { x0: 40, y0: 10, x1: 60, y1: 70 };
}
