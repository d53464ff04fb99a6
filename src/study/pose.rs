//! Pose refinement by pictures alone: how far off a pose may be for each kind of gradient.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, ensure};
use glam::{Quat, Vec3};
use image::RgbImage;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::made_clip::{self, MadeOf};
use super::objective::{Border, ImageTerms, Objective, Soft, View};
use super::painter::{Painter, on_white, sheet};
use super::{Context, Report, Study, Table, Verdict};
use crate::avatar::Pose;
use crate::body::{Body, N_JOINTS, N_POSE};
use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::gpu::Gpu;
use crate::mask::is_foreground;
use crate::ops::adam::{Adam, AdamConfig};
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use crate::ops::project::Project;
use crate::ops::skinning::cpu::{Posed, forward};
use crate::ops::skinning::{PoseAt, SkinningBody};
use crate::ops::{Corners, Topology};
use crate::synth::SynthOptions;

pub const STUDY: Study = Study {
    name: "pose",
    title: "Recovery of poses",
    claim: "SoftRas passes gradients to occluded and far vertices, which allows pose refinement via \
            analysis-by-synthesis; it is helpful when a small amount of joint rotation is required",
    section: "§3.3, Differentiable rendering",
    method: "A made clip of a dressed person, lit from one side. Shape, offsets and one colour a face are known (the mean \
             of what the frames show at their true poses). Each of the 23 joints below the root is turned by the same \
             angle about an axis of its own at random; then poses and places are refined by the pictures alone: no \
             keypoints, no prior, no neighbours in time. All methods start alike and take the same steps at the same rate: \
             a tenth of the initial error, falling tenfold. *SoftRas* is the paper's: soft colours, and the hard \
             silhouette through NMR. *NMR* and *edges* have hard colours and the hard silhouette, through NMR's sweeps or \
             the edge gradient. *Edges + SoftRas* is what the preset `standard` uses, with the reach of the paper's. Places of \
             joints say more than angles here: joints of a chain can make up for one another, and a limb's twist hardly shows.",
    run: |context| run(context, &Settings::default()),
};

/// What decides size and time.
#[derive(Clone, Debug)]
pub struct Settings {
    pub frames: usize,
    pub size_px: u32,
    pub steps: u32,
    /// Errors of each joint at the start, degrees
    pub errors_deg: Vec<f64>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { frames: 5, size_px: 180, steps: 60, errors_deg: vec![2.0, 5.0, 10.0, 20.0] }
    }
}

/// Of the rate of poses, metres a radian.
const TRANSL_RATE: f32 = 0.1;

/// Half the depth that a person takes up, metres.
const REACH_M: f64 = 1.5;

fn methods() -> [(&'static str, Objective); 4] {
    let soft = Some(Soft { sigma: 1e-4, depth_softness_m: 0.02 });
    let plain = Objective {
        border: Border::Nmr,
        hard_rgb: true,
        soft_rgb: None,
        min_step: 0.02,
        rgb_weight: 1.0,
        silhouette_weight: 2.0,
    };
    let edges = Objective { border: Border::Edge, ..plain };
    [
        ("SoftRas", Objective { hard_rgb: false, soft_rgb: soft, ..plain }),
        ("NMR", plain),
        ("edges", edges),
        ("edges + SoftRas", Objective { soft_rgb: soft, ..edges }),
    ]
}
const SOFTRAS: usize = 0;
const NMR: usize = 1;

/// The truth of a made clip.
struct Truth {
    body: Body,
    betas: Vec<f32>,
    offsets: Vec<[f32; 3]>,
    placed: Vec<Placed>,
    capture: Capture,
}

/// A pose and `transl`.
#[derive(Clone, Debug, PartialEq)]
struct Placed {
    pose: Pose,
    transl: [f32; 3],
}

impl Truth {
    fn load(body: Body, clip: &Path) -> Result<Self> {
        let capture = made_clip::load(clip)?;
        let MadeOf { betas, offsets, poses, transl } = MadeOf::read(clip, &body)?;
        ensure!(poses.len() == capture.frames.len(), "{} poses, {} frames", poses.len(), capture.frames.len());
        let placed = poses.into_iter().zip(transl).map(|(pose, transl)| Placed { pose, transl }).collect();
        Ok(Self { body, betas, offsets, placed, capture })
    }

    fn posed(&self, at: &Placed) -> Posed<f32> {
        forward(&self.body, &self.betas, Some(&self.offsets), &at.pose, at.transl)
    }

    /// Mean distance of the joints from those of frame `i`, centimetres.
    fn joints_cm(&self, i: usize, at: &Placed) -> f64 {
        let (truth, ours) = (self.posed(&self.placed[i]).joints, self.posed(at).joints);
        let sum: f32 = truth.iter().zip(&ours).map(|(&a, &b)| Vec3::from(a).distance(b.into())).sum();
        100.0 * sum as f64 / N_JOINTS as f64
    }

    /// Mean angle between the local rotations of the joints below the root and those of frame `i`, degrees.
    fn angle_deg(&self, i: usize, at: &Placed) -> f64 {
        let angle = |j| rotation(&self.placed[i].pose, j).angle_between(rotation(&at.pose, j)).to_degrees() as f64;
        (1..N_JOINTS).map(angle).sum::<f64>() / (N_JOINTS - 1) as f64
    }
}

fn rotation(pose: &Pose, joint: usize) -> Quat {
    Quat::from_scaled_axis(Vec3::from_slice(&pose[3 * joint..]))
}

/// The pose with each joint below the root turned by `degrees` about a random axis.
fn turned(pose: &Pose, degrees: f64, rng: &mut Pcg64) -> Pose {
    let mut out = *pose;
    for joint in 1..N_JOINTS {
        let axis = loop {
            let v = Vec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - 1.0;
            if (0.01..1.0).contains(&v.length_squared()) {
                break v.normalize();
            }
        };
        let q = rotation(pose, joint) * Quat::from_axis_angle(axis, degrees.to_radians() as f32);
        out[3 * joint..3 * joint + 3].copy_from_slice(&q.to_scaled_axis().to_array());
    }
    out
}

/// Means over the frames.
#[derive(Clone, Copy, Debug)]
struct Score {
    angle_deg: f64,
    joints_cm: f64,
    /// Percent of the frames whose joints came nearer
    improved: f64,
}

fn score(truth: &Truth, start: &[Placed], found: &[Placed]) -> Score {
    let n = found.len() as f64;
    let mut score = Score { angle_deg: 0.0, joints_cm: 0.0, improved: 0.0 };
    for (i, (before, after)) in start.iter().zip(found).enumerate() {
        let joints_cm = truth.joints_cm(i, after);
        score.angle_deg += truth.angle_deg(i, after) / n;
        score.joints_cm += joints_cm / n;
        score.improved += if joints_cm < truth.joints_cm(i, before) { 100.0 / n } else { 0.0 };
    }
    score
}

/// Runs the study at this size; an error where its clip, the device or a fit fails.
pub fn run(context: &Context<'_>, settings: &Settings) -> Result<Report> {
    let clip = SynthOptions {
        frames: settings.frames,
        size_px: settings.size_px,
        seed: context.seed,
        truths: 1,
        ..SynthOptions::default()
    };
    let truth = Truth::load(context.load_body()?, &context.clip(&clip)?)?;
    let refiner = Refiner::new(&context.gpu, &truth)?;
    let columns =
        [("angle before, °", 1), ("after", 1), ("joints before, cm", 2), ("after", 2), ("frames nearer, %", 0)];
    let mut table = Table::new("Mean errors of the joints before and after", "error, method", &columns);
    // [error][method]
    let mut scores: Vec<[Score; 4]> = Vec::new();
    let mut starts = Vec::new();
    let mut shown = Vec::new();
    for &degrees in &settings.errors_deg {
        let mut rng = Pcg64::seed_from_u64(context.seed);
        let wrong = |at: &Placed| Placed { pose: turned(&at.pose, degrees, &mut rng), transl: at.transl };
        let start: Vec<Placed> = truth.placed.iter().map(wrong).collect();
        let before = score(&truth, &start, &start);
        let mut row = vec![truth.placed[1 % settings.frames].clone(), start[1 % settings.frames].clone()];
        let mut of_methods = Vec::new();
        for (name, objective) in methods() {
            (context.say)(&format!("poses that are {degrees}° off: {name}"));
            let found = refiner.refine(&start, objective, degrees, settings.steps)?;
            let after = score(&truth, &start, &found);
            let values = [before.angle_deg, after.angle_deg, before.joints_cm, after.joints_cm, after.improved];
            table.row(format!("{degrees}°, {name}"), &values);
            row.push(found[1 % settings.frames].clone());
            of_methods.push(after);
        }
        scores.push(of_methods.try_into().expect("one score a method"));
        starts.push(before);
        shown.push(row);
    }
    Ok(Report {
        tables: vec![table],
        figures: vec![(
            refiner.figure(&shown)?,
            "Rows: the errors, smallest first. Columns: the truth, the start, SoftRas, NMR, edges, edges + SoftRas; each \
             face in its known colour."
                .to_owned(),
        )],
        verdicts: verdicts(&settings.errors_deg, &starts, &scores),
        notes: vec![format!(
            "{} frames of {}², {} steps; joint positions are not aligned.",
            settings.frames, settings.size_px, settings.steps
        )],
    })
}

fn verdicts(errors_deg: &[f64], starts: &[Score], scores: &[[Score; 4]]) -> Vec<Verdict> {
    let rows = || errors_deg.iter().zip(starts).zip(scores);
    let list = |method: usize| {
        let shares = rows()
            .map(|((d, before), after)| format!("{d}°: {:.2} → {:.2} cm", before.joints_cm, after[method].joints_cm));
        shares.collect::<Vec<_>>().join(", ")
    };
    let small = rows().filter(|((d, _), _)| **d <= 5.0);
    let against = rows()
        .map(|((d, _), after)| format!("{d}°: {:.2} against {:.2} cm", after[SOFTRAS].joints_cm, after[NMR].joints_cm));
    let best = rows().map(|((d, _), after)| {
        let best = (0..4).min_by(|&a, &b| after[a].joints_cm.total_cmp(&after[b].joints_cm)).expect("four methods");
        format!("{d}°: {}", methods()[best].0)
    });
    vec![
        Verdict::new(
            "With SoftRas, errors of up to 5° a joint become smaller",
            small.clone().all(|((_, before), after)| after[SOFTRAS].joints_cm < before.joints_cm),
            list(SOFTRAS),
        ),
        Verdict::new(
            "SoftRas recovers poses better than NMR alone, whatever the error",
            rows().all(|(_, after)| after[SOFTRAS].joints_cm < after[NMR].joints_cm),
            against.collect::<Vec<_>>().join(", "),
        ),
        Verdict::new(
            "The paper's combination is the best of the four, whatever the error",
            rows().all(|(_, after)| after.iter().all(|s| s.joints_cm >= after[SOFTRAS].joints_cm)),
            format!("best: {}", best.collect::<Vec<_>>().join(", ")),
        ),
    ]
}

/// The clip and the known person on the device.
struct Refiner<'a> {
    gpu: &'a Arc<Gpu>,
    truth: &'a Truth,
    corners: Arc<Corners>,
    views: Vec<View>,
    colours: Vec<[f32; 3]>,
}

impl<'a> Refiner<'a> {
    fn new(gpu: &'a Arc<Gpu>, truth: &'a Truth) -> Result<Self> {
        let topology = Topology::new(truth.body.n_vertices(), &truth.body.faces);
        let corners = Arc::new(Corners::new(gpu, &truth.body.faces, &topology));
        let camera = &truth.capture.camera;
        let view = |frame: &Frame| View::new(gpu, camera.clone(), &whole(frame, camera));
        let views = truth.capture.frames.iter().map(view).collect();
        let colours = face_colours(gpu, truth, &corners, &topology)?;
        Ok(Self { gpu, truth, corners, views, colours })
    }

    /// Steps of all frames from `start` on. `degrees` is the error that sets the rate.
    fn refine(&self, start: &[Placed], objective: Objective, degrees: f64, steps: u32) -> Result<Vec<Placed>> {
        let (gpu, body) = (self.gpu, &self.truth.body);
        let terms = ImageTerms::new(gpu, &self.corners, &self.views, objective);
        let skinning = SkinningBody::new(gpu, body);
        let (shape, posed, project) = (skinning.shape_state(gpu), skinning.pose_state(gpu), Project::new(gpu));
        let n = body.n_vertices();
        let zeros = |name: &str, len: usize| gpu.zeros::<f32>(&format!("study/{name}"), len);
        let [view, grad_view, grad_vertices] = ["view", "grad_view", "grad_vertices"].map(|name| zeros(name, 3 * n));
        let (screen, grad_joints) = (zeros("screen", 2 * n), zeros("grad_joints", 3 * N_JOINTS));
        let poses = gpu.upload("study/poses", &start.iter().flat_map(|p| p.pose).collect::<Vec<f32>>());
        let transl = gpu.upload("study/transl", &start.iter().flat_map(|p| p.transl).collect::<Vec<f32>>());
        let (grad_poses, grad_transl) = (zeros("grad_poses", poses.len()), zeros("grad_transl", transl.len()));
        let adam = [("poses", &poses), ("transl", &transl)]
            .map(|(name, group)| Adam::new(gpu, name, group.len(), AdamConfig::default()));
        let colours = gpu.upload("study/face_colours", self.colours.as_flattened());
        let betas = gpu.upload("study/betas", &self.truth.betas);
        let offsets = gpu.upload("study/offsets", self.truth.offsets.as_flattened());
        let mut recorder = gpu.recorder("study/shape");
        skinning.shape_forward(&mut recorder, &betas, &offsets, &shape);
        recorder.submit()?;
        for step in 1..=steps {
            let mut recorder = gpu.recorder("study/pose");
            recorder.clear(&grad_poses);
            recorder.clear(&grad_transl);
            // Nobody reads them, but they must not grow without bound.
            shape.clear_gradients(&mut recorder);
            for (frame, seen) in self.views.iter().enumerate() {
                let at = PoseAt { poses: &poses, transl: &transl, frame };
                let grad = PoseAt { poses: &grad_poses, transl: &grad_transl, frame };
                skinning.pose_forward(&mut recorder, &shape, at, &posed);
                project.forward(&mut recorder, &seen.camera, &posed.vertices, &view, &screen);
                recorder.clear(&grad_view);
                recorder.clear(&grad_vertices);
                let z = (start[frame].transl[2] as f64).max(REACH_M + 0.1);
                terms.record(&mut recorder, seen, &view, (z - REACH_M, z + REACH_M), &colours, 1.0, &grad_view);
                project.view_backward(&mut recorder, &seen.camera, &grad_view, &grad_vertices);
                skinning.pose_backward(&mut recorder, &shape, at, &posed, &grad_vertices, &grad_joints, grad);
            }
            let rate = 0.1 * degrees.to_radians() as f32 * 0.1f32.powf(step as f32 / steps as f32);
            adam[0].step(&mut recorder, &poses, &grad_poses, 0..poses.len(), rate, step);
            adam[1].step(&mut recorder, &transl, &grad_transl, 0..transl.len(), TRANSL_RATE * rate, step);
            recorder.submit()?;
            if step % 10 == 0 || step == steps {
                let losses = terms.take_losses(gpu)?;
                ensure!(losses.iter().all(|l| l.is_finite()), "step {step}: losses {losses:?}");
            }
        }
        let (poses, transl) = (gpu.read(&poses)?, gpu.read(&transl)?);
        let rows = poses.as_chunks::<N_POSE>().0.iter().zip(transl.as_chunks::<3>().0);
        Ok(rows.map(|(&pose, &transl)| Placed { pose, transl }).collect())
    }

    fn figure(&self, rows: &[Vec<Placed>]) -> Result<RgbImage> {
        let Truth { body, capture, .. } = self.truth;
        let painter = Painter::new(self.gpu, &body.faces, &body.v_template, &self.colours);
        let picture = |at: &Placed| Ok(on_white(&painter.textured(&self.truth.posed(at).vertices, &capture.camera)?));
        let rows = rows.iter().map(|row| row.iter().map(picture).collect()).collect::<Result<Vec<Vec<_>>>>()?;
        Ok(sheet(&rows))
    }
}

/// The frame's crop in its whole image: a limb that starts outside the crop must be seen too.
fn whole(frame: &Frame, camera: &Camera) -> Vec<[u8; 4]> {
    let mut pixels = vec![[0; 4]; camera.n_pixels()];
    for (i, (rgb, &mask)) in frame.rgb.as_chunks::<3>().0.iter().zip(&frame.mask).enumerate() {
        let (x, y) = (frame.x0 + i as u32 % frame.width, frame.y0 + i as u32 / frame.width);
        pixels[(y * camera.width + x) as usize] = [rgb[0], rgb[1], rgb[2], mask];
    }
    pixels
}

/// What each face shows on average at the true poses. A face that no frame shows takes the mean of its neighbours, from
/// the seen ones outwards.
fn face_colours(gpu: &Gpu, truth: &Truth, corners: &Arc<Corners>, topology: &Topology) -> Result<Vec<[f32; 3]>> {
    let camera = &truth.capture.camera;
    let hard = HardRasterizer::new(gpu, corners, camera.n_pixels(), HardRasterizeConfig::default());
    let mut sums = vec![[0.0f32; 4]; truth.body.n_faces()];
    for (frame, at) in truth.capture.frames.iter().zip(&truth.placed) {
        // The clip's camera stands at the world's origin.
        let view = gpu.upload("study/view", truth.posed(at).vertices.as_flattened());
        let mut recorder = gpu.recorder("study/face_colours");
        hard.forward(&mut recorder, camera, &view);
        recorder.submit()?;
        for (face, pixel) in gpu.read(&hard.pix_to_face)?.into_iter().zip(whole(frame, camera)) {
            if let (Ok(face), true) = (usize::try_from(face), is_foreground(pixel[3])) {
                (0..3).for_each(|c| sums[face][c] += pixel[c] as f32 / 255.0);
                sums[face][3] += 1.0;
            }
        }
    }
    loop {
        let before = sums.clone();
        for (f, sum) in sums.iter_mut().enumerate().filter(|(_, s)| s[3] == 0.0) {
            for &g in topology.face_neighbours.row(f) {
                let other = before[g as usize];
                if other[3] > 0.0 {
                    (0..3).for_each(|c| sum[c] += other[c] / other[3]);
                    sum[3] += 1.0;
                }
            }
        }
        if sums == before {
            break;
        }
    }
    Ok(sums.iter().map(|s| [s[0], s[1], s[2]].map(|c| c / s[3].max(1.0))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn a_turned_pose_is_off_by_its_angle_in_every_joint() {
        let mut rng = Pcg64::seed_from_u64(1);
        let mut pose = [0.0; N_POSE];
        pose[..6].copy_from_slice(&[0.3, -1.0, 0.2, 0.5, 0.1, -0.4]);
        let off = turned(&pose, 12.0, &mut rng);
        assert_eq!(off[..3], pose[..3], "the root stays");
        for joint in 1..N_JOINTS {
            let angle = rotation(&pose, joint).angle_between(rotation(&off, joint)).to_degrees();
            assert!((angle - 12.0).abs() < 0.05, "joint {joint}: {angle}°");
        }
    }

    #[test]
    fn a_small_error_shrinks_with_every_method() {
        let Some(gpu) = gpu("study::a_small_error_shrinks_with_every_method") else { return };
        let work = tempfile::tempdir().unwrap();
        let context = Context::for_test(gpu, work.path());
        let settings = Settings { frames: 2, size_px: 96, steps: 25, errors_deg: vec![10.0] };
        let report = run(&context, &settings).unwrap();
        for row in &report.tables[0].rows {
            let [angle_before, _, before, after, _] = row.values[..] else { panic!("{row:?}") };
            assert!((angle_before.unwrap() - 10.0).abs() < 0.1, "{row:?}");
            assert!(after < before.map(|b| 0.9 * b), "{row:?}");
        }
        let (width, height) = report.figures[0].0.dimensions();
        assert_eq!((width, height), (6 * 96, 96));
    }
}
