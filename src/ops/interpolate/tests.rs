use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use super::{Interpolate, Sampling, cpu};
use crate::gpu::Buffer;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, gpu};

/// A made-up raster: about half of the pixels have a face.
struct Scene {
    pix_to_face: Vec<i32>,
    bary_coords: Vec<f64>,
    faces: Vec<u32>,
    texcoords: Vec<f64>,
}

fn scene(n_pixels: usize, n_faces: usize, n_vertices: usize) -> Scene {
    let mut rng = Pcg32::seed_from_u64(3);
    let pix_to_face: Vec<i32> =
        (0..n_pixels).map(|_| rng.random_range(-(n_faces as i32)..n_faces as i32).max(-1)).collect();
    let mut bary_coords = Vec::new();
    for &face in &pix_to_face {
        let (a, b) = (rng.random_range(0.0..0.5), rng.random_range(0.0..0.5));
        bary_coords.extend(if face < 0 { [0.0; 3] } else { [a, b, 1.0 - a - b] });
    }
    Scene {
        pix_to_face,
        bary_coords,
        faces: (0..3 * n_faces).map(|_| rng.random_range(0..n_vertices as u32)).collect(),
        texcoords: (0..3 * n_vertices).map(|_| rng.random_range(-0.1..1.1)).collect(),
    }
}

#[test]
fn gradients_at_covered_pixels() {
    let s = scene(40, 5, 7);
    let upstream = |k: usize| (k as f64 * 0.7).sin();
    let list = cpu::forward(&s.pix_to_face, &s.bary_coords, &s.faces, &s.texcoords, Sampling::ALL);
    assert!(list.pixel_index.len() > 5 && list.pixel_index.len() < 35);
    let grad_coords: Vec<f64> = (0..list.coords.len()).map(upstream).collect();
    let loss = |bary: &[f64], texcoords: &[f64]| -> f64 {
        let list = cpu::forward(&s.pix_to_face, bary, &s.faces, texcoords, Sampling::ALL);
        list.coords.iter().enumerate().map(|(k, x)| x * upstream(k)).sum()
    };
    let mut grad_texcoords = vec![0.0; s.texcoords.len()];
    let mut grad_bary = vec![0.0; s.bary_coords.len()];
    cpu::backward(
        &list.pixel_index,
        &s.pix_to_face,
        &s.bary_coords,
        &s.faces,
        &s.texcoords,
        &grad_coords,
        &mut grad_texcoords,
        &mut grad_bary,
    );
    assert_gradient("grad_texcoords", &s.texcoords, &grad_texcoords, |x| loss(&s.bary_coords, x));
    assert_gradient("grad_bary", &s.bary_coords, &grad_bary, |x| loss(x, &s.texcoords));
}

#[test]
fn gather_is_the_derivative_of_scatter() {
    let s = scene(30, 5, 7);
    let list = cpu::forward(&s.pix_to_face, &s.bary_coords, &s.faces, &s.texcoords, Sampling::ALL);
    let grad_image: Vec<f64> = (0..90).map(|i| (i as f64).cos()).collect();
    let rgb: Vec<f64> = (0..list.coords.len()).map(|i| i as f64 * 0.01).collect();
    let grad_rgb = cpu::gather(&list.pixel_index, &grad_image);
    assert_gradient("grad_rgb", &rgb, &grad_rgb, |rgb| {
        let image = cpu::scatter(&list.pixel_index, rgb, [1.0, 0.5, 0.0], 30);
        image.iter().zip(&grad_image).map(|(a, b)| a * b).sum()
    });
}

#[test]
fn a_sample_holds_the_part_it_was_asked_for() {
    let covered = vec![0i32; 40_000];
    let bary = vec![1.0 / 3.0; 120_000];
    let list = |sampling| cpu::forward(&covered, &bary, &[0, 0, 0], &[0.0; 3], sampling).pixel_index;
    let sample = list(Sampling { rate: 0.3, seed: 5 });
    let part = sample.len() as f64 / 40_000.0;
    // Five standard deviations of a binomial count are 0.0115.
    assert!((part - 0.3).abs() < 0.0115, "{part}");
    assert_eq!(sample, list(Sampling { rate: 0.3, seed: 5 }));
    let other = list(Sampling { rate: 0.3, seed: 6 });
    let common = sample.iter().filter(|i| other.binary_search(i).is_ok()).count() as f64 / 40_000.0;
    assert!((common - 0.09).abs() < 0.008, "{common}");
    assert_eq!(list(Sampling::ALL).len(), 40_000);
}

fn f32s(x: &[f64]) -> Vec<f32> {
    x.iter().map(|&x| x as f32).collect()
}

fn gpu_matches_cpu(test: &str, n_pixels: usize, sampling: Sampling) {
    let Some(gpu) = gpu(test) else { return };
    let s = scene(n_pixels, 300, 200);
    let (bary, texcoords) = (f32s(&s.bary_coords), f32s(&s.texcoords));
    let list = cpu::forward(&s.pix_to_face, &bary, &s.faces, &texcoords, sampling);
    let n = list.pixel_index.len();
    // Larger buffers than the image, as in a fit whose crops differ in size.
    let capacity = n_pixels + 100;
    let grad_image: Vec<f32> = (0..3 * n_pixels).map(|i| (i as f32 * 0.7).sin()).collect();
    let op = Interpolate::new(&gpu, capacity, capacity, texcoords.len() / 3);
    let [bary_buffer, texcoords_buffer, grad_image_buffer] =
        [("bary", &bary), ("texcoords", &texcoords), ("grad_image", &grad_image)].map(|(l, x)| gpu.upload(l, x));
    let pix_to_face = gpu.upload("pix_to_face", &s.pix_to_face);
    let faces = gpu.upload("faces", &s.faces);
    let image: Buffer<f32> = gpu.zeros("image", 3 * n_pixels);
    let grad_rgb: Buffer<f32> = gpu.zeros("grad_rgb", 3 * capacity);
    let grad_texcoords = gpu.upload("grad_texcoords", &vec![0.5f32; texcoords.len()]);
    let grad_bary: Buffer<f32> = gpu.zeros("grad_bary", 3 * n_pixels);
    let mut recorder = gpu.recorder("interpolate/test");
    op.forward(&mut recorder, n_pixels, &pix_to_face, &bary_buffer, &faces, &texcoords_buffer, sampling);
    op.scatter(&mut recorder, n_pixels, &op.coords, [0.1, 0.2, 0.3], &image);
    op.gather(&mut recorder, n_pixels, &grad_image_buffer, &grad_rgb);
    op.backward(&mut recorder, n_pixels, &pix_to_face, &bary_buffer, &faces, &grad_rgb, &grad_texcoords);
    op.backward_bary(&mut recorder, n_pixels, &pix_to_face, &faces, &texcoords_buffer, &grad_rgb, &grad_bary);
    recorder.submit().unwrap();

    assert_eq!(gpu.read(&op.count).unwrap(), [n as u32]);
    assert_eq!(gpu.read(&op.pixel_index).unwrap()[..n], list.pixel_index);
    assert_close("coords", &gpu.read(&op.coords).unwrap()[..3 * n], &list.coords, VALUE);
    let want_image = cpu::scatter(&list.pixel_index, &list.coords, [0.1, 0.2, 0.3], n_pixels);
    assert_close("image", &gpu.read(&image).unwrap(), &want_image, VALUE);
    let want_rgb = cpu::gather(&list.pixel_index, &grad_image);
    let ours = gpu.read(&grad_rgb).unwrap();
    assert_eq!(ours[..3 * n], want_rgb);
    assert!(ours[3 * n..].iter().all(|&x| x == 0.0), "rows beyond the list were written");
    let mut want_texcoords = vec![0.5; texcoords.len()];
    let mut want_bary = vec![0.0; bary.len()];
    cpu::backward(
        &list.pixel_index,
        &s.pix_to_face,
        &bary,
        &s.faces,
        &texcoords,
        &want_rgb,
        &mut want_texcoords,
        &mut want_bary,
    );
    assert_close("grad_texcoords", &gpu.read(&grad_texcoords).unwrap(), &want_texcoords, GRADIENT);
    assert_close("grad_bary", &gpu.read(&grad_bary).unwrap(), &want_bary, GRADIENT);
}

#[test]
fn gpu_matches_cpu_with_all_pixels() {
    gpu_matches_cpu("interpolate::gpu_matches_cpu_with_all_pixels", 123 * 77, Sampling::ALL);
}

#[test]
fn gpu_matches_cpu_with_a_sample() {
    gpu_matches_cpu("interpolate::gpu_matches_cpu_with_a_sample", 20_000, Sampling { rate: 0.25, seed: 9 });
}

#[test]
fn the_list_ends_at_its_capacity() {
    let Some(gpu) = gpu("interpolate::the_list_ends_at_its_capacity") else { return };
    let s = scene(100, 5, 7);
    let op = Interpolate::new(&gpu, 100, 10, 0);
    let pix_to_face = gpu.upload("pix_to_face", &s.pix_to_face);
    let [bary, texcoords] =
        [("bary", &s.bary_coords), ("texcoords", &s.texcoords)].map(|(l, x)| gpu.upload(l, &f32s(x)));
    let faces = gpu.upload("faces", &s.faces);
    let image: Buffer<f32> = gpu.zeros("image", 300);
    let mut recorder = gpu.recorder("interpolate/test");
    op.forward(&mut recorder, 100, &pix_to_face, &bary, &faces, &texcoords, Sampling::ALL);
    op.scatter(&mut recorder, 100, &op.coords, [-1.0; 3], &image);
    recorder.submit().unwrap();
    let all = cpu::forward(&s.pix_to_face, &s.bary_coords, &s.faces, &s.texcoords, Sampling::ALL);
    assert_eq!(gpu.read(&op.count).unwrap(), [10]);
    assert_eq!(gpu.read(&op.pixel_index).unwrap(), all.pixel_index[..10]);
    let want = cpu::scatter(&all.pixel_index[..10], &all.coords[..30], [-1.0; 3], 100);
    assert_close("image", &gpu.read(&image).unwrap(), &want, VALUE);
}

#[test]
fn the_host_makes_room_for_what_shaders_index_by() {
    assert_eq!(super::gpu::BLOCK, crate::gpu::shader::shared_constant("shared/listed", "BLOCK"));
}
