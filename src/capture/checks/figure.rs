//! Whether the points' figure stands as the mask's does: upright, in its middle, and as a given root says.

use crate::camera::Camera;
use crate::capture::keypoints::Point;
use crate::capture::rectify::Rect;
use crate::capture::source::Picture;
use crate::capture::{BadInput, KnownPoses, Part};
use crate::keypoints::{self, Part as Place, Side};
use crate::mask::is_foreground;
use crate::math::median;

/// The figures seen so far.
#[derive(Default)]
pub(in crate::capture) struct FigureCheck {
    /// How far shoulders and hips stand beside the mask's middle, in heights of the mask, a frame that shows all four.
    aside: Vec<f64>,
    /// Frames that show shoulders and hips, and those where the hips lie above.
    seen: usize,
    upside_down: usize,
    first_upside_down: Option<usize>,
    /// Frames with a known root, and those where it stands on its head before the person's.
    roots: usize,
    roots_turned: usize,
    first_root_turned: Option<usize>,
}

/// In heights of the mask. Of twenty right clips a whole turn has at most 0.0023, and a third or half of one 0.009; points of pictures
/// that are 5 % smaller or larger have 0.019 and more.
const ASIDE: f64 = 0.015;
/// With fewer frames one side of the person decides.
const FRAMES_FOR_ASIDE: usize = 8;

impl FigureCheck {
    /// The points of the person on the mask; `format` names their order.
    pub fn look(&mut self, frame: usize, format: &str, points: &[Point], mask: &Picture, bounds: Rect) {
        let Some([shoulders, hips]) = trunk(format, points) else { return };
        let height = f64::from(bounds.height());
        self.seen += 1;
        if hips[1] < shoulders[1] - 0.1 * height {
            self.upside_down += 1;
            self.first_upside_down.get_or_insert(frame);
        }
        if let Some(middle) = middle(mask, bounds) {
            self.aside.push((0.5 * (shoulders[0] + hips[0]) - middle) / height);
        }
    }

    /// Whether a known root has its head where the points have theirs.
    pub fn look_at_root(
        &mut self,
        frame: usize,
        poses: &KnownPoses,
        camera: Option<&Camera>,
        format: &str,
        points: &[Point],
    ) {
        let Some([shoulders, hips]) = trunk(format, points) else { return };
        let root = glam::DVec3::from([0, 1, 2].map(|k| f64::from(poses.poses[frame][k])));
        let up = glam::DQuat::from_scaled_axis(root) * glam::DVec3::Y;
        let to_camera = camera.map_or(glam::DMat3::IDENTITY, |c| glam::DMat3::from_cols_array(&c.rotation).transpose());
        let up = to_camera * up;
        self.roots += 1;
        if up.x * (shoulders[0] - hips[0]) + up.y * (shoulders[1] - hips[1]) < 0.0 {
            self.roots_turned += 1;
            self.first_root_turned.get_or_insert(frame);
        }
    }

    pub fn finish(&self, warnings: &mut Vec<String>) -> Result<(), BadInput> {
        if let Some(first) = self.first_upside_down.filter(|_| 2 * self.upside_down > self.seen) {
            let message = format!("the person stands upside down in {} of {} frames", self.upside_down, self.seen);
            let expected = "a person who stands upright (where a tag of the video turns its images, masks and keypoints have to \
                            be turned too)";
            return Err(BadInput::new(Part::Keypoints, message, expected).at(first));
        }
        if let Some(first) = self.first_root_turned.filter(|_| 2 * self.roots_turned > self.roots) {
            let message = format!("the body stands upside down in {} of {} frames", self.roots_turned, self.roots);
            let expected =
                "radians, joint 0 in the camera's world: x right, y down, z forward for a camera without rotation";
            return Err(BadInput::new(Part::Poses, message, expected).at(first));
        }
        if self.aside.len() >= FRAMES_FOR_ASIDE
            && let Some(aside) = median(self.aside.iter().copied()).filter(|aside| aside.abs() > ASIDE)
        {
            let side = if aside < 0.0 { "left" } else { "right" };
            warnings.push(format!(
                "keypoints: shoulders and hips stand {:.1} % of the person's height to the {side} of the masks' middle: are they \
                 of pictures of another size?",
                100.0 * aside.abs()
            ));
        }
        Ok(())
    }
}

/// The middles of shoulders and of hips, where all four are seen.
fn trunk(format: &str, points: &[Point]) -> Option<[[f64; 2]; 2]> {
    let order = keypoints::points_of(format)?;
    let middle = |place: Place| {
        let [a, b] = [Side::Left, Side::Right].map(|side| {
            let point = points[keypoints::index_of(order, (place, side))?];
            (point[2] > 0.0).then_some(point)
        });
        let (a, b) = (a?, b?);
        Some([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])])
    };
    Some([middle(Place::Shoulder)?, middle(Place::Hip)?])
}

/// The x that has half of the mask's foreground on either side: a blob beside the person hardly moves it.
fn middle(mask: &Picture, bounds: Rect) -> Option<f64> {
    let mut columns = vec![0.0; bounds.width() as usize];
    for y in bounds.y0..bounds.y1 {
        let row = (y * mask.width) as usize;
        for (x, count) in (bounds.x0..bounds.x1).zip(&mut columns) {
            *count += f64::from(u8::from(is_foreground(mask.data[row + x as usize])));
        }
    }
    let mut left = 0.5 * columns.iter().sum::<f64>();
    for (x, count) in (bounds.x0..).zip(columns) {
        if left <= count {
            return (count > 0.0).then(|| f64::from(x) + left / count);
        }
        left -= count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::checks::testing::{BOUNDS, mask};

    /// coco17 with shoulders and hips of these heights around `x`.
    fn standing(x: f64, shoulders: f64, hips: f64) -> Vec<Point> {
        let mut points = vec![[0.0; 3]; 17];
        for (k, side) in [(5, 4.0), (6, -4.0), (11, 3.0), (12, -3.0)] {
            points[k] = [x + side, if k < 7 { shoulders } else { hips }, 0.9];
        }
        points
    }

    fn looked(points: &[Point]) -> (Result<(), BadInput>, Vec<String>) {
        let (mut check, mut warnings) = (FigureCheck::default(), Vec::new());
        (0..10).for_each(|frame| check.look(frame, "coco17", points, &mask(), BOUNDS));
        (check.finish(&mut warnings), warnings)
    }

    #[test]
    fn a_figure_beside_the_masks_middle_is_told() {
        assert_eq!(looked(&standing(50.0, 22.0, 42.0)), (Ok(()), Vec::new()));
        for (scale, side) in [(0.95, "left"), (1.05, "right")] {
            let (verdict, warnings) = looked(&standing(50.0 * scale, 22.0 * scale, 42.0 * scale));
            assert!(verdict.is_ok() && warnings[0].contains(&format!("4.2 % of the person's height to the {side}")));
        }
    }

    #[test]
    fn a_figure_on_its_head_is_refused() {
        let (verdict, _) = looked(&standing(50.0, 42.0, 22.0));
        let error = verdict.unwrap_err();
        assert_eq!((error.part, error.frame), (Part::Keypoints, Some(0)));
        assert_eq!(error.message, "the person stands upside down in 10 of 10 frames");
        assert!(looked(&standing(50.0, 30.0, 28.0)).0.is_ok(), "who bends far over does not");
    }

    #[test]
    fn a_root_on_its_head_is_refused() {
        let look = |root: [f32; 3], camera: Option<&Camera>| {
            let mut pose = vec![0.0; 72];
            pose[..3].copy_from_slice(&root);
            let poses = KnownPoses { poses: vec![pose], trans: vec![[0.0, 0.0, 3.0]], is_pelvis: true, betas: None };
            let mut check = FigureCheck::default();
            check.look_at_root(0, &poses, camera, "coco17", &standing(50.0, 22.0, 42.0));
            check.finish(&mut Vec::new())
        };
        let half_turn = [std::f32::consts::PI, 0.0, 0.0];
        assert_eq!(look(half_turn, None), Ok(()));
        assert_eq!(look([0.0; 3], None).unwrap_err().part, Part::Poses);
        let camera = crate::capture::calibration::guess(100, 80, 1.0);
        let y_up = Camera { rotation: [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0], ..camera };
        assert_eq!(look([0.0; 3], Some(&y_up)), Ok(()));
        assert!(look(half_turn, Some(&y_up)).is_err());
    }
}
