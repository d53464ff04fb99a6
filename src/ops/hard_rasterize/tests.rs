use std::sync::Arc;

use super::{HardRasterizeConfig, HardRasterizer, cpu};
use crate::camera::Camera;
use crate::gpu::{Buffer, Gpu};
use crate::ops::Corners;
use crate::ops::testing::{assert_close, assert_gradient, bumpy_surface, f32s, gpu, noise};
use crate::ops::topology::Topology;

const CONFIG: HardRasterizeConfig = HardRasterizeConfig { near: 0.05, cull_back: false };
const CULLED: HardRasterizeConfig = HardRasterizeConfig { cull_back: true, ..CONFIG };
const CAMERA: Camera = Camera::pinhole(12, 10, [11.0, 12.0, 6.3, 4.8]);
const TRIANGLE: [f64; 9] = [-0.31, -0.22, 1.1, 0.4, -0.17, 1.4, 0.05, 0.33, 1.9];

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The device's results for a mesh, with the gradients for the given upstream ones.
struct Device {
    op: HardRasterizer,
    corners: Arc<Corners>,
    view: Buffer<f32>,
}

impl Device {
    fn new(gpu: &Gpu, config: HardRasterizeConfig, camera: &Camera, view: &[f64], faces: &[[u32; 3]]) -> Self {
        let corners = Arc::new(Corners::new(gpu, faces, &Topology::new(view.len() / 3, faces)));
        let op = HardRasterizer::new(gpu, &corners, camera.n_pixels() + 5, config);
        let view = gpu.upload("view", &f32s(view));
        // Twice: the second image must not see what the first one left.
        for _ in 0..2 {
            let mut recorder = gpu.recorder("hard_rasterize/test");
            op.forward(&mut recorder, camera, &view);
            recorder.submit().unwrap();
        }
        Self { op, corners, view }
    }

    fn pix_to_face(&self, gpu: &Gpu, camera: &Camera) -> Vec<i32> {
        gpu.read(&self.op.pix_to_face).unwrap()[..camera.n_pixels()].to_vec()
    }
}

#[test]
fn barycentric_coordinates_lead_back_to_the_ray() {
    let image = cpu::forward(&CONFIG, &CAMERA, &TRIANGLE, &[[0, 1, 2]]);
    let covered: Vec<usize> = (0..CAMERA.n_pixels()).filter(|&p| image.pix_to_face[p] == 0).collect();
    assert!(covered.len() > 10);
    for pixel in covered {
        let point: Vec<f64> =
            (0..3).map(|c| (0..3).map(|k| image.bary_coords[pixel * 3 + k] * TRIANGLE[k * 3 + c]).sum()).collect();
        let [u, v] = CAMERA.project([point[0], point[1], point[2]]);
        assert!((u - (pixel % 12) as f64 - 0.5).abs() < 1e-9 && (v - (pixel / 12) as f64 - 0.5).abs() < 1e-9);
        assert!((image.zbuf[pixel] - point[2]).abs() < 1e-12);
    }
}

/// Gradients of one scene with fixed ownership, against central differences.
#[track_caller]
fn check_gradient(view: &[f64], faces: &[[u32; 3]], with_depth: bool) {
    let n = CAMERA.n_pixels();
    let (grad_bary, grad_zbuf) = (noise(n * 3, 1), noise(n, 2));
    let grad_zbuf = with_depth.then_some(&grad_zbuf[..]);
    let image = cpu::forward(&CONFIG, &CAMERA, view, faces);
    let mut grad_view = vec![0.0; view.len()];
    cpu::backward(&CAMERA, view, faces, &image.pix_to_face, &grad_bary, grad_zbuf, &mut grad_view);
    assert!(grad_view.iter().any(|g| g.abs() > 1e-3), "nothing moves this scene");
    assert_gradient("view", view, &grad_view, |view| {
        let moved = cpu::forward(&CONFIG, &CAMERA, view, faces);
        assert_eq!(moved.pix_to_face, image.pix_to_face, "the scene stands on an edge");
        let covered = |p: &usize| image.pix_to_face[*p] >= 0;
        dot(&moved.bary_coords, &grad_bary)
            + grad_zbuf.map_or(0.0, |g| (0..n).filter(covered).map(|p| moved.zbuf[p] * g[p]).sum())
    });
}

#[test]
fn gradient_of_barycentric_coordinates() {
    check_gradient(&TRIANGLE, &[[0, 1, 2]], false);
}

#[test]
fn gradient_of_depth_of_a_back_face() {
    check_gradient(&TRIANGLE, &[[0, 2, 1]], true);
}

#[test]
fn gradient_where_faces_share_an_edge_and_reach_over_the_border() {
    let mut view = TRIANGLE.to_vec();
    view.extend([-2.5, 0.42, 1.2]);
    check_gradient(&view, &[[0, 1, 2], [0, 2, 3]], true);
}

#[test]
fn faces_before_the_near_plane_are_skipped_and_back_faces_when_asked() {
    let mut close = TRIANGLE;
    close[2] = 0.04;
    let drawn = |config: HardRasterizeConfig, view: &[f64], faces: &[[u32; 3]]| {
        let on_cpu = cpu::forward(&config, &CAMERA, view, faces).alpha.contains(&1.0);
        if let Some(gpu) = gpu("hard_rasterize::faces_before_the_near_plane_are_skipped_and_back_faces_when_asked") {
            let device = Device::new(&gpu, config, &CAMERA, view, faces);
            assert_eq!(device.pix_to_face(&gpu, &CAMERA).contains(&0), on_cpu);
        }
        on_cpu
    };
    // Seen along +z with y down, 0 2 1 runs counter-clockwise for somebody who looks from the front.
    assert!(!drawn(CONFIG, &close, &[[0, 1, 2]]));
    assert!(drawn(CONFIG, &TRIANGLE, &[[0, 1, 2]]) && drawn(CONFIG, &TRIANGLE, &[[0, 2, 1]]));
    assert!(!drawn(CULLED, &TRIANGLE, &[[0, 1, 2]]) && drawn(CULLED, &TRIANGLE, &[[0, 2, 1]]));
}

#[test]
fn of_faces_at_one_depth_the_first_owns_the_pixel() {
    let Some(gpu) = gpu("hard_rasterize::of_faces_at_one_depth_the_first_owns_the_pixel") else { return };
    let faces = [[1, 2, 0], [0, 1, 2], [0, 2, 1]];
    let device = Device::new(&gpu, CONFIG, &CAMERA, &TRIANGLE, &faces);
    let owners = device.pix_to_face(&gpu, &CAMERA);
    assert!(owners.contains(&0) && owners.iter().all(|&f| f <= 0), "{owners:?}");
}

#[test]
fn gpu_matches_cpu_on_a_body_like_surface() {
    let Some(gpu) = gpu("hard_rasterize::gpu_matches_cpu_on_a_body_like_surface") else { return };
    let camera = Camera::pinhole(61, 75, [150.0, 150.0, 31.8, 37.1]);
    let (view, faces) = bumpy_surface(40);
    let want = cpu::forward(&CONFIG, &camera, &view, &faces);
    let device = Device::new(&gpu, CONFIG, &camera, &view, &faces);
    let owners = device.pix_to_face(&gpu, &camera);
    let differ = owners.iter().zip(&want.pix_to_face).filter(|(a, b)| a != b).count();
    assert!(differ <= 2, "{differ} pixels have another owner");
    assert!(want.alpha.iter().sum::<f64>() > 1000.0);

    // Over the device's own owners the rest is smooth.
    let n = camera.n_pixels();
    let (bary, zbuf) = (gpu.read(&device.op.bary_coords).unwrap(), gpu.read(&device.op.zbuf).unwrap());
    let alpha = gpu.read(&device.op.alpha).unwrap();
    for p in 0..n {
        if owners[p] == want.pix_to_face[p] {
            assert!((zbuf[p] as f64 - want.zbuf[p]).abs() < 1e-4, "zbuf[{p}]");
            assert_eq!(alpha[p] as f64, want.alpha[p], "alpha[{p}]");
            let off = (0..3).map(|k| (bary[p * 3 + k] as f64 - want.bary_coords[p * 3 + k]).abs()).fold(0.0, f64::max);
            assert!(off < 2e-2, "bary_coords[{p}] off by {off}");
        }
    }

    let (grad_bary, grad_zbuf) = (noise(n * 3, 1), noise(n, 2));
    let grad_view = gpu.zeros::<f32>("grad_view", view.len());
    let mut recorder = gpu.recorder("hard_rasterize/test");
    let (gb, gz) = (gpu.upload("grad_bary", &f32s(&grad_bary)), gpu.upload("grad_zbuf", &f32s(&grad_zbuf)));
    device.op.backward(&mut recorder, &camera, &device.view, &gb, Some(&gz), &grad_view);
    recorder.submit().unwrap();
    let mut want = vec![0.0; view.len()];
    cpu::backward(&camera, &view, &faces, &owners, &grad_bary, Some(&grad_zbuf), &mut want);
    assert_close("grad_view", &gpu.read(&grad_view).unwrap(), &want, 2e-3);

    let grad_view = gpu.zeros::<f32>("grad_view", view.len());
    let mut recorder = gpu.recorder("hard_rasterize/test");
    device.op.backward(&mut recorder, &camera, &device.view, &gb, None, &grad_view);
    recorder.submit().unwrap();
    want.fill(0.0);
    cpu::backward(&camera, &view, &faces, &owners, &grad_bary, None, &mut want);
    assert_close("grad_view", &gpu.read(&grad_view).unwrap(), &want, 2e-3);
}

#[test]
fn flat_shading_and_its_gradient_match_cpu() {
    let Some(gpu) = gpu("hard_rasterize::flat_shading_and_its_gradient_match_cpu") else { return };
    let camera = Camera::pinhole(61, 75, [150.0, 150.0, 31.8, 37.1]);
    let (view, faces) = bumpy_surface(24);
    let device = Device::new(&gpu, CONFIG, &camera, &view, &faces);
    let owners = device.pix_to_face(&gpu, &camera);
    let (colours, grad_image) = (noise(faces.len() * 3, 3), noise(camera.n_pixels() * 3, 4));
    let on_gpu = [gpu.upload("colours", &f32s(&colours)), gpu.upload("grad_image", &f32s(&grad_image))];
    let image = gpu.zeros::<f32>("image", camera.n_pixels() * 3);
    let grad_colours = gpu.upload("grad_colours", &vec![1.0f32; colours.len()]);
    let mut recorder = gpu.recorder("hard_rasterize/test");
    device.op.shade(&mut recorder, &camera, &on_gpu[0], [0.5, 0.25, 0.0], &image);
    device.op.shade_backward(&mut recorder, &camera, &device.view, &on_gpu[1], &grad_colours);
    recorder.submit().unwrap();
    assert_close("image", &gpu.read(&image).unwrap(), &cpu::shade(&owners, &colours, [0.5, 0.25, 0.0]), 1e-6);
    let mut want = vec![1.0; colours.len()];
    cpu::shade_backward(&owners, &grad_image, &mut want);
    assert_close("grad_face_colours", &gpu.read(&grad_colours).unwrap(), &want, 1e-5);
    assert_eq!(device.corners.n_faces(), faces.len());
}

/// A cube of twelve faces around which the whole image lies: large boxes, no seams.
#[test]
fn large_faces_leave_no_holes() {
    let Some(gpu) = gpu("hard_rasterize::large_faces_leave_no_holes") else { return };
    let camera = Camera::pinhole(90, 70, [60.0, 60.0, 45.0, 35.0]);
    let view: Vec<f64> = (0..8)
        .flat_map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|b| b as f64 * 2.0 - 1.0))
        .enumerate()
        .map(|(i, x)| if i % 3 == 2 { x + 2.5 } else { x * 1.6 })
        .collect();
    let sides = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let faces: Vec<[u32; 3]> = sides.iter().flat_map(|s| [[s[0], s[1], s[2]], [s[0], s[2], s[3]]]).collect();
    let device = Device::new(&gpu, CONFIG, &camera, &view, &faces);
    let owners = device.pix_to_face(&gpu, &camera);
    assert!(owners.iter().all(|&f| f == 0 || f == 1), "the near side covers the image");
}

#[test]
fn the_faces_alone_are_those_of_the_whole_image() {
    let Some(gpu) = gpu("hard_rasterize::the_faces_alone_are_those_of_the_whole_image") else { return };
    let (view, faces) = bumpy_surface(24);
    let camera = Camera::pinhole(64, 48, [60.0, 60.0, 31.0, 23.0]);
    let device = Device::new(&gpu, CONFIG, &camera, &view, &faces);
    let want = device.pix_to_face(&gpu, &camera);
    assert!(want.iter().any(|&f| f >= 0) && want.contains(&-1), "face and background");
    for _ in 0..2 {
        gpu.write(&device.op.pix_to_face, 0, &vec![7; want.len()]);
        let mut recorder = gpu.recorder("hard_rasterize/test");
        device.op.forward_faces(&mut recorder, &camera, &device.view);
        recorder.submit().unwrap();
        assert_eq!(device.pix_to_face(&gpu, &camera), want);
    }
}

/// The faces that the pixels show of a mesh of one face, in two passes and, where the device can, in one.
fn drawn_alone(gpu: &Gpu, config: HardRasterizeConfig, camera: &Camera, face: [u32; 3], view: &[f32]) -> [Vec<i32>; 2] {
    let corners = Arc::new(Corners::new(gpu, &[face], &Topology::new(3, &[face])));
    let view = gpu.upload("view", view);
    [false, gpu.info().wide_atomics].map(|wide| {
        let op = HardRasterizer::with_passes(gpu, &corners, camera.n_pixels(), config, wide);
        let mut recorder = gpu.recorder("hard_rasterize/test");
        op.forward_faces(&mut recorder, camera, &view);
        recorder.submit().unwrap();
        gpu.read(&op.pix_to_face).unwrap()[..camera.n_pixels()].to_vec()
    })
}

/// Triangles of all shapes, one at a time: slivers, level edges, edges through pixel centres, corners far outside.
#[test]
fn no_triangle_loses_a_pixel() {
    let Some(gpu) = gpu("hard_rasterize::no_triangle_loses_a_pixel") else { return };
    let camera = Camera::pinhole(64, 48, [64.0, 64.0, 32.0, 24.0]);
    let at = |[x, y]: [f64; 2], z: f64| [(x - 32.0) / 64.0 * z, (y - 24.0) / 64.0 * z, z];
    let random = crate::ops::testing::random(5, 7 * 240);
    let mut triangles: Vec<[[f64; 2]; 3]> = Vec::new();
    for (k, r) in random.chunks_exact(7).enumerate() {
        let [width, height] = [[60.0, 40.0], [60.0, 0.4], [0.4, 40.0], [4.0, 3.0], [9000.0, 7000.0]][k % 5];
        let middle = [32.0 + 30.0 * r[0], 24.0 + 22.0 * r[1]];
        triangles.push([1, 3, 5].map(|i| [middle[0] + width * r[i], middle[1] + height * r[i + 1]]));
    }
    // Level edges: between the rows' centres, through them, and a hair off them.
    for y in [10.25, 10.5, 10.500001, 10.499999, 11.0] {
        triangles.push([[3.2, y], [60.1, y], [20.7, y + 7.3]]);
        triangles.push([[3.2, y], [60.1, y + 1e-5], [20.7, y - 5.1]]);
    }
    let orders = [[0, 1, 2], [0, 2, 1], [1, 2, 0], [1, 0, 2], [2, 0, 1], [2, 1, 0]];
    let mut covered = [0; 2];
    for (k, triangle) in triangles.iter().enumerate() {
        let view: Vec<f64> = triangle.iter().zip([1.0, 1.3, 2.1]).flat_map(|(&p, z)| at(p, z)).collect();
        for (config, face) in [(CONFIG, [0, 1, 2]), (CULLED, orders[k % 6])] {
            let want = cpu::forward(&config, &camera, &view, &[face]);
            for found in drawn_alone(&gpu, config, &camera, face, &f32s(&view)) {
                let differ = (0..camera.n_pixels()).filter(|&p| found[p] != want.pix_to_face[p]);
                // Centres on an edge may fall to either side; of the triangles above those with a level edge have a row of them.
                let centre = |p: usize| [(p % 64) as f64 + 0.5, (p / 64) as f64 + 0.5];
                let off: Vec<_> = differ.filter(|&p| !on_an_edge(triangle, centre(p))).collect();
                assert!(off.is_empty(), "triangle {k} {triangle:?}, {face:?}: pixels {off:?}");
            }
            covered[usize::from(config.cull_back)] += want.pix_to_face.iter().filter(|&&f| f == 0).count();
        }
    }
    assert!(covered[0] > 20_000 && covered[1] > 5_000, "{covered:?}");
}

/// Nothing is drawn of what is not finite, and nothing hangs.
#[test]
fn corners_that_are_not_finite_end() {
    let Some(gpu) = gpu("hard_rasterize::corners_that_are_not_finite_end") else { return };
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e37, -1e37] {
        for at in 0..9 {
            let mut view = f32s(&TRIANGLE);
            view[at] = bad;
            for found in drawn_alone(&gpu, CONFIG, &CAMERA, [0, 1, 2], &view) {
                assert!(found.iter().all(|f| (-1..1).contains(f)), "{bad} at {at}: {found:?}");
            }
        }
    }
}

/// Whether a point lies within a thousandth of a pixel (more for far corners) of an edge's line.
fn on_an_edge(triangle: &[[f64; 2]; 3], p: [f64; 2]) -> bool {
    (0..3).any(|k| {
        let [a, b] = [triangle[k], triangle[(k + 1) % 3]];
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].hypot(along[1]);
        let away = along[0] * (p[1] - a[1]) - along[1] * (p[0] - a[0]);
        (away / length).abs() < 1e-3 + 1e-6 * length
    })
}

/// Devices without 64-bit atomics take two passes.
#[test]
fn two_passes_find_the_nearest_faces_of_the_reference() {
    let Some(gpu) = gpu("hard_rasterize::two_passes_find_the_nearest_faces_of_the_reference") else { return };
    let (view, faces) = bumpy_surface(24);
    let camera = Camera::pinhole(64, 48, [60.0, 60.0, 31.0, 23.0]);
    let corners = Arc::new(Corners::new(&gpu, &faces, &Topology::new(view.len() / 3, &faces)));
    let op = HardRasterizer::with_passes(&gpu, &corners, camera.n_pixels(), CONFIG, false);
    let view_buffer = gpu.upload("view", &f32s(&view));
    let reference = cpu::forward(&CONFIG, &camera, &view, &faces);
    // Twice: the second image must not see what the first one left.
    for _ in 0..2 {
        let mut recorder = gpu.recorder("hard_rasterize/test");
        op.forward(&mut recorder, &camera, &view_buffer);
        recorder.submit().unwrap();
        let found = gpu.read(&op.pix_to_face).unwrap();
        let other = found.iter().zip(&reference.pix_to_face).filter(|(a, b)| a != b).count();
        // Pixels on an edge between two faces may fall to either.
        assert!(found.iter().any(|&f| f >= 0) && other * 200 <= found.len(), "{other} of {} differ", found.len());
    }
}

/// Lists and images are those of the last image, also where it ends within four pixels and an earlier one went on.
#[test]
fn a_smaller_image_shows_nothing_of_a_larger_one_before() {
    let Some(gpu) = gpu("hard_rasterize::a_smaller_image_shows_nothing_of_a_larger_one_before") else { return };
    let (view, faces) = bumpy_surface(24);
    let large = Camera::pinhole(64, 48, [60.0, 60.0, 31.0, 23.0]);
    let small = Camera::pinhole(13, 11, [30.0, 30.0, 6.2, 5.3]);
    let used = Device::new(&gpu, CONFIG, &large, &view, &faces);
    let fresh = Device::new(&gpu, CONFIG, &small, &view, &faces);
    let n = small.n_pixels();
    let (colours, grad) = (noise(faces.len() * 3, 3), gpu.upload("grad", &f32s(&noise(n * 3, 4))));
    let colours = gpu.upload("colours", &f32s(&colours));
    let results = [&used, &fresh].map(|device| {
        let image = gpu.zeros::<f32>("image", n * 3);
        let (grad_view, grad_colours) =
            (gpu.zeros("grad_view", view.len()), gpu.zeros("grad_colours", faces.len() * 3));
        let mut recorder = gpu.recorder("hard_rasterize/test");
        device.op.forward(&mut recorder, &small, &device.view);
        device.op.shade(&mut recorder, &small, &colours, [0.0; 3], &image);
        device.op.backward(&mut recorder, &small, &device.view, &grad, None, &grad_view);
        device.op.shade_backward(&mut recorder, &small, &device.view, &grad, &grad_colours);
        recorder.submit().unwrap();
        let front = |buffer: &Buffer<f32>, len: usize| gpu.read_front(buffer, len).unwrap();
        let Device { op, .. } = device;
        let images = [front(&op.bary_coords, 3 * n), front(&op.zbuf, n), front(&op.alpha, n), front(&image, 3 * n)];
        let grads = [front(&grad_view, view.len()), front(&grad_colours, faces.len() * 3)];
        (device.pix_to_face(&gpu, &small), images, grads)
    });
    assert!(results[0].0.iter().any(|&f| f >= 0), "a face is seen");
    assert!(results[0] == results[1], "the second image is not what it is alone");
}

#[test]
fn a_point_has_the_coordinates_that_the_image_has_there() {
    let triangle = TRIANGLE.as_chunks::<3>().0.try_into().unwrap();
    let image = cpu::forward(&CONFIG, &CAMERA, &TRIANGLE, &[[0, 1, 2]]);
    for pixel in (0..CAMERA.n_pixels()).filter(|&p| image.pix_to_face[p] == 0) {
        let middle = [(pixel % 12) as f64 + 0.5, (pixel / 12) as f64 + 0.5];
        let bary = cpu::bary_at(&CAMERA, triangle, middle);
        assert_close("bary", &bary, &image.bary_coords[3 * pixel..][..3], 1e-12);
    }
}
