//! A view that holds the person.

use super::{AvatarModel, Place, Pose, view_space};
use crate::camera::Camera;

/// Beside somebody for whom the view is made wider, of its longer side.
const ROOM: f64 = 0.03;

/// `camera` with a wider view where somebody in one of the poses and places would be cut off by its picture's border: as a person turns, feet
/// come nearer to a camera that looks down. As many pixels along the longer side as before.
pub fn holding<'a>(
    camera: &Camera,
    model: &AvatarModel,
    persons: impl IntoIterator<Item = (&'a Pose, Place)>,
) -> Camera {
    let size = [camera.width, camera.height].map(f64::from);
    let (mut low, mut high) = ([0.0f64; 2], size);
    for (pose, place) in persons {
        let vertices = model.posed(pose, place.transl(&model.body, &model.betas)).vertices;
        for point in view_space(&vertices, camera).into_iter().filter(|point| point[2] > 0.0) {
            let at = camera.project(point.map(f64::from));
            for k in 0..2 {
                // Somebody who nearly touches the camera would take up any picture.
                let within = at[k].clamp(-size[k], 2.0 * size[k]);
                (low[k], high[k]) = (low[k].min(within), high[k].max(within));
            }
        }
    }
    if (low, high) == ([0.0; 2], size) {
        return camera.clone();
    }
    // A border that is just touched looks like a cut.
    let longer = size[0].max(size[1]);
    let [left, top] = [0, 1].map(|k| if low[k] < 0.0 { (low[k] - ROOM * longer).floor() } else { 0.0 });
    let [right, bottom] = [0, 1].map(|k| if high[k] > size[k] { (high[k] + ROOM * longer).ceil() } else { size[k] });
    let wider = camera.cropped(left as i32, top as i32, (right - left) as u32, (bottom - top) as u32);
    let scale = longer / f64::from(wider.width.max(wider.height));
    let [width, height] = [wider.width, wider.height].map(|side| ((f64::from(side) * scale).round() as u32).max(1));
    wider.scaled(width, height)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::testing::turning_avatar;

    #[test]
    fn the_view_is_wider_where_somebody_is_cut_off_and_stays_elsewhere() {
        let model = turning_avatar();
        let persons = || model.poses.iter().zip(model.transl.iter().map(|transl| Place::Transl(*transl)));
        let view = holding(&model.camera, &model, persons());
        assert_eq!(view, holding(&view, &model, persons()), "all of them are in it");
        // A camera that is turned down: heads are cut off.
        let below = Camera { cy: model.camera.cy - 0.6 * f64::from(model.camera.height), ..model.camera.clone() };
        let view = holding(&below, &model, persons());
        assert_eq!(view.width.max(view.height), below.width.max(below.height));
        assert!(view.fx < below.fx && (view.fx / view.fy - below.fx / below.fy).abs() < 0.02, "{view:?}");
        for (pose, place) in persons() {
            let Place::Transl(transl) = place else { unreachable!() };
            for point in view_space(&model.posed(pose, transl).vertices, &view) {
                let [x, y] = view.project(point.map(f64::from));
                assert!((0.0..f64::from(view.width)).contains(&x), "{x} of {}", view.width);
                assert!((0.0..f64::from(view.height)).contains(&y), "{y} of {}", view.height);
            }
        }
    }
}
