use std::sync::Arc;

use super::cpu::{Pixels, grad_screen};
use super::{EdgeGradient, RgbGradient};
use crate::camera::Camera;
use crate::gpu::{Buffer, Gpu, Recorder};
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer, cpu as hard};
use crate::ops::testing::{assert_close, bumpy_surface, f32s, gpu, noise};
use crate::ops::{Corners, Topology};

const WIDTH: usize = 32;
const HEIGHT: usize = 28;
const CAMERA: Camera = Camera::pinhole(WIDTH as u32, HEIGHT as u32, [40.0, 40.0, 16.3, 13.8]);
const BACKGROUND: [f64; 3] = [0.1, 0.2, 0.3];
/// Samples a pixel along each axis of the reference image.
const SAMPLES: usize = 8;

struct Scene {
    view: Vec<f64>,
    faces: Vec<[u32; 3]>,
    colours: Vec<f64>,
    min_step: f64,
}

/// An upstream gradient that changes little from pixel to pixel, `[H, W, 4]` by channels.
fn smooth(pixel: usize, channel: usize) -> f64 {
    let (x, y) = ((pixel % WIDTH) as f64, (pixel / WIDTH) as f64);
    (0.11 * x + 0.07 * y + channel as f64).sin() + 0.5 * (0.05 * x - 0.13 * y + 2.0 * channel as f64).cos()
}

fn image(view: &[f64], scene: &Scene, camera: &Camera) -> (hard::Image<f64>, Vec<f64>) {
    let image = hard::forward(&HardRasterizeConfig::default(), camera, view, &scene.faces);
    let rgb = hard::shade(&image.pix_to_face, &scene.colours, BACKGROUND);
    (image, rgb)
}

impl Scene {
    /// The loss of the area-sampled image, whose derivative the operator estimates.
    fn loss(&self, view: &[f64]) -> f64 {
        let camera = CAMERA.scaled((WIDTH * SAMPLES) as u32, (HEIGHT * SAMPLES) as u32);
        let (fine, rgb) = image(view, self, &camera);
        let of_sample = |i: usize| {
            let pixel = i / (WIDTH * SAMPLES) / SAMPLES * WIDTH + i % (WIDTH * SAMPLES) / SAMPLES;
            (0..3).map(|c| smooth(pixel, c) * rgb[i * 3 + c]).sum::<f64>() + smooth(pixel, 3) * fine.alpha[i]
        };
        (0..camera.n_pixels()).map(of_sample).sum::<f64>() / (SAMPLES * SAMPLES) as f64
    }

    fn gradient(&self) -> Vec<f64> {
        let (hard, rgb) = image(&self.view, self, &CAMERA);
        let grad_image: Vec<f64> = (0..WIDTH * HEIGHT * 3).map(|i| smooth(i / 3, i % 3)).collect();
        let grad_alpha: Vec<f64> = (0..WIDTH * HEIGHT).map(|i| smooth(i, 3)).collect();
        let pixels = Pixels {
            width: WIDTH,
            height: HEIGHT,
            hard: &hard,
            rgb: Some((&rgb, &grad_image)),
            grad_alpha: &grad_alpha,
            min_step: self.min_step,
        };
        let mut grad_view = vec![0.0; self.view.len()];
        let grad = grad_screen(&pixels);
        hard::screen_backward(&CAMERA, &self.view, &self.faces, &hard.pix_to_face, &grad, &mut grad_view);
        grad_view
    }

    /// Against central differences of the area-sampled image, half a pixel to each side. An edge is seen once a row or
    /// column, so that agreement is statistical.
    #[track_caller]
    fn check(&self, tolerance: f64) {
        let step = 0.5 / CAMERA.fx;
        let difference = |i: usize| {
            let moved = |by: f64| {
                let mut view = self.view.clone();
                view[i] += by;
                self.loss(&view)
            };
            (moved(step) - moved(-step)) / (2.0 * step)
        };
        let want: Vec<f64> = (0..self.view.len()).map(difference).collect();
        assert_close("grad_view", &self.gradient(), &want, tolerance);
    }
}

const FRONT: [f64; 9] = [-0.26, -0.21, 1.0, 0.29, -0.13, 1.1, 0.04, 0.27, 1.05];

#[test]
fn a_face_over_the_background() {
    let scene = Scene { view: FRONT.to_vec(), faces: vec![[0, 1, 2]], colours: vec![0.9, 0.5, 0.7], min_step: 0.02 };
    scene.check(0.1);
}

#[test]
fn a_face_over_another() {
    let mut view = FRONT.to_vec();
    view.extend([-2.0, -2.0, 2.0, 3.0, -1.5, 2.0, 0.0, 4.0, 2.1]);
    let colours = vec![0.9, 0.5, 0.7, 0.2, 0.8, 0.1];
    Scene { view, faces: vec![[0, 1, 2], [3, 4, 5]], colours, min_step: 0.02 }.check(0.1);
}

#[test]
fn borders_within_a_surface_count_only_without_a_step() {
    let mut view = FRONT.to_vec();
    view.extend([-0.28, 0.25, 1.02]);
    let faces = vec![[0, 1, 2], [0, 2, 3]];
    let mut scene = Scene { view, faces, colours: vec![0.9, 0.5, 0.7, 0.0, 0.9, 0.1], min_step: 0.0 };
    scene.check(0.15);
    let with_borders = scene.gradient();
    scene.min_step = 0.02;
    let without = scene.gradient();
    scene.colours = vec![0.5; 6];
    scene.min_step = 0.0;
    let one_colour = scene.gradient();
    scene.min_step = 0.02;
    assert_close("one colour", &one_colour, &scene.gradient(), 1e-12);
    let change: f64 = with_borders.iter().zip(&without).map(|(a, b)| (a - b).abs()).sum();
    assert!(change > 0.1, "the inner border pulls on nothing");
}

#[test]
fn gpu_matches_cpu_on_a_body_like_surface() {
    let Some(gpu) = gpu("edge_gradient::gpu_matches_cpu_on_a_body_like_surface") else { return };
    let op = EdgeGradient::new(&gpu, 61 * 75 + 3, 0.01);
    check_parity(
        &gpu,
        0.01,
        |r, hard, camera, view, rgb, grad_alpha, grad_view| {
            op.backward(r, hard, camera, view, rgb, grad_alpha, grad_view)
        },
        grad_screen,
    );
}

/// Holds an operator on the borders of a hard image to its twin, with colours and without.
pub fn check_parity(
    gpu: &Gpu,
    min_step: f64,
    record: impl Fn(
        &mut Recorder<'_>,
        &HardRasterizer,
        &Camera,
        &Buffer<f32>,
        Option<RgbGradient<'_>>,
        &Buffer<f32>,
        &Buffer<f32>,
    ),
    twin: impl Fn(&Pixels<'_, f64>) -> Vec<f64>,
) {
    let camera = Camera::pinhole(61, 75, [150.0, 150.0, 31.8, 37.1]);
    let n = camera.n_pixels();
    let (view, faces) = bumpy_surface(30);
    let corners = Arc::new(Corners::new(gpu, &faces, &Topology::new(view.len() / 3, &faces)));
    let op = HardRasterizer::new(gpu, &corners, n + 2, HardRasterizeConfig::default());
    let (rgb, grad_image, grad_alpha) = (noise(n * 3, 1), noise(n * 3, 2), noise(n, 3));
    let upload = |x: &[f64]| gpu.upload("test", &f32s(x));
    let on_gpu = (upload(&view), upload(&rgb), upload(&grad_image), upload(&grad_alpha));
    for with_colours in [false, true] {
        let grad_view = gpu.zeros("grad_view", view.len());
        let mut recorder = gpu.recorder("edge_gradient/test");
        op.forward(&mut recorder, &camera, &on_gpu.0);
        let colours = with_colours.then_some(RgbGradient { image: &on_gpu.1, grad_image: &on_gpu.2 });
        record(&mut recorder, &op, &camera, &on_gpu.0, colours, &on_gpu.3, &grad_view);
        recorder.submit().unwrap();

        let f64s = |buffer: &Buffer<f32>| gpu.read(buffer).unwrap()[..n].iter().map(|&x| f64::from(x)).collect();
        let hard = hard::Image {
            pix_to_face: gpu.read(&op.pix_to_face).unwrap()[..n].to_vec(),
            bary_coords: Vec::new(),
            zbuf: f64s(&op.zbuf),
            alpha: f64s(&op.alpha),
        };
        let pixels = Pixels {
            width: 61,
            height: 75,
            hard: &hard,
            rgb: with_colours.then_some((&rgb, &grad_image)),
            grad_alpha: &grad_alpha,
            min_step,
        };
        let mut want = vec![0.0; view.len()];
        let screen = twin(&pixels);
        assert!(screen.iter().filter(|g| **g != 0.0).count() > 100, "few borders");
        hard::screen_backward(&camera, &view, &faces, &hard.pix_to_face, &screen, &mut want);
        assert_close("grad_view", &gpu.read(&grad_view).unwrap(), &want, 2e-3);
    }
}
