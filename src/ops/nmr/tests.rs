use super::cpu::grad_screen;
use super::{Nmr, NmrConfig};
use crate::camera::Camera;
use crate::ops::edge_gradient::cpu::Pixels;
use crate::ops::edge_gradient::tests::check_parity;
use crate::ops::hard_rasterize::{HardRasterizeConfig, cpu as hard};
use crate::ops::testing::gpu;

const WIDTH: usize = 20;
const HEIGHT: usize = 14;
const CAMERA: Camera = Camera::pinhole(WIDTH as u32, HEIGHT as u32, [10.0, 10.0, 10.0, 7.0]);

/// One face with its right angle at the upper left; row 5 shows it from column 7 to 10.
const VIEW: [f64; 9] = [-0.3, -0.35, 1.0, 0.41, -0.35, 1.0, -0.3, 0.36, 1.0];

fn on_face(grad_alpha: &[f64], view: &[f64]) -> (Vec<f64>, Vec<f64>, hard::Image<f64>) {
    let image = hard::forward(&HardRasterizeConfig::default(), &CAMERA, view, &[[0, 1, 2]]);
    let pixels = Pixels { width: WIDTH, height: HEIGHT, hard: &image, rgb: None, grad_alpha, min_step: 0.02 };
    let screen = grad_screen(&pixels, 1 << 16);
    let mut grad_view = vec![0.0; 9];
    hard::screen_backward(&CAMERA, view, &[[0, 1, 2]], &image.pix_to_face, &screen, &mut grad_view);
    (screen, grad_view, image)
}

fn only_at(pixels: &[(usize, usize, f64)]) -> Vec<f64> {
    let mut grad = vec![0.0; WIDTH * HEIGHT];
    for &(x, y, g) in pixels {
        grad[y * WIDTH + x] = g;
    }
    grad
}

/// The columns that row 5 shows.
fn row_5(image: &hard::Image<f64>) -> (usize, usize) {
    let covered = |x: &usize| image.pix_to_face[5 * WIDTH + x] == 0;
    ((0..WIDTH).find(covered).unwrap(), (0..WIDTH).rfind(covered).unwrap())
}

#[test]
fn a_pixel_outside_that_wants_coverage_pulls_on_both_its_axes() {
    let (_, _, image) = on_face(&only_at(&[]), &VIEW);
    let (_, last) = row_5(&image);
    let (screen, grad_view, _) = on_face(&only_at(&[(last + 4, 5, -2.0)]), &VIEW);
    // The border lies 3.5 pixels before the wanting pixel; Δ = 2.
    assert!((screen[(5 * WIDTH + last) * 2] + 2.0 / 3.5).abs() < 1e-12);
    assert_eq!(screen.iter().filter(|g| **g != 0.0).count(), 1, "its column does not meet the face");
    let along_x: f64 = grad_view.iter().step_by(3).sum();
    assert!(along_x < 0.0, "descent moves the face to the right");
}

#[test]
fn a_pixel_inside_that_wants_none_pushes_the_borders_back() {
    let (_, _, image) = on_face(&only_at(&[]), &VIEW);
    let (first, last) = row_5(&image);
    let (screen, ..) = on_face(&only_at(&[(last - 1, 5, 3.0)]), &VIEW);
    let at = |x: usize| screen[(5 * WIDTH + x) * 2];
    assert!((at(last) - 3.0 / 1.5).abs() < 1e-12, "to the left");
    assert!((at(first) + 3.0 / ((last - 1 - first) as f64 + 0.5)).abs() < 1e-12, "to the right");
}

#[test]
fn an_image_that_is_right_pulls_on_nothing() {
    let (_, _, image) = on_face(&only_at(&[]), &VIEW);
    // Covered pixels want more coverage, the others less: no border can help.
    let grad: Vec<f64> = image.alpha.iter().map(|a| 1.0 - 2.0 * a).collect();
    let (screen, grad_view, _) = on_face(&grad, &VIEW);
    assert!(screen.iter().chain(&grad_view).all(|&g| g == 0.0));
}

#[test]
fn descent_reaches_a_mask_beside_the_face() {
    let target = hard::forward(&HardRasterizeConfig::default(), &CAMERA, &VIEW, &[[0, 1, 2]]).alpha;
    // Four pixels to the left and two up.
    let mut view = VIEW;
    view.chunks_mut(3).for_each(|v| (v[0], v[1]) = (v[0] - 0.4, v[1] - 0.2));
    let off = |view: &[f64]| {
        let (.., image) = on_face(&only_at(&[]), view);
        let grad: Vec<f64> = image.alpha.iter().zip(&target).map(|(a, t)| a - t).collect();
        (grad.iter().map(|g| g.abs()).sum::<f64>(), grad)
    };
    let before = off(&view).0;
    for _ in 0..60 {
        let (_, grad, _) = on_face(&off(&view).1, &view);
        // The face moves as a whole, a tenth of a pixel a step.
        let along = [0, 1].map(|c| grad.iter().skip(c).step_by(3).sum::<f64>());
        let length = along[0].hypot(along[1]).max(1e-9);
        view.chunks_mut(3)
            .for_each(|v| (v[0], v[1]) = (v[0] - 0.01 * along[0] / length, v[1] - 0.01 * along[1] / length));
    }
    let after = off(&view).0;
    assert!(after <= 0.2 * before, "{after} pixels are wrong, {before} at the start");
}

#[test]
fn gpu_matches_cpu_on_a_body_like_surface() {
    let Some(gpu) = gpu("nmr::gpu_matches_cpu_on_a_body_like_surface") else { return };
    for max_sweep in [1 << 16, 9] {
        let op = Nmr::new(&gpu, 61 * 75, NmrConfig { min_step: 0.01, max_sweep });
        check_parity(
            &gpu,
            0.01,
            |r, hard, camera, view, rgb, grad_alpha, grad_view| {
                op.backward(r, hard, camera, view, rgb, grad_alpha, grad_view)
            },
            |pixels| grad_screen(pixels, max_sweep as usize),
        );
    }
}
