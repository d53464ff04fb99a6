use super::{KeypointGather, KeypointLoss, cpu};
use crate::body::{KeypointSet, KeypointSource};
use crate::gpu::Gpu;
use crate::ops::LossSlot;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, golden, gpu, points, random};

/// Every kind of source: vertices and joints that several keypoints share, and a keypoint without source.
fn set() -> KeypointSet {
    let points = vec![
        KeypointSource::Joint(2),
        KeypointSource::Vertices(vec![1, 3, 4]),
        KeypointSource::Joints(vec![2, 0]),
        KeypointSource::Vertices(vec![3]),
        KeypointSource::Vertices(vec![]),
    ];
    KeypointSet { format: "test".to_owned(), points }
}

const SCREEN: [f64; 8] = [10.0, 20.0, 31.0, 18.0, 50.0, 60.0, 7.0, 8.0];
/// One near, one of half confidence, one far away, one not seen.
const TARGETS: [[f64; 3]; 4] = [[11.0, 18.0, 1.0], [30.0, 22.0, 0.5], [150.0, -60.0, 0.9], [f64::NAN, 0.0, 0.0]];

#[test]
fn gradient_of_gathered_sources() {
    let (x, grad_keypoints) = (random(1, 15 + 9), random(2, 15));
    let (mut grad_vertices, mut grad_joints) = (vec![[0.0; 3]; 5], vec![[0.0; 3]; 3]);
    cpu::gather_backward(&set(), &points(&grad_keypoints), &mut grad_vertices, &mut grad_joints);
    let grads = [grad_vertices, grad_joints].concat();
    assert_gradient("sources", &x, grads.as_flattened(), |x| {
        let keypoints = cpu::gather(&set(), &points(&x[..15]), &points(&x[15..]));
        keypoints.as_flattened().iter().zip(&grad_keypoints).map(|(k, g)| k * g).sum()
    });
}

fn assert_gradient_of_loss(rho_px: Option<f64>) {
    let mut grads = vec![[0.0; 2]; 4];
    cpu::backward(&points(&SCREEN), &TARGETS, rho_px, 1.0, &mut grads);
    assert_gradient("screen", &SCREEN, grads.as_flattened(), |x| cpu::forward(&points(x), &TARGETS, rho_px));
    assert_eq!(grads[3], [0.0; 2]);
}

#[test]
fn gradient_of_squared_distances() {
    assert_gradient_of_loss(None);
}

#[test]
fn gradient_of_robust_distances() {
    assert_gradient_of_loss(Some(30.0));
}

#[test]
fn a_wrong_detection_costs_at_most_rho_squared() {
    let cost = |x: f64| cpu::forward(&[[x, 0.0]], &[[0.0, 0.0, 1.0]], Some(10.0));
    assert!((cost(0.1) - 0.01).abs() < 1e-5);
    assert!(cost(1e6) < 100.0 && cost(1e6) > 99.9);
}

/// Loss and gradient on the device, with the targets as frame 1 of 2.
fn on_gpu(gpu: &Gpu, screen: &[f64], targets: &[[f64; 3]], rho_px: Option<f32>, weight: f32) -> (f32, Vec<f32>) {
    let op = KeypointLoss::new(gpu, rho_px);
    let frames = [&vec![1.0; 3 * targets.len()][..], targets.as_flattened()].concat();
    let (gpu_screen, targets) = (gpu.upload("screen", &f32s(screen)), gpu.upload("targets", &f32s(&frames)));
    let (losses, grads) = (gpu.zeros("losses", 1), gpu.zeros("grad_screen", screen.len()));
    let mut recorder = gpu.recorder("keypoints/test");
    op.forward(&mut recorder, &gpu_screen, &targets, 1, LossSlot::new(&losses, 0));
    op.backward(&mut recorder, &gpu_screen, &targets, 1, weight, &grads);
    recorder.submit().unwrap();
    (gpu.read(&losses).unwrap()[0], gpu.read(&grads).unwrap())
}

/// Keypoints, targets, the loss and its gradient.
fn load() -> (Vec<f64>, Vec<[f64; 3]>, f64, Vec<f64>) {
    let npz = golden("losses.npz");
    let data = |name: &str| npz.get(name).unwrap().data.clone();
    let targets = points::<_, 2>(&data("keypoint_targets")).into_iter().zip(data("keypoint_confidence"));
    let targets = targets.map(|([x, y], c)| [x, y, c]).collect();
    (data("keypoints"), targets, npz.scalar("keypoint_loss").unwrap(), data("grad_keypoints"))
}

#[test]
fn cpu_matches_golden() {
    let (screen, targets, loss, grad) = load();
    let mut grads = vec![[0.0; 2]; targets.len()];
    cpu::backward(&points(&screen), &targets, None, 1.0, &mut grads);
    assert_close("loss", &[cpu::forward(&points(&screen), &targets, None)], &[loss], 1e-12);
    assert_close("grad", grads.as_flattened(), &grad, 1e-12);
}

#[test]
fn gpu_matches_golden() {
    let Some(gpu) = gpu("keypoints::gpu_matches_golden") else { return };
    let (screen, targets, want, want_grad) = load();
    let (loss, grad) = on_gpu(&gpu, &screen, &targets, None, 1.0);
    assert_close("loss", &[loss], &[want], VALUE);
    assert_close("grad", &grad, &want_grad, GRADIENT);
}

#[test]
fn gpu_matches_cpu_on_robust_distances_and_many_keypoints() {
    let Some(gpu) = gpu("keypoints::gpu_matches_cpu_on_robust_distances_and_many_keypoints") else { return };
    let n = 300;
    let screen: Vec<f64> = random(3, 2 * n).iter().map(|x| 100.0 * x).collect();
    let mut targets: Vec<[f64; 3]> = points(&random(4, 3 * n).iter().map(|x| 60.0 * x).collect::<Vec<_>>());
    targets[7] = [f64::NAN, f64::INFINITY, 0.0];
    let mut grads = vec![[0.0; 2]; n];
    cpu::backward(&points(&screen), &targets, Some(30.0), 0.3, &mut grads);
    let (loss, grad) = on_gpu(&gpu, &screen, &targets, Some(30.0), 0.3);
    assert_close("loss", &[loss], &[cpu::forward(&points(&screen), &targets, Some(30.0))], VALUE);
    assert_close("grad", &grad, grads.as_flattened(), GRADIENT);
}

#[test]
fn gpu_gathers_as_the_cpu_does() {
    let Some(gpu) = gpu("keypoints::gpu_gathers_as_the_cpu_does") else { return };
    let (vertices, joints, grad_keypoints) = (random(5, 15), random(6, 9), random(7, 15));
    let want = cpu::gather(&set(), &points(&vertices), &points(&joints));
    let (mut grad_vertices, mut grad_joints) = (vec![[0.5; 3]; 5], vec![[0.5; 3]; 3]);
    cpu::gather_backward(&set(), &points(&grad_keypoints), &mut grad_vertices, &mut grad_joints);

    let op = KeypointGather::new(&gpu, &set());
    let upload = |name: &str, data: &[f64]| gpu.upload(name, &f32s(data));
    let (vertices, joints, keypoints) =
        (upload("vertices", &vertices), upload("joints", &joints), gpu.zeros("keypoints", 15));
    let (gpu_vertices, gpu_joints) = (upload("grad_vertices", &[0.5; 15]), upload("grad_joints", &[0.5; 9]));
    let mut recorder = gpu.recorder("keypoints/test");
    op.forward(&mut recorder, &vertices, &joints, &keypoints);
    op.backward(&mut recorder, &upload("grad_keypoints", &grad_keypoints), &gpu_vertices, &gpu_joints);
    recorder.submit().unwrap();
    assert_close("keypoints", &gpu.read(&keypoints).unwrap(), want.as_flattened(), VALUE);
    assert_close("grad_vertices", &gpu.read(&gpu_vertices).unwrap(), grad_vertices.as_flattened(), GRADIENT);
    assert_close("grad_joints", &gpu.read(&gpu_joints).unwrap(), grad_joints.as_flattened(), GRADIENT);
}
