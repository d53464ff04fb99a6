use std::sync::Arc;

use super::{SoftRasterizeParams, SoftRasterizer, cpu};
use crate::camera::Camera;
use crate::gpu::{Buffer, Gpu};
use crate::ops::Corners;
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, bumpy_surface, f32s, golden, gpu, noise};
use crate::ops::topology::Topology;

/// A scene with its upstream gradients.
struct Scene {
    params: SoftRasterizeParams,
    camera: Camera,
    view: Vec<f64>,
    faces: Vec<[u32; 3]>,
    colours: Vec<f64>,
    grad_rgb: Vec<f64>,
    grad_alpha: Vec<f64>,
}

struct Results {
    rgb: Vec<f64>,
    alpha: Vec<f64>,
    grad_view: Vec<f64>,
    grad_colours: Vec<f64>,
}

fn f64s(x: &[f32]) -> Vec<f64> {
    x.iter().map(|&x| x as f64).collect()
}

impl Scene {
    /// The golden scene and what it should give.
    fn golden(name: &str) -> (Self, Results) {
        let npz = golden(name);
        let data = |key: &str| npz.get(key).unwrap().data.clone();
        let [fx, fy, cx, cy] = data("camera")[..] else { panic!("camera") };
        let [r, g, b] = data("background")[..] else { panic!("background") };
        let scalar = |key: &str| npz.scalar(key).unwrap();
        let (width, height) = (scalar("width") as u32, scalar("height") as u32);
        let params = SoftRasterizeParams {
            sigma: scalar("sigma"),
            gamma: scalar("gamma"),
            eps: scalar("eps"),
            near: scalar("near"),
            far: scalar("far"),
            // The golden values leave nothing out.
            cut: 1e6,
            background: [r, g, b],
            ..SoftRasterizeParams::new(width, height)
        };
        let indices: Vec<u32> = data("faces").iter().map(|&i| i as u32).collect();
        let scene = Self {
            params,
            camera: Camera::pinhole(width, height, [fx, fy, cx, cy]),
            view: data("vertices"),
            faces: indices.as_chunks().0.to_vec(),
            colours: data("face_colours"),
            grad_rgb: data("upstream_rgb"),
            grad_alpha: data("upstream_alpha"),
        };
        let results = Results {
            rgb: data("rgb"),
            alpha: data("alpha"),
            grad_view: data("grad_vertices"),
            grad_colours: data("grad_face_colours"),
        };
        (scene, results)
    }

    fn small(view: &[f64], faces: &[[u32; 3]]) -> Self {
        let (width, height) = (12, 10);
        let camera = Camera::pinhole(width, height, [11.0, 12.0, 6.3, 4.8]);
        Self {
            params: SoftRasterizeParams {
                sigma: 0.02,
                gamma: 0.3,
                near: 0.5,
                far: 4.0,
                background: [0.2, 0.5, 0.3],
                ..SoftRasterizeParams::new(width, height)
            },
            camera: camera.clone(),
            view: view.to_vec(),
            faces: faces.to_vec(),
            colours: noise(faces.len() * 3, 1).iter().map(|x| x.abs()).collect(),
            grad_rgb: noise(camera.n_pixels() * 3, 2),
            grad_alpha: noise(camera.n_pixels(), 3),
        }
    }

    fn cpu(&self) -> Results {
        let Self { params, camera, view, faces, colours, grad_rgb, grad_alpha } = self;
        let image = cpu::forward(params, camera, view, faces, colours);
        let (mut grad_view, mut grad_colours) = (vec![0.0; view.len()], vec![0.0; colours.len()]);
        cpu::backward(
            params,
            camera,
            view,
            faces,
            colours,
            &image,
            grad_rgb,
            grad_alpha,
            &mut grad_view,
            &mut grad_colours,
        );
        Results { rgb: image.rgb, alpha: image.alpha, grad_view, grad_colours }
    }

    fn loss(&self, view: &[f64], colours: &[f64]) -> f64 {
        let image = cpu::forward(&self.params, &self.camera, view, &self.faces, colours);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        dot(&image.rgb, &self.grad_rgb) + dot(&image.alpha, &self.grad_alpha)
    }

    fn gpu(&self, gpu: &Gpu, list_capacity: usize) -> Results {
        self.gpu_over(gpu, list_capacity, None)
    }

    fn corners(&self, gpu: &Gpu) -> Arc<Corners> {
        Arc::new(Corners::new(gpu, &self.faces, &Topology::new(self.view.len() / 3, &self.faces)))
    }

    /// With a surface: the colours, and the gradients through them.
    fn gpu_over(&self, gpu: &Gpu, list_capacity: usize, surface: Option<&Buffer<f32>>) -> Results {
        let n = self.camera.n_pixels();
        let corners = self.corners(gpu);
        // Room for more than the image, so that nothing depends on the buffers' length.
        let op = SoftRasterizer::new(gpu, &corners, n + 7, list_capacity);
        let (view, colours) = (gpu.upload("view", &f32s(&self.view)), gpu.upload("colours", &f32s(&self.colours)));
        let (grad_rgb, grad_alpha) =
            (gpu.upload("grad_rgb", &f32s(&self.grad_rgb)), gpu.upload("grad_alpha", &f32s(&self.grad_alpha)));
        let (grad_view, grad_colours) =
            (gpu.zeros("grad_view", self.view.len()), gpu.zeros("grad_colours", self.colours.len()));
        // Twice: the second image must not see the first one's lists.
        for _ in 0..2 {
            let mut recorder = gpu.recorder("soft_rasterize/test");
            recorder.clear(&grad_view);
            recorder.clear(&grad_colours);
            op.forward(&mut recorder, &self.params, &self.camera, &view, &colours, surface);
            op.backward(
                &mut recorder,
                &self.params,
                &self.camera,
                &colours,
                &grad_rgb,
                surface.is_none().then_some(&grad_alpha),
                &grad_view,
                &grad_colours,
            );
            recorder.submit().unwrap();
        }
        Results {
            rgb: f64s(&gpu.read(&op.rgb).unwrap()[..n * 3]),
            alpha: f64s(&gpu.read(&op.alpha).unwrap()[..n]),
            grad_view: f64s(&gpu.read(&grad_view).unwrap()),
            grad_colours: f64s(&gpu.read(&grad_colours).unwrap()),
        }
    }

    /// Central differences of the twin, with respect to vertices and colours.
    #[track_caller]
    fn check_gradients(&self) {
        let ours = self.cpu();
        assert!(ours.grad_view.iter().any(|g| g.abs() > 1e-3), "nothing moves this scene");
        assert_gradient("view", &self.view, &ours.grad_view, |view| self.loss(view, &self.colours));
        assert_gradient("colours", &self.colours, &ours.grad_colours, |colours| self.loss(&self.view, colours));
    }
}

impl Results {
    #[track_caller]
    fn assert_close(&self, want: &Self, value: f64, gradient: f64) {
        assert_close("rgb", &self.rgb, &want.rgb, value);
        assert_close("alpha", &self.alpha, &want.alpha, value);
        assert_close("grad_view", &self.grad_view, &want.grad_view, gradient);
        assert_close("grad_face_colours", &self.grad_colours, &want.grad_colours, gradient);
    }
}

#[test]
fn cpu_matches_golden() {
    for name in ["softras_wide.npz", "softras_paper.npz"] {
        let (scene, want) = Scene::golden(name);
        scene.cpu().assert_close(&want, 1e-9, 1e-8);
    }
}

#[test]
fn gpu_matches_golden() {
    let Some(gpu) = gpu("soft_rasterize::gpu_matches_golden") else { return };
    for name in ["softras_wide.npz", "softras_paper.npz"] {
        let (scene, want) = Scene::golden(name);
        scene.gpu(&gpu, 1 << 16).assert_close(&want, VALUE, GRADIENT);
    }
}

#[test]
fn lists_that_do_not_fit_cost_time_and_no_correctness() {
    let Some(gpu) = gpu("soft_rasterize::lists_that_do_not_fit_cost_time_and_no_correctness") else { return };
    let (scene, want) = Scene::golden("softras_wide.npz");
    for capacity in [1, 100] {
        scene.gpu(&gpu, capacity).assert_close(&want, VALUE, GRADIENT);
    }
}

const TRIANGLE: [f64; 9] = [-0.31, -0.22, 1.1, 0.4, -0.17, 1.4, 0.05, 0.33, 1.9];

#[test]
fn gradient_of_one_face() {
    Scene::small(&TRIANGLE, &[[0, 1, 2]]).check_gradients();
}

#[test]
fn gradient_of_a_back_face() {
    Scene::small(&TRIANGLE, &[[0, 2, 1]]).check_gradients();
}

#[test]
fn gradient_where_two_faces_share_an_edge() {
    let mut view = TRIANGLE.to_vec();
    view.extend([-0.5, 0.42, 1.2]);
    Scene::small(&view, &[[0, 1, 2], [0, 2, 3]]).check_gradients();
}

#[test]
fn gradient_of_a_face_behind_another() {
    let mut view = TRIANGLE.to_vec();
    view.extend(TRIANGLE.iter().enumerate().map(|(i, x)| if i % 3 == 2 { x + 0.6 } else { x * 1.7 - 0.1 }));
    Scene::small(&view, &[[0, 1, 2], [3, 4, 5]]).check_gradients();
}

#[test]
fn gradient_of_a_face_that_reaches_over_the_border_of_the_image() {
    Scene::small(&TRIANGLE.map(|x| x * 1.9), &[[0, 1, 2]]).check_gradients();
}

#[test]
fn faces_outside_the_depth_range_or_without_area_are_not_drawn() {
    let beyond = TRIANGLE.map(|x| x * 4.0);
    let flat = [-0.3, 0.0, 1.0, 0.0, 0.0, 1.0, 0.3, 0.0, 1.0];
    let behind = [-0.3, -0.2, 1.0, 0.3, -0.2, 1.0, 0.0, 0.2, -1.0];
    for view in [beyond, flat, behind] {
        let scene = Scene::small(&view, &[[0, 1, 2]]);
        let nothing = |r: Results, what: &str| {
            assert!(r.alpha.iter().all(|&a| a == 0.0), "{what}: alpha");
            assert!(r.grad_view.iter().chain(&r.grad_colours).all(|&g| g == 0.0), "{what}: gradients");
        };
        nothing(scene.cpu(), "cpu");
        if let Some(gpu) = gpu("soft_rasterize::faces_outside_the_depth_range_or_without_area_are_not_drawn") {
            nothing(scene.gpu(&gpu, 1 << 10), "gpu");
        }
    }
}

/// A body-like scene of about `2·n·n` faces.
fn bumpy(n: usize, width: u32, height: u32) -> Scene {
    let (view, faces) = bumpy_surface(n);
    let focal = 2.0 * f64::from(height);
    let centre = [f64::from(width) / 2.0 + 1.3, f64::from(height) / 2.0 - 0.4];
    let camera = Camera::pinhole(width, height, [focal, focal, centre[0], centre[1]]);
    Scene {
        params: SoftRasterizeParams {
            sigma: 1e-4,
            gamma: 1e-3,
            near: 1.0,
            far: 5.0,
            background: [1.0, 1.0, 0.5],
            ..SoftRasterizeParams::new(width, height)
        },
        camera: camera.clone(),
        view,
        colours: noise(faces.len() * 3, 4).iter().map(|x| x.abs()).collect(),
        faces,
        grad_rgb: noise(camera.n_pixels() * 3, 5),
        grad_alpha: noise(camera.n_pixels(), 6),
    }
}

#[test]
fn gpu_matches_cpu_on_a_body_like_surface() {
    let Some(gpu) = gpu("soft_rasterize::gpu_matches_cpu_on_a_body_like_surface") else { return };
    let scene = bumpy(24, 61, 75);
    // Some thousand fragments sit on a discontinuity of f32 and f64: which edge is nearest, which face just counts.
    scene.gpu(&gpu, 1 << 18).assert_close(&scene.cpu(), 3e-4, 5e-3);
}

/// Small pictures of many faces: lists of all lengths up to the whole mesh, in the order of the faces whatever the timing.
#[test]
fn every_run_gives_the_same_bits() {
    let Some(gpu) = gpu("soft_rasterize::every_run_gives_the_same_bits") else { return };
    for (n, side) in [(24, 40), (40, 12), (56, 4)] {
        let mut scene = bumpy(n, side, side);
        scene.params.sigma = 2e-3;
        let first = scene.gpu(&gpu, 1 << 18);
        let wanted = scene.cpu();
        assert_close("rgb", &first.rgb, &wanted.rgb, 3e-4);
        assert_close("alpha", &first.alpha, &wanted.alpha, 3e-4);
        for _ in 0..8 {
            let again = scene.gpu(&gpu, 1 << 18);
            assert!(first.rgb == again.rgb && first.alpha == again.alpha, "{side}²: the image");
            assert!(
                first.grad_view == again.grad_view && first.grad_colours == again.grad_colours,
                "{side}²: gradients"
            );
        }
    }
}

#[test]
fn hidden_faces_have_no_share_in_the_colours() {
    let Some(gpu) = gpu("soft_rasterize::hidden_faces_have_no_share_in_the_colours") else { return };
    let mut scene = bumpy(24, 61, 75);
    scene.grad_alpha.fill(0.0);
    let hard = HardRasterizer::new(&gpu, &scene.corners(&gpu), scene.camera.n_pixels(), HardRasterizeConfig::default());
    let view = gpu.upload("view", &f32s(&scene.view));
    let mut recorder = gpu.recorder("soft_rasterize/test");
    hard.forward(&mut recorder, &scene.camera, &view);
    recorder.submit().unwrap();
    let want = scene.cpu();
    let ours = Results { alpha: want.alpha.clone(), ..scene.gpu_over(&gpu, 1 << 18, Some(&hard.zbuf)) };
    ours.assert_close(&want, 3e-4, 5e-3);
    // The far half of the ball is in few lists: without it they are about half as long.
    let op = SoftRasterizer::new(&gpu, &scene.corners(&gpu), scene.camera.n_pixels(), 1 << 18);
    let colours = gpu.upload("colours", &f32s(&scene.colours));
    let length = |surface: Option<&Buffer<f32>>| {
        let mut recorder = gpu.recorder("soft_rasterize/test");
        op.forward(&mut recorder, &scene.params, &scene.camera, &view, &colours, surface);
        recorder.submit().unwrap();
        op.list_length(&gpu, &scene.camera).unwrap().0
    };
    let (all, seen) = (length(None), length(Some(&hard.zbuf)));
    assert!(4 * seen < 3 * all, "{seen} of {all} entries are left");
}

#[test]
fn the_host_makes_room_for_what_shaders_index_by() {
    assert_eq!(super::gpu::SIZES, crate::gpu::shader::shared_constant("shared/soft_face", "SIZES"));
}
