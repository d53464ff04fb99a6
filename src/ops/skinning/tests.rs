use std::borrow::Cow;

use super::cpu::{self, Gradients, Model};
use super::{PoseAt, SkinningBody};
use crate::body::{Body, N_INFLUENCES, N_JOINTS, PARENTS};
use crate::camera::Camera;
use crate::gpu::Gpu;
use crate::npz::{Array, Npz};
use crate::ops::linear::Vector;
use crate::ops::project::{self, Project};
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, golden, gpu, points, random};

/// The golden body: joints regressed by a matrix, weights as a dense one.
struct Golden {
    npz: Npz,
    model: Model<'static, f64>,
    camera: Camera,
}

const VARIANTS: [&str; 2] = ["", "_noposedirs"];

impl Golden {
    fn load(variant: &str) -> Self {
        let npz = golden("body.npz");
        let (lbs_joints, lbs_weights) = sparse(npz.get("weights").unwrap());
        let regressor = npz.get("joint_regressor").unwrap();
        let regress = |name: &str| product(regressor, npz.get(name).unwrap());
        let model = Model {
            j_template: Cow::Owned(points(&regress("v_template"))),
            j_shapedirs: Cow::Owned(regress("shapedirs")),
            v_template: Cow::Owned(points(&npz.get("v_template").unwrap().data)),
            shapedirs: Cow::Owned(npz.get("shapedirs").unwrap().data.clone()),
            posedirs: match variant {
                "" => Cow::Owned(npz.get("posedirs").unwrap().data.clone()),
                _ => Cow::Borrowed(&[]),
            },
            parents: Cow::Owned(npz.get("parents").unwrap().data.iter().map(|&p| p as i32).collect()),
            lbs_joints: Cow::Owned(lbs_joints),
            lbs_weights: Cow::Owned(lbs_weights),
        };
        let camera = match npz.get("camera").unwrap().data[..] {
            [fx, fy, cx, cy] => {
                format!(r#"{{"width": 1, "height": 1, "fx": {fx}, "fy": {fy}, "cx": {cx}, "cy": {cy}}}"#)
            }
            _ => panic!("camera"),
        };
        Self { npz, model, camera: serde_json::from_str(&camera).unwrap() }
    }

    fn data(&self, name: &str) -> &[f64] {
        &self.npz.get(name).unwrap().data
    }
}

/// A dense `[V, J]` as the four largest entries of each row.
fn sparse(weights: &Array) -> (Vec<[u32; N_INFLUENCES]>, Vec<[f64; N_INFLUENCES]>) {
    let row = |row: &[f64]| {
        let mut order: Vec<usize> = (0..row.len()).collect();
        order.sort_by(|&a, &b| row[b].total_cmp(&row[a]));
        assert!(order[N_INFLUENCES..].iter().all(|&j| row[j] == 0.0), "more than {N_INFLUENCES} influences");
        (std::array::from_fn(|k| order[k] as u32), std::array::from_fn(|k| row[order[k]]))
    };
    weights.data.chunks(weights.shape[1]).map(row).unzip()
}

/// `[J, V] · [V, …]`
fn product(matrix: &Array, dense: &Array) -> Vec<f64> {
    let (n, width) = (matrix.shape[1], dense.data.len() / matrix.shape[1]);
    let mut out = vec![0.0; matrix.shape[0] * width];
    for (j, row) in out.chunks_mut(width).enumerate() {
        for v in 0..n {
            for (value, d) in row.iter_mut().zip(&dense.data[v * width..]) {
                *value += matrix.data[j * n + v] * d;
            }
        }
    }
    out
}

/// The model as the body that the device loads.
fn body(model: &Model<'_, f64>) -> Body {
    let flat = |x: &[Vector<f64>]| points(&f32s(x.as_flattened()));
    Body {
        v_template: flat(&model.v_template),
        shapedirs: f32s(&model.shapedirs),
        posedirs: f32s(&model.posedirs),
        j_template: flat(&model.j_template),
        j_shapedirs: f32s(&model.j_shapedirs),
        n_betas: model.shapedirs.len() / (3 * model.v_template.len()),
        parents: model.parents.to_vec(),
        lbs_joints: model.lbs_joints.to_vec(),
        lbs_weights: points(&f32s(model.lbs_weights.as_flattened())),
        ..Body::test_body()
    }
}

/// The parameters of `N` frames and the gradients by their results.
struct Scene {
    betas: Vec<f64>,
    offsets: Vec<f64>,
    poses: Vec<f64>,
    transl: Vec<f64>,
    grad_vertices: Vec<f64>,
    grad_joints: Vec<f64>,
}

impl Scene {
    fn random(seed: u64, n_vertices: usize, n_betas: usize, n_frames: usize) -> Self {
        let near = |seed, n, scale: f64| random(seed, n).iter().map(|x| x * scale).collect();
        let mut poses: Vec<f64> = near(seed + 2, 72 * n_frames, 0.8);
        poses[9..12].fill(0.0);
        Self {
            betas: random(seed, n_betas),
            offsets: near(seed + 1, 3 * n_vertices, 0.03),
            poses,
            transl: near(seed + 3, 3 * n_frames, 2.0),
            grad_vertices: random(seed + 4, 3 * n_vertices * n_frames),
            grad_joints: random(seed + 5, 72 * n_frames),
        }
    }

    fn pose(&self, frame: usize) -> Vec<Vector<f64>> {
        points(&self.poses[72 * frame..][..72])
    }

    fn transl(&self, frame: usize) -> Vector<f64> {
        self.transl[3 * frame..][..3].try_into().unwrap()
    }

    /// Forward and backward of `frames`, in the twin.
    fn cpu(&self, model: &Model<'_, f64>, frames: &[usize]) -> (Vec<cpu::Posed<f64>>, Vec<Gradients<f64>>) {
        let n = model.v_template.len();
        let shape = cpu::shape_forward(model, &self.betas, &points(&self.offsets));
        let mut shared = Gradients::zeros(n, self.betas.len());
        let (mut posed, mut grads) = (Vec::new(), Vec::new());
        for &frame in frames {
            let pose = self.pose(frame);
            let result = cpu::pose_forward(model, &shape, &pose, self.transl(frame));
            let grad_vertices = points(&self.grad_vertices[3 * n * frame..][..3 * n]);
            let grad_joints = points(&self.grad_joints[72 * frame..][..72]);
            shared.pose.fill([0.0; 3]);
            shared.transl = [0.0; 3];
            cpu::pose_backward(model, &shape, &result, &pose, &grad_vertices, &grad_joints, &mut shared);
            posed.push(result);
            grads.push(shared.clone());
        }
        cpu::shape_backward(model, grads.last_mut().unwrap());
        (posed, grads)
    }

    fn loss(&self, model: &Model<'_, f64>) -> f64 {
        let shape = cpu::shape_forward(model, &self.betas, &points(&self.offsets));
        let posed = cpu::pose_forward(model, &shape, &self.pose(0), self.transl(0));
        let vertices = posed.vertices.as_flattened().iter().zip(&self.grad_vertices);
        vertices.chain(posed.joints.as_flattened().iter().zip(&self.grad_joints)).map(|(x, g)| x * g).sum()
    }
}

/// A body of random numbers; every fourth vertex hangs on a single joint.
fn random_model(seed: u64, n_vertices: usize, n_betas: usize) -> Model<'static, f64> {
    let near = |seed, n, scale: f64| random(seed, n).iter().map(|x| x * scale).collect::<Vec<_>>();
    let raw = random(seed, 8 * n_vertices);
    let joints = raw.chunks(8).map(|r| std::array::from_fn(|k| ((r[k] + 1.0) * 11.99) as u32)).collect();
    let weights = raw.chunks(8).enumerate().map(|(v, r)| {
        let w: [f64; 4] = std::array::from_fn(|k| if v % 4 == 0 && k > 0 { 0.0 } else { r[4 + k] + 1.001 });
        w.map(|x| x / w.iter().sum::<f64>())
    });
    Model {
        v_template: Cow::Owned(points(&random(seed + 1, 3 * n_vertices))),
        shapedirs: Cow::Owned(near(seed + 2, 3 * n_vertices * n_betas, 0.05)),
        posedirs: Cow::Owned(near(seed + 3, 207 * 3 * n_vertices, 0.01)),
        j_template: Cow::Owned(points(&near(seed + 4, 72, 0.5))),
        j_shapedirs: Cow::Owned(near(seed + 5, 72 * n_betas, 0.05)),
        parents: Cow::Borrowed(&PARENTS),
        lbs_joints: Cow::Owned(joints),
        lbs_weights: Cow::Owned(weights.collect()),
    }
}

fn assert_gradients_of(scene: &mut Scene, model: &Model<'_, f64>) {
    let (_, grads) = scene.cpu(model, &[0]);
    let grads = &grads[0];
    let flat = |g: &[Vector<f64>]| g.as_flattened().to_vec();
    type Field = fn(&mut Scene) -> &mut Vec<f64>;
    let fields: [(&str, Field, Vec<f64>); 4] = [
        ("betas", |s| &mut s.betas, grads.betas.clone()),
        ("offsets", |s| &mut s.offsets, flat(&grads.offsets)),
        ("pose", |s| &mut s.poses, flat(&grads.pose)),
        ("transl", |s| &mut s.transl, grads.transl.to_vec()),
    ];
    for (name, field, gradient) in fields {
        let x = field(scene).clone();
        assert_gradient(name, &x, &gradient, |moved| {
            field(scene).copy_from_slice(moved);
            scene.loss(model)
        });
        field(scene).copy_from_slice(&x);
    }
}

#[test]
fn gradient_with_pose_blend_shapes() {
    assert_gradients_of(&mut Scene::random(10, 5, 2, 1), &random_model(20, 5, 2));
}

#[test]
fn gradient_without_pose_blend_shapes() {
    let model = Model { posedirs: Cow::Borrowed(&[]), ..random_model(21, 5, 2) };
    assert_gradients_of(&mut Scene::random(11, 5, 2, 1), &model);
}

#[test]
fn gradient_at_the_zero_pose() {
    let mut scene = Scene::random(12, 5, 2, 1);
    scene.poses.fill(0.0);
    assert_gradients_of(&mut scene, &random_model(22, 5, 2));
}

#[test]
fn cpu_matches_golden() {
    for variant in VARIANTS {
        let g = Golden::load(variant);
        let named = |name: &str| format!("{name}{variant}");
        // The reference adds 1e-8 to every angle before it divides by it.
        let close = |name: &str, ours: &[f64]| assert_close(&named(name), ours, g.data(&named(name)), 1e-7);
        let (betas, pose, offsets) = (g.data("betas"), points(g.data("theta")), points(g.data("offsets")));
        let shape = cpu::shape_forward(&g.model, betas, &offsets);
        let posed = cpu::pose_forward(&g.model, &shape, &pose, g.data("trans").try_into().unwrap());
        close("vertices", posed.vertices.as_flattened());
        close("joints", posed.joints.as_flattened());
        let (_, joints2d) = project::cpu::forward(&g.camera, &posed.joints);
        close("joints2d", joints2d.as_flattened());

        let grad_vertices = points(g.data(&named("upstream_vertices")));
        let mut grad_joints = vec![[0.0; 3]; N_JOINTS];
        let grad_joints2d = points(g.data(&named("upstream_joints2d")));
        project::cpu::screen_backward(&g.camera, &posed.joints, &grad_joints2d, &mut grad_joints);
        let mut grads = Gradients::zeros(offsets.len(), betas.len());
        cpu::pose_backward(&g.model, &shape, &posed, &pose, &grad_vertices, &grad_joints, &mut grads);
        cpu::shape_backward(&g.model, &mut grads);
        close("grad_betas", &grads.betas);
        close("grad_theta", grads.pose.as_flattened());
        close("grad_offsets", grads.offsets.as_flattened());
        close("grad_trans", &grads.transl);
    }
}

#[test]
fn gpu_matches_golden() {
    let Some(gpu) = gpu("skinning::gpu_matches_golden") else { return };
    for variant in VARIANTS {
        let g = Golden::load(variant);
        let named = |name: &str| format!("{name}{variant}");
        let upload = |name: &str| gpu.upload(name, &f32s(g.data(name)));
        let device = SkinningBody::new(&gpu, &body(&g.model));
        let (shape, posed, project) = (device.shape_state(&gpu), device.pose_state(&gpu), Project::new(&gpu));
        let (betas, offsets, poses, transl) = (upload("betas"), upload("offsets"), upload("theta"), upload("trans"));
        let (grad_vertices, grad_joints2d) = (upload(&named("upstream_vertices")), upload(&named("upstream_joints2d")));
        let zeros = |name: &str, len: usize| gpu.zeros::<f32>(name, len);
        let (view, joints2d, grad_joints) = (zeros("view", 72), zeros("joints2d", 48), zeros("grad_joints", 72));
        let (grad_betas, grad_offsets) = (zeros("grad_betas", betas.len()), zeros("grad_offsets", offsets.len()));
        let (grad_poses, grad_transl) = (zeros("grad_poses", 72), zeros("grad_transl", 3));

        let at = PoseAt { poses: &poses, transl: &transl, frame: 0 };
        let grad = PoseAt { poses: &grad_poses, transl: &grad_transl, frame: 0 };
        let mut recorder = gpu.recorder("skinning/test");
        device.shape_forward(&mut recorder, &betas, &offsets, &shape);
        device.pose_forward(&mut recorder, &shape, at, &posed);
        project.forward(&mut recorder, &g.camera, &posed.joints, &view, &joints2d);
        project.screen_backward(&mut recorder, &g.camera, &posed.joints, &grad_joints2d, &grad_joints);
        device.pose_backward(&mut recorder, &shape, at, &posed, &grad_vertices, &grad_joints, grad);
        device.shape_backward(&mut recorder, &shape, &grad_betas, &grad_offsets);
        recorder.submit().unwrap();
        for (name, buffer, tolerance) in [
            ("vertices", &posed.vertices, VALUE),
            ("joints", &posed.joints, VALUE),
            ("joints2d", &joints2d, VALUE),
            ("grad_betas", &grad_betas, GRADIENT),
            ("grad_theta", &grad_poses, GRADIENT),
            ("grad_offsets", &grad_offsets, GRADIENT),
            ("grad_trans", &grad_transl, GRADIENT),
        ] {
            let (name, ours) = (named(name), gpu.read(buffer).unwrap());
            assert_close(&name, &ours, g.data(&name), tolerance);
        }
    }
}

/// Poses frames 2 and 0 of three and goes back through both into the same gradients, which start at a half.
fn assert_gpu_matches_cpu(gpu: &Gpu, model: &Model<'_, f64>, n_betas: usize) {
    let n = model.v_template.len();
    let (scene, frames) = (Scene::random(30, n, n_betas, 3), [2, 0]);
    let (want, want_grads) = scene.cpu(model, &frames);

    let device = SkinningBody::new(gpu, &body(model));
    let (shape, posed) = (device.shape_state(gpu), [device.pose_state(gpu), device.pose_state(gpu)]);
    let upload = |name: &str, data: &[f64]| gpu.upload(name, &f32s(data));
    let halves = |name: &str, len: usize| gpu.upload(name, &vec![0.5f32; len]);
    let (betas, offsets) = (upload("betas", &scene.betas), upload("offsets", &scene.offsets));
    let (poses, transl) = (upload("poses", &scene.poses), upload("transl", &scene.transl));
    let (grad_betas, grad_offsets) = (halves("grad_betas", n_betas), halves("grad_offsets", 3 * n));
    let (grad_poses, grad_transl) = (halves("grad_poses", 72 * 3), halves("grad_transl", 3 * 3));
    let mut recorder = gpu.recorder("skinning/test");
    device.shape_forward(&mut recorder, &betas, &offsets, &shape);
    for (&frame, posed) in frames.iter().zip(&posed) {
        let at = PoseAt { poses: &poses, transl: &transl, frame };
        let grad_vertices = upload("grad_vertices", &scene.grad_vertices[3 * n * frame..][..3 * n]);
        let grad_joints = upload("grad_joints", &scene.grad_joints[72 * frame..][..72]);
        let grad = PoseAt { poses: &grad_poses, transl: &grad_transl, frame };
        device.pose_forward(&mut recorder, &shape, at, posed);
        device.pose_backward(&mut recorder, &shape, at, posed, &grad_vertices, &grad_joints, grad);
    }
    device.shape_backward(&mut recorder, &shape, &grad_betas, &grad_offsets);
    recorder.submit().unwrap();

    let read = |buffer| gpu.read::<f32>(buffer).unwrap();
    let from_half = |grads: &[f64]| grads.iter().map(|g| g + 0.5).collect::<Vec<_>>();
    for (posed, want) in posed.iter().zip(&want) {
        assert_close("vertices", &read(&posed.vertices), want.vertices.as_flattened(), VALUE);
        assert_close("joints", &read(&posed.joints), want.joints.as_flattened(), VALUE);
    }
    let (gpu_poses, gpu_transl) = (read(&grad_poses), read(&grad_transl));
    for (&frame, want) in frames.iter().zip(&want_grads) {
        let want_pose = from_half(want.pose.as_flattened());
        assert_close("grad_poses", &gpu_poses[72 * frame..][..72], &want_pose, GRADIENT);
        assert_close("grad_transl", &gpu_transl[3 * frame..][..3], &from_half(&want.transl), GRADIENT);
    }
    assert_eq!(gpu_poses[72..144], [0.5; 72], "a frame that was not posed");
    assert_eq!(gpu_transl[3..6], [0.5; 3], "a frame that was not posed");
    assert_close("grad_betas", &read(&grad_betas), &from_half(&want_grads[1].betas), GRADIENT);
    assert_close("grad_offsets", &read(&grad_offsets), &from_half(want_grads[1].offsets.as_flattened()), GRADIENT);
}

#[test]
fn gpu_matches_cpu_with_pose_blend_shapes() {
    let Some(gpu) = gpu("skinning::gpu_matches_cpu_with_pose_blend_shapes") else { return };
    assert_gpu_matches_cpu(&gpu, &random_model(40, 1500, 5), 5);
}

#[test]
fn gpu_matches_cpu_without_pose_blend_shapes() {
    let Some(gpu) = gpu("skinning::gpu_matches_cpu_without_pose_blend_shapes") else { return };
    let model = Model { posedirs: Cow::Borrowed(&[]), ..random_model(41, 4001, 16) };
    assert_gpu_matches_cpu(&gpu, &model, 16);
}

#[test]
fn the_zero_pose_is_the_template_moved() {
    let body = Body::test_body();
    let posed = cpu::forward(&body, &[], None, &[0.0; 72], [0.1, 0.2, 0.3]);
    let moved = |x: &[[f32; 3]]| x.iter().map(|p| [p[0] + 0.1, p[1] + 0.2, p[2] + 0.3]).collect::<Vec<_>>();
    assert_close("vertices", posed.vertices.as_flattened(), moved(&body.v_template).as_flattened(), 1e-6);
    assert_close("joints", posed.joints.as_flattened(), moved(&body.j_template).as_flattened(), 1e-6);
}

#[test]
fn a_bent_elbow_moves_the_hand_and_leaves_the_leg() {
    let body = Body::test_body();
    let mut pose = [0.0; 72];
    pose[18 * 3 + 1] = -std::f32::consts::FRAC_PI_2; // the left forearm, along +X, turns to +Z
    let posed = cpu::forward(&body, &[0.0; 3], None, &pose, [0.0; 3]);
    let [elbow, wrist] = [18, 20].map(|j| posed.joints[j]);
    let length = body.j_template[20][0] - body.j_template[18][0];
    assert_close("elbow", &elbow, &body.j_template[18], 1e-6);
    assert_close("wrist", &wrist, &[elbow[0], wrist[1], elbow[2] + length], 1e-6);
    assert_eq!(posed.joints[4], body.j_template[4]);
}
