//! Where people look first: face, chest, back and hands, the input beside the avatar.

use image::imageops::FilterType;
use image::{Rgb, RgbImage};

use super::PipelineError;
use crate::avatar::{AvatarModel, Posed, RenderSpec, Renderer, view_space};
use crate::body::joints::{HEAD, LEFT_HAND, LEFT_WRIST, RIGHT_HAND, RIGHT_WRIST, SPINE2, SPINE3};
use crate::camera::Camera;
use crate::capture::Frame;
use crate::fit::detail::square_around;
use crate::page::{inline_jpeg, over, strip};
use crate::picture::Background;

/// Side of a picture.
const SIDE_PX: u32 = 240;
/// Room around the part, over its own size.
const MARGIN: f32 = 1.15;

/// Which side of the body shows a part best.
#[derive(Clone, Copy)]
enum Best {
    /// The joint's own front towards the camera.
    Front,
    Back,
    /// Nearest to the camera: what hangs at the body's side is hidden by it from the other one.
    Near,
}

struct Part {
    name: &'static str,
    /// The first one tells where the part faces; vertices that follow one of them most are the part.
    joints: &'static [usize],
    best: Best,
}

const PARTS: [Part; 5] = [
    Part { name: "face", joints: &[HEAD], best: Best::Front },
    Part { name: "chest", joints: &[SPINE3, SPINE2], best: Best::Front },
    Part { name: "back", joints: &[SPINE3, SPINE2], best: Best::Back },
    Part { name: "left hand", joints: &[LEFT_WRIST, LEFT_HAND], best: Best::Near },
    Part { name: "right hand", joints: &[RIGHT_WRIST, RIGHT_HAND], best: Best::Near },
];

/// The clip's pictures.
pub(super) struct Filmed<'a> {
    /// That sees them whole.
    pub camera: &'a Camera,
    /// Each with the avatar's frame that it shows.
    pub pictures: Vec<(usize, &'a Frame)>,
}

/// Each part in the frame that shows it best: input and avatar, equally enlarged, with captions. Waits.
pub(super) fn closeups(renderer: &Renderer, filmed: &Filmed<'_>) -> Result<Vec<(String, String)>, PipelineError> {
    let (model, camera) = (renderer.model(), filmed.camera);
    let posed: Vec<Posed<f32>> = model.poses.iter().zip(&model.transl).map(|(p, t)| model.posed(p, *t)).collect();
    let mut shown = Vec::new();
    for part in &PARTS {
        let worth = |k: usize| part.best.worth(&posed[k], part.joints[0], camera);
        let best = filmed.pictures.iter().max_by(|a, b| worth(a.0).total_cmp(&worth(b.0)));
        let Some(&(k, frame)) = best else { continue };
        let Some(square) = square(model, camera, &posed[k], part.joints) else { continue };
        let input = enlarged(frame, square);
        let ours = renderer.render(&spec_in(renderer, camera, k, square)).map_err(anyhow::Error::from)?;
        let white = RgbImage::from_pixel(SIDE_PX, SIDE_PX, Rgb([255; 3]));
        let pair = strip(&[input, over(&ours, &white)], 4, [255; 3]);
        let alt = format!("{}: input, avatar", part.name);
        shown.push((inline_jpeg(&pair, 88, &alt), format!("{}, frame {}", part.name, frame.index)));
    }
    Ok(shown)
}

impl Best {
    /// How well a frame shows a part to the camera.
    fn worth(self, posed: &Posed<f32>, joint: usize, camera: &Camera) -> f32 {
        let at = posed.joints[joint];
        // The third column is where the T-pose's front has turned to.
        let before = std::array::from_fn(|r| at[r] + posed.transforms[joint].rotation[r][2]);
        let seen = view_space(&[posed.joints[0], at, before], camera);
        let towards: f32 = (0..3).map(|k| seen[1][k] * (seen[1][k] - seen[2][k])).sum();
        match self {
            Best::Front => towards,
            Best::Back => -towards,
            Best::Near => seen[0][2] - seen[1][2],
        }
    }
}

/// The square around a part's vertices as the camera sees them: left, top, side; pixels of the whole image. `None` where
/// it has no vertices before the camera.
fn square(model: &AvatarModel, camera: &Camera, posed: &Posed<f32>, joints: &[usize]) -> Option<[f32; 3]> {
    let follows = |v: usize| {
        let (of, weights) = (&model.body.lbs_joints[v], &model.body.lbs_weights[v]);
        let most = (0..of.len()).max_by(|a, b| weights[*a].total_cmp(&weights[*b]));
        most.is_some_and(|most| joints.contains(&(of[most] as usize)))
    };
    let [left, top, side] = square_around(camera, &posed.vertices, follows, MARGIN)?;
    Some([left, top, side.max(4.0)])
}

/// The part of a frame, resampled; white where the frame has no pixels.
fn enlarged(frame: &Frame, [left, top, side]: [f32; 3]) -> RgbImage {
    let side_px = side.round() as u32;
    let part = RgbImage::from_fn(side_px, side_px, |x, y| {
        let x = left.round() as i64 + i64::from(x) - i64::from(frame.x0);
        let y = top.round() as i64 + i64::from(y) - i64::from(frame.y0);
        if x < 0 || y < 0 || x >= i64::from(frame.width) || y >= i64::from(frame.height) {
            return Rgb([255; 3]);
        }
        let at = 3 * (y as usize * frame.width as usize + x as usize);
        Rgb([frame.rgb[at], frame.rgb[at + 1], frame.rgb[at + 2]])
    });
    image::imageops::resize(&part, SIDE_PX, SIDE_PX, FilterType::CatmullRom)
}

/// The avatar in the same square of frame `k`.
fn spec_in(renderer: &Renderer, camera: &Camera, k: usize, [left, top, side]: [f32; 3]) -> RenderSpec {
    let side_px = side.round() as u32;
    let camera = camera.cropped(left.round() as i32, top.round() as i32, side_px, side_px).scaled(SIDE_PX, SIDE_PX);
    RenderSpec { camera, background: Background::Transparent, samples: 2, ..RenderSpec::of_frame(renderer.model(), k) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::testing::turning_avatar;

    #[test]
    fn a_square_holds_the_part_and_little_more() {
        let model = turning_avatar();
        let posed = model.posed(&model.poses[0], model.transl[0]);
        let head = square(&model, &model.camera, &posed, &[15]).unwrap();
        let body = square(&model, &model.camera, &posed, &(0..24).collect::<Vec<_>>()).unwrap();
        assert!(head[2] < 0.4 * body[2], "{head:?} of {body:?}");
        let x = model.camera.project(posed.joints[15].map(f64::from))[0] as f32;
        assert!(head[0] < x && x < head[0] + head[2], "{head:?}, the joint at {x}");
        assert_eq!(square(&model, &model.camera, &posed, &[99]), None);
    }

    #[test]
    fn a_camera_that_stands_elsewhere_sees_the_part_where_it_is() {
        let mut model = turning_avatar();
        let of = |model: &AvatarModel| {
            let posed = model.posed(&model.poses[0], model.transl[0]);
            (square(model, &model.camera, &posed, &[15]).unwrap(), Best::Front.worth(&posed, 15, &model.camera))
        };
        let near = |a: f32, b: f32| (a - b).abs() < 1e-3;
        let (plain, facing) = of(&model);
        // The person as much further back as the camera: the same picture.
        model.camera.translation = [0.2, -0.1, -1.0];
        model.transl[0] = [model.transl[0][0] - 0.2, model.transl[0][1] + 0.1, model.transl[0][2] + 1.0];
        let (moved, moved_facing) = of(&model);
        assert!((0..3).all(|k| near(plain[k], moved[k])) && near(facing, moved_facing), "{plain:?}, {moved:?}");
        // Upside down: the picture turned by 180° about its middle.
        let mut model = turning_avatar();
        model.camera.rotation = [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0];
        let (turned, turned_facing) = of(&model);
        let middle = [model.camera.cx as f32, model.camera.cy as f32];
        assert!((0..2).all(|k| near(turned[k], 2.0 * middle[k] - plain[k] - plain[2])), "{plain:?}, {turned:?}");
        assert!(near(facing, turned_facing) && facing > 0.0);
    }

    #[test]
    fn a_part_is_shown_from_its_own_side() {
        let model = turning_avatar();
        let posed: Vec<_> = model.poses.iter().zip(&model.transl).map(|(p, t)| model.posed(p, *t)).collect();
        let best = |best: Best, joint: usize| {
            let worth = |k: &usize| best.worth(&posed[*k], joint, &model.camera);
            (0..posed.len()).max_by(|a, b| worth(a).total_cmp(&worth(b))).unwrap()
        };
        // Turns of 0, 74°, 149°, 223° and 298°, the first towards the camera.
        assert_eq!((best(Best::Front, 15), best(Best::Back, 9)), (0, 2));
        let (left, right) = (best(Best::Near, 20), best(Best::Near, 21));
        assert!([left, right] == [1, 4] || [left, right] == [4, 1], "{left}, {right}");
    }

    #[test]
    fn the_input_is_enlarged_and_white_beyond_its_pixels() {
        let (width, height) = (8, 6);
        let frame = Frame {
            index: 0,
            x0: 10,
            y0: 20,
            width,
            height,
            rgb: [200, 10, 10].repeat((width * height) as usize),
            mask: vec![255; (width * height) as usize],
            keypoints: Vec::new(),
        };
        let picture = enlarged(&frame, [12.0, 22.0, 12.0]);
        assert_eq!(picture.dimensions(), (SIDE_PX, SIDE_PX));
        assert_eq!(picture.get_pixel(0, 0).0, [200, 10, 10]);
        assert_eq!(picture.get_pixel(SIDE_PX - 1, SIDE_PX - 1).0, [255; 3]);
    }
}
