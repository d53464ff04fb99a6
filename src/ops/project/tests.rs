use super::{Project, Z_MIN, cpu};
use crate::camera::Camera;
use crate::ops::skinning::rodrigues;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, gpu, points, random};

fn camera() -> Camera {
    let rotation = rodrigues([0.3f64, -2.0, 0.5]);
    Camera {
        width: 640,
        height: 480,
        fx: 520.0,
        fy: 515.0,
        cx: 331.0,
        cy: 227.5,
        distortion: [0.0; 5],
        rotation: rotation.as_flattened().try_into().unwrap(),
        translation: [0.2, -0.1, 3.0],
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[test]
fn a_point_on_the_axis_falls_on_the_principal_point() {
    let camera = Camera { translation: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], ..camera() };
    let (view, screen) = cpu::forward(&camera, &[[0.0, 0.0, 2.0], [0.5, -0.25, 2.0]]);
    assert_eq!(view[1], [0.5, -0.25, 2.0]);
    assert_eq!(screen, [[331.0, 227.5], [331.0 + 130.0, 227.5 - 515.0 / 8.0]]);
}

#[test]
fn gradient_through_view_and_screen() {
    let (camera, x) = (camera(), random(1, 12));
    let (grad_view, grad_screen) = (random(2, 12), random(3, 8));
    let mut grads = vec![[0.0; 3]; 4];
    cpu::view_backward(&camera, &points(&grad_view), &mut grads);
    cpu::screen_backward(&camera, &points(&x), &points(&grad_screen), &mut grads);
    assert_gradient("points", &x, grads.as_flattened(), |x| {
        let (view, screen) = cpu::forward(&camera, &points(x));
        dot(view.as_flattened(), &grad_view) + dot(screen.as_flattened(), &grad_screen)
    });
}

#[test]
fn gradient_of_a_point_behind_the_camera_leaves_its_depth_alone() {
    let camera = Camera { fx: 1e-3, fy: 1e-3, ..camera() };
    let behind = crate::ops::linear::mul_transposed(&rodrigues([0.3, -2.0, 0.5]), [0.1, 0.2, -4.0]);
    let mut grads = vec![[0.0; 3]];
    cpu::screen_backward(&camera, &[behind], &[[0.7, -0.3]], &mut grads);
    assert_gradient("points", &behind, grads.as_flattened(), |x| {
        let (view, screen) = cpu::forward(&camera, &[[x[0], x[1], x[2]]]);
        assert!(view[0][2] < Z_MIN);
        dot(&screen[0], &[0.7, -0.3])
    });
}

#[test]
fn gpu_matches_cpu() {
    let Some(gpu) = gpu("project::gpu_matches_cpu") else { return };
    let (camera, n) = (camera(), 1000);
    let x = random(4, 3 * n);
    let (grad_view, grad_screen) = (random(5, 3 * n), random(6, 2 * n));
    let (view, screen) = cpu::forward(&camera, &points(&x));
    let mut grads = vec![[0.5; 3]; n];
    cpu::view_backward(&camera, &points(&grad_view), &mut grads);
    cpu::screen_backward(&camera, &points(&x), &points(&grad_screen), &mut grads);

    let project = Project::new(&gpu);
    let upload = |name: &str, data: &[f64]| gpu.upload(name, &f32s(data));
    let (x, grad_view, grad_screen) =
        (upload("points", &x), upload("grad_view", &grad_view), upload("grad_screen", &grad_screen));
    let (gpu_view, gpu_screen) = (gpu.zeros("view", 3 * n), gpu.zeros("screen", 2 * n));
    let gpu_grads = upload("grad_points", &vec![0.5; 3 * n]);
    let mut recorder = gpu.recorder("project/test");
    project.forward(&mut recorder, &camera, &x, &gpu_view, &gpu_screen);
    project.view_backward(&mut recorder, &camera, &grad_view, &gpu_grads);
    project.screen_backward(&mut recorder, &camera, &x, &grad_screen, &gpu_grads);
    recorder.submit().unwrap();
    assert_close("view", &gpu.read(&gpu_view).unwrap(), view.as_flattened(), VALUE);
    assert_close("screen", &gpu.read(&gpu_screen).unwrap(), screen.as_flattened(), VALUE);
    assert_close("grad_points", &gpu.read(&gpu_grads).unwrap(), grads.as_flattened(), GRADIENT);
}
