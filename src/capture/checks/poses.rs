//! Whether the known poses are those of the person on the masks.

use crate::camera::Camera;
use crate::capture::rectify::Rect;
use crate::capture::{BadInput, KnownPoses, Part};

/// The known poses seen so far.
#[derive(Default)]
pub(in crate::capture) struct PoseCheck {
    frames: usize,
    off: usize,
    first_off: Option<usize>,
}

impl PoseCheck {
    /// Whether the body lies where its mask is: before the camera, and in the picture no further from the mask's box
    /// than half the box (SMPL's `transl` is not quite the pelvis). A guessed camera tells only before from behind.
    pub fn look(&mut self, frame: usize, poses: &KnownPoses, camera: Option<&Camera>, bounds: Rect) {
        self.frames += 1;
        let place = poses.trans[frame].map(f64::from);
        let on = match camera {
            None => place[2] > 0.0,
            Some(camera) => pixel(camera, place).is_some_and(|[x, y]| {
                let slack = 0.5 * f64::from(bounds.width().max(bounds.height()));
                let within = |value: f64, low: u32, high: u32| {
                    (f64::from(low) - slack..=f64::from(high) + slack).contains(&value)
                };
                within(x, bounds.x0, bounds.x1) && within(y, bounds.y0, bounds.y1)
            }),
        };
        if !on {
            self.off += 1;
            self.first_off.get_or_insert(frame);
        }
    }

    pub fn finish(&self, warnings: &mut Vec<String>) -> Result<(), BadInput> {
        let Some(first) = self.first_off else { return Ok(()) };
        let message = format!("the body of {} of {} frames does not lie on its mask", self.off, self.frames);
        if 2 * self.off > self.frames {
            let expected = "places in metres in the camera's world: x right, y down, z forward for a camera without \
                            rotation and translation";
            return Err(BadInput::new(Part::Poses, message, expected).at(first));
        }
        warnings.push(format!("poses: {message}, the first of them {first}"));
        Ok(())
    }
}

/// Pixel of a place in the world, lens distortion left out; `None` behind the camera.
fn pixel(camera: &Camera, place: [f64; 3]) -> Option<[f64; 2]> {
    let seen = camera.view(place);
    (seen[2] > 0.0).then(|| camera.project(seen))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::checks::testing::BOUNDS;

    #[test]
    fn a_body_behind_the_camera_or_off_the_mask_is_found() {
        let camera = crate::capture::calibration::guess(100, 80, 1.0);
        let check = |place: [f32; 3], camera: Option<&Camera>| {
            let poses = KnownPoses { poses: vec![vec![0.0; 72]], trans: vec![place], is_pelvis: true, betas: None };
            let mut check = PoseCheck::default();
            check.look(0, &poses, camera, BOUNDS);
            check.finish(&mut Vec::new())
        };
        assert_eq!(check([0.0, 0.1, 3.0], Some(&camera)), Ok(()));
        assert!(check([0.0, 0.1, -3.0], Some(&camera)).is_err());
        assert!(check([2.5, 0.1, 3.0], Some(&camera)).is_err());
        assert_eq!(check([2.5, 0.1, 3.0], None), Ok(()));
        // The same place as seen by a camera 3 m behind the world's origin, upside down.
        let rotation = [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0];
        let moved = Camera { rotation, translation: [0.0, 0.0, 3.0], ..camera };
        assert_eq!(check([0.0, -0.1, 0.0], Some(&moved)), Ok(()));
        let error = check([0.0, -0.1, -4.0], Some(&moved)).unwrap_err();
        assert_eq!(
            (error.frame, error.message.as_str()),
            (Some(0), "the body of 1 of 1 frames does not lie on its mask")
        );
    }
}
