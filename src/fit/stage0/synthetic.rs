//! Clips made in code, with their truth: a person in an A-pose who turns before the camera.

use glam::{DMat3, DVec2, DVec3};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg32;

use super::habits::Habits;
use super::landmarks::{GROUPS, N_OFFSETS, Part, landmarks};
use super::problem::Pinhole;
use super::rig::{Point, Rig};
use super::silhouette::{Grid, fill};
use super::state::{Frame as Pose, Shared};
use super::{Stage0Result, rotation};
use crate::body::joints::{
    HEAD, LEFT_ANKLE, LEFT_ELBOW, LEFT_HIP, LEFT_KNEE, LEFT_SHOULDER, RIGHT_ANKLE, RIGHT_ELBOW, RIGHT_HIP, RIGHT_KNEE,
    RIGHT_SHOULDER, SPINE1,
};
use crate::body::{Body, N_JOINTS};
use crate::camera::Camera;
use crate::capture::{Capture, Frame};

/// What is difficult about a clip.
#[derive(Clone, Debug)]
pub struct Difficulty {
    pub frames: usize,
    pub turn_degrees: f64,
    /// Facing of the first frame.
    pub start_degrees: f64,
    pub noise_px: f64,
    /// Standard deviation of errors that come and go a few times in the clip.
    pub lasting_px: f64,
    /// Shares of keypoints not seen, and anywhere in the picture.
    pub dropped: f64,
    pub wrong: f64,
    /// Of frames that show the back, how many have all sides swapped.
    pub swapped_backs: f64,
    /// Swing of the arms, degrees.
    pub swing_degrees: f64,
    /// By how much thighs are raised: the left one in two frames of six, the right one in two others.
    pub step_degrees: f64,
    /// Swing of the turn's pace, 0..1.
    pub pace: f64,
    /// For this part of the clip, in its middle, the person stands still.
    pub stands: f64,
    /// The right hand lies on the hip in the last third of the clip.
    pub hand_on_hip: bool,
    /// The face stays towards the camera for so far, degrees, and comes round from the other side.
    pub looks_back_degrees: f64,
    pub betas: Vec<f64>,
    /// The camera's file says this many times the true focal length, and is marked as a guess.
    pub focal_guess: Option<f64>,
    /// Faces of backs are still found, as sure as others.
    pub face_through_head: bool,
    /// Every point is equally sure.
    pub flat_confidence: bool,
    /// By how much the camera looks down.
    pub pitch_degrees: f64,
    /// Hips and shoulders are found this much higher and farther in than the joints are, metres.
    pub bias: f64,
    pub format: &'static str,
    /// The format they came in, where it is another one; its detector has its habits.
    pub given: Option<&'static str>,
    /// With masks of the naked body.
    pub masks: bool,
    /// With masks: also with pictures, of a body with a pattern all over.
    pub painted: bool,
    pub seed: u64,
}

impl Default for Difficulty {
    fn default() -> Self {
        Self {
            frames: 30,
            turn_degrees: 360.0,
            start_degrees: 0.0,
            noise_px: 2.0,
            lasting_px: 0.0,
            dropped: 0.05,
            wrong: 0.0,
            swapped_backs: 0.0,
            swing_degrees: 5.0,
            step_degrees: 0.0,
            pace: 0.2,
            stands: 0.0,
            hand_on_hip: false,
            looks_back_degrees: 0.0,
            betas: vec![0.3, 0.0, -0.4],
            focal_guess: None,
            face_through_head: false,
            flat_confidence: false,
            pitch_degrees: 0.0,
            bias: 0.0,
            format: "coco17",
            given: None,
            masks: false,
            painted: false,
            seed: 1,
        }
    }
}

/// A clip and what it shows.
pub struct Clip {
    pub capture: Capture,
    pub poses: Vec<Pose>,
    pub shared: Shared,
}

const SIDE_PX: u32 = 540;
const FOCAL_PX: f64 = 760.0;

fn noise(rng: &mut Pcg32) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// An error of keypoint `k` that comes and goes two to four times in a clip, of standard deviation 1 a coordinate.
fn lasting(k: usize, at: f64) -> DVec2 {
    let of = |k: f64| {
        let times = 2.0 + 2.0 * (0.38 * k).fract();
        2f64.sqrt() * (std::f64::consts::TAU * (times * at + 0.618 * k)).sin()
    };
    DVec2::new(of(2.0 * k as f64), of(2.0 * k as f64 + 1.0))
}

/// The true poses.
fn poses(how: &Difficulty) -> Vec<Pose> {
    let down = DMat3::from_rotation_x(how.pitch_degrees.to_radians());
    let last = (how.frames - 1).max(1) as f64;
    let pose = |t: usize| {
        let at = t as f64 / last;
        let sway = |k: f64| (std::f64::consts::TAU * (at * (1.0 + 0.37 * k) + 0.21 * k)).sin();
        let before = at.min(0.5 * (1.0 - how.stands));
        let going = (before + (at - 0.5 * (1.0 + how.stands)).max(0.0)) / (1.0 - how.stands);
        let turned = going + how.pace / std::f64::consts::TAU * (std::f64::consts::TAU * going).sin();
        let yaw = (how.start_degrees + how.turn_degrees * turned).to_radians();
        let swing = how.swing_degrees.to_radians();
        let mut theta = [DVec3::ZERO; N_JOINTS];
        theta[LEFT_HIP] = DVec3::new(0.03 * sway(1.0), 0.0, 0.14);
        theta[RIGHT_HIP] = DVec3::new(0.03 * sway(2.0), 0.0, -0.13);
        theta[LEFT_KNEE] = DVec3::new(0.05 + 0.02 * sway(3.0), 0.0, 0.0);
        theta[RIGHT_KNEE] = DVec3::new(0.06 + 0.02 * sway(4.0), 0.0, 0.0);
        theta[LEFT_ANKLE].z = -0.12;
        theta[RIGHT_ANKLE].z = 0.11;
        theta[SPINE1] = DVec3::new(0.02 * sway(1.5), 0.02 * sway(2.5), 0.0);
        theta[HEAD] = DVec3::new(0.06 * sway(0.5), 0.08 * sway(1.2), 0.02);
        theta[LEFT_SHOULDER] = DVec3::new(0.08, 0.1 * sway(0.8), -0.78 + swing * sway(0.6));
        theta[RIGHT_SHOULDER] = DVec3::new(0.05, -0.1 * sway(1.1), 0.72 + swing * sway(0.3));
        theta[LEFT_ELBOW].y = -0.27 + 0.06 * sway(0.9);
        theta[RIGHT_ELBOW].y = 0.2 + 0.06 * sway(1.4);
        // Back towards the camera as far as a neck turns; the back of the head where the back is seen.
        let away = (yaw + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
        let most = how.looks_back_degrees.to_radians();
        theta[HEAD].y -= if away.abs() < 2.0 { away.clamp(-most, most) } else { 0.0 };
        if how.hand_on_hip && at > 0.6 {
            let there = ((at - 0.6) / 0.1).min(1.0);
            theta[RIGHT_SHOULDER] += DVec3::new(0.35, 0.55, 0.1) * there;
            theta[RIGHT_ELBOW].y += 1.4 * there;
        }
        for (side, lifted) in [[1, 2], [4, 5]].into_iter().enumerate() {
            let raised = if lifted.contains(&(t % 6)) { how.step_degrees.to_radians() } else { 0.0 };
            for (joint, share) in [(LEFT_HIP, -1.0), (LEFT_KNEE, 2.0), (LEFT_ANKLE, -1.0)] {
                theta[joint + side].x += share * raised;
            }
        }
        let tilt = rotation::exp(DVec3::new(0.03 + 0.015 * sway(2.0), 0.0, 0.015 * sway(1.0)));
        Pose {
            root: down * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)) * tilt * DMat3::from_rotation_y(yaw),
            pelvis: DVec3::new(0.03 * sway(0.2), -0.01, 2.85 + 0.02 * sway(0.4)),
            turn_rate: 0.0,
            step: [[0.0; 2]; 2],
            theta,
        }
    };
    (0..how.frames).map(pose).collect()
}

pub fn clip(body: &Body, how: &Difficulty) -> Clip {
    let rig = Rig::new(body);
    let marks = landmarks(how.format).unwrap();
    let points: Vec<Point> =
        body.keypoint_set(how.format).unwrap().points.iter().map(|source| Point::new(body, source)).collect();
    let shared =
        Shared { betas: how.betas.clone(), offsets: [DVec3::ZERO; N_OFFSETS], tracked: Vec::new(), log_focal: 0.0 };
    let centre = f64::from(SIDE_PX) / 2.0;
    let pinhole = Pinhole { fx: FOCAL_PX, fy: FOCAL_PX, cx: centre, cy: centre };
    let mut rng = Pcg32::seed_from_u64(how.seed);
    let poses = poses(how);
    let mut frames = Vec::new();
    let habits = Habits::of(how.given.unwrap_or(how.format));
    for (t, pose) in poses.iter().enumerate() {
        let posed = rig.pose(pose, &shared);
        let added = |k: usize| {
            let bias = match marks[k].part {
                Part::Hip | Part::Shoulder => DVec3::new(-marks[k].side, 1.0, 0.0) * how.bias,
                _ => DVec3::ZERO,
            };
            let habit = marks[k].part.offset().map_or(DVec3::ZERO, |slot| habits.offsets[slot]);
            bias + habit * DVec3::new(marks[k].side, 1.0, 1.0)
        };
        let places: Vec<DVec3> =
            points.iter().enumerate().map(|(k, p)| posed.place(p, &shared.betas, added(k))).collect();
        let forward = pose.root.z_axis.z;
        let shows_back = forward > 0.2;
        let mut keypoints: Vec<[f32; 3]> = Vec::new();
        for (k, place) in places.iter().enumerate() {
            let mut at = pinhole.project(*place);
            at.x += how.noise_px * noise(&mut rng);
            at.y += how.noise_px * noise(&mut rng);
            at += how.lasting_px * lasting(k, t as f64 / how.frames as f64);
            let hidden_face = marks[k].part.group() == GROUPS[0] && shows_back && !how.face_through_head;
            let hidden_side = marks[k].side != 0.0 && place.z > places[marks[k].partner].z + 0.15;
            let unsure = (hidden_face || hidden_side) && !how.flat_confidence;
            let mut confidence = if unsure { 0.3 } else { 0.9 };
            if rng.random::<f64>() < how.wrong {
                at.x = rng.random_range(0.0..f64::from(SIDE_PX));
                at.y = rng.random_range(0.0..f64::from(SIDE_PX));
            }
            if rng.random::<f64>() < how.dropped {
                (at, confidence) = (DVec2::ZERO, 0.0);
            }
            keypoints.push([at.x as f32, at.y as f32, confidence]);
        }
        if shows_back && rng.random::<f64>() < how.swapped_backs {
            let given = keypoints.clone();
            (0..given.len()).for_each(|k| keypoints[k] = given[marks[k].partner]);
        }
        let mut frame =
            Frame { index: t as u32, x0: 0, y0: 0, width: 0, height: 0, rgb: Vec::new(), mask: Vec::new(), keypoints };
        if how.masks {
            let places: Vec<DVec3> = (0..body.n_vertices())
                .map(|v| posed.place(&Point::vertex(body, v), &shared.betas, DVec3::ZERO))
                .collect();
            let image: Vec<DVec2> = places.iter().map(|p| pinhole.project(*p)).collect();
            add_mask(&mut frame, &image, &body.faces);
            if how.painted {
                paint(&mut frame, body, &image, &places);
            }
        }
        frames.push(frame);
    }
    let guess = FOCAL_PX * how.focal_guess.unwrap_or(1.0);
    let camera = Camera {
        width: SIDE_PX,
        height: SIDE_PX,
        fx: guess,
        fy: guess,
        cx: centre,
        cy: centre,
        distortion: [0.0; 5],
        rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
    };
    let capture = Capture {
        camera,
        uploaded_side_px: 0,
        camera_estimated: how.focal_guess.is_some(),
        fps: 30.0,
        frames,
        keypoint_format: how.format.to_owned(),
        given_keypoint_format: how.given.unwrap_or(how.format).to_owned(),
        poses: None,
        warnings: Vec::new(),
    };
    Clip { capture, poses, shared }
}

/// A crop with the mask of a projected mesh.
fn add_mask(frame: &mut Frame, image: &[DVec2], faces: &[[u32; 3]]) {
    let low = image.iter().copied().reduce(DVec2::min).unwrap().floor() - 4.0;
    let high = image.iter().copied().reduce(DVec2::max).unwrap().ceil() + 4.0;
    let (low, high) = (low.max(DVec2::ZERO), high.min(DVec2::splat(f64::from(SIDE_PX))));
    let size = high - low;
    let grid = Grid { origin: low, step: 1.0, width: size.x as usize, height: size.y as usize };
    (frame.x0, frame.y0, frame.width, frame.height) = (low.x as u32, low.y as u32, size.x as u32, size.y as u32);
    frame.mask = fill(&grid, image, faces).into_iter().map(|inside| if inside { 255 } else { 0 }).collect();
}

/// Fills the mask with a pattern that sticks to the body.
fn paint(frame: &mut Frame, body: &Body, image: &[DVec2], places: &[DVec3]) {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let origin = DVec2::new(frame.x0.into(), frame.y0.into());
    let mut nearest = vec![f64::INFINITY; width * height];
    frame.rgb = vec![0; 3 * width * height];
    let pattern = |p: DVec3| {
        let wave = |d: DVec3, length: f64| (std::f64::consts::TAU * p.dot(d) / length).sin();
        let (a, b, c) = (DVec3::new(1.0, 0.3, 0.4), DVec3::new(-0.4, 1.0, 0.2), DVec3::new(0.3, -0.5, 1.0));
        (128.0 + 40.0 * (wave(a, 0.07) * wave(b, 0.09) + wave(b, 0.06) * wave(c, 0.08) + wave(c, 0.13))) as u8
    };
    for face in &body.faces {
        let [a, b, c] = face.map(|v| image[v as usize] - origin);
        let area = (b - a).perp_dot(c - a);
        if area == 0.0 {
            continue;
        }
        let (low, high) = (a.min(b).min(c).floor().max(DVec2::ZERO), a.max(b).max(c).ceil());
        for y in low.y as usize..(high.y.max(0.0) as usize).min(height) {
            for x in low.x as usize..(high.x.max(0.0) as usize).min(width) {
                let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let weights =
                    DVec3::new((b - at).perp_dot(c - at), (c - at).perp_dot(a - at), (a - at).perp_dot(b - at)) / area;
                let mix = |of: &dyn Fn(u32) -> DVec3| {
                    face.iter().zip(weights.to_array()).map(|(v, w)| of(*v) * w).sum::<DVec3>()
                };
                let depth = mix(&|v| places[v as usize]).z;
                if weights.min_element() >= 0.0 && depth < nearest[y * width + x] {
                    nearest[y * width + x] = depth;
                    let rest = mix(&|v| DVec3::from_array(body.v_template[v as usize].map(f64::from)));
                    frame.rgb[3 * (y * width + x)..][..3].fill(pattern(rest));
                }
            }
        }
    }
}

/// How far a result is from the truth.
#[derive(Debug)]
pub struct Errors {
    /// Mean distance of the joints, metres.
    pub joints: f64,
    /// The same once size and distance, which one camera cannot tell, are scaled to the truth's.
    pub scaled: f64,
    /// Largest error of the facing, degrees.
    pub facing_degrees: f64,
}

/// What was found in a frame.
fn found(result: &Stage0Result, t: usize, rest: DVec3) -> Pose {
    let angle = |j: usize| DVec3::from_array([0, 1, 2].map(|a| f64::from(result.poses[t][3 * j + a])));
    Pose {
        root: rotation::exp(angle(0)),
        pelvis: DVec3::from_array(result.transl[t].map(f64::from)) + rest,
        turn_rate: 0.0,
        step: [[0.0; 2]; 2],
        theta: std::array::from_fn(angle),
    }
}

/// The scale that makes sizes and distances equal, and `[N][24]` the joints as found and as they are.
pub fn joints(body: &Body, clip: &Clip, result: &Stage0Result) -> (f64, Vec<Vec<(DVec3, DVec3)>>) {
    let rig = Rig::new(body);
    let shared = Shared {
        betas: result.betas.iter().map(|b| f64::from(*b)).collect(),
        offsets: [DVec3::ZERO; N_OFFSETS],
        tracked: Vec::new(),
        log_focal: 0.0,
    };
    let rest = rig.rest_joints(&shared.betas)[0];
    let pairs = |(t, truth): (usize, &Pose)| -> Vec<(DVec3, DVec3)> {
        let ours = rig.pose(&found(result, t, rest), &shared).positions;
        ours.into_iter().zip(rig.pose(truth, &clip.shared).positions).collect()
    };
    let frames: Vec<_> = clip.poses.iter().enumerate().map(pairs).collect();
    let all = || frames.iter().flatten();
    let scale = all().map(|(a, b)| a.dot(*b)).sum::<f64>() / all().map(|(a, _)| a.length_squared()).sum::<f64>();
    (scale, frames)
}

pub fn errors(body: &Body, clip: &Clip, result: &Stage0Result) -> Errors {
    let (scale, frames) = joints(body, clip, result);
    let heading = |root: DMat3| root.z_axis.x.atan2(-root.z_axis.z);
    let facing = clip.poses.iter().enumerate().map(|(t, truth)| {
        let wrong = (heading(found(result, t, DVec3::ZERO).root) - heading(truth.root)).to_degrees();
        ((wrong + 180.0).rem_euclid(360.0) - 180.0).abs()
    });
    let mean = |s: f64| {
        let distances = frames.iter().flatten().map(|(a, b)| (*a * s).distance(*b));
        distances.sum::<f64>() / frames.iter().flatten().count() as f64
    };
    Errors { joints: mean(1.0), scaled: mean(scale), facing_degrees: facing.fold(0.0, f64::max) }
}
