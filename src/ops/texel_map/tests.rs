use super::{TexelMap, cpu};
use crate::gpu::Buffer;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, gpu, points, random};

const SIDE: usize = 5;

/// Coordinates inside the map, away from the middles of texels.
fn inside(n: usize) -> Vec<f64> {
    let cell = |x: f64| {
        let position = (0.5 + 0.5 * x) * (SIDE as f64 - 1.0);
        (position.floor() + 0.1 + 0.8 * position.fract() + 0.5) / SIDE as f64
    };
    random(1, 3 * n).into_iter().map(cell).collect()
}

#[test]
fn the_middle_of_a_texel_has_its_colour() {
    let texels = random(2, 3 * SIDE * SIDE);
    for (i, j) in [(0, 0), (2, 1), (4, 4)] {
        let coord = [(i as f64 + 0.5) / SIDE as f64, (j as f64 + 0.5) / SIDE as f64, 0.3];
        let rgb = cpu::forward(&texels, SIDE, &coord);
        assert_close("rgb", &rgb, &texels[3 * (j * SIDE + i)..][..3], 1e-12);
    }
}

#[test]
fn the_border_holds_on_outside() {
    let texels = random(2, 3 * SIDE * SIDE);
    let mut grad_texels = vec![0.0; texels.len()];
    let grad = cpu::backward(&texels, SIDE, &[-0.3, 1.2, 0.0], &[1.0; 3], &mut grad_texels);
    assert_eq!(grad, [0.0; 3]);
    let corner = 3 * (SIDE - 1) * SIDE;
    assert_close("corner", &cpu::forward(&texels, SIDE, &[-0.3, 1.2, 0.0]), &texels[corner..corner + 3], 1e-12);
    assert_eq!(grad_texels[corner..corner + 3], [1.0; 3]);
}

fn gradients_of(side: usize) {
    let texels = random(2, 3 * side * side);
    let (coords, upstream) = (inside(12), random(3, 36));
    let loss = |texels: &[f64], coords: &[f64]| -> f64 {
        let rgb = points::<f64, 3>(coords).into_iter().flat_map(|c| cpu::forward(texels, side, &c));
        rgb.zip(&upstream).map(|(a, b)| a * b).sum()
    };
    let mut grad_texels = vec![0.0; texels.len()];
    let pairs = points::<f64, 3>(&coords).into_iter().zip(points::<f64, 3>(&upstream));
    let grad_coords: Vec<f64> =
        pairs.flat_map(|(c, g)| cpu::backward(&texels, side, &c, &g, &mut grad_texels)).collect();
    assert_gradient("grad_texels", &texels, &grad_texels, |x| loss(x, &coords));
    assert_gradient("grad_coords", &coords, &grad_coords, |x| loss(&texels, x));
}

#[test]
fn gradients_inside_the_map() {
    gradients_of(SIDE);
}

#[test]
fn gradients_of_a_single_texel() {
    gradients_of(1);
}

#[test]
fn gpu_matches_cpu() {
    let Some(gpu) = gpu("texel_map::gpu_matches_cpu") else { return };
    let (side, n, capacity) = (37, 3000, 3100);
    let texels = f32s(&random(4, 3 * side * side));
    // A part lies outside.
    let coords: Vec<f32> = random(5, 3 * capacity).into_iter().map(|x| (0.5 + 0.6 * x) as f32).collect();
    let upstream = f32s(&random(6, 3 * capacity));
    let op = TexelMap::new(&gpu, side, &texels, capacity);
    let (coords_buffer, grad_rgb) = (gpu.upload("coords", &coords), gpu.upload("grad_rgb", &upstream));
    let count = gpu.upload("count", &[n as u32]);
    let grad_coords: Buffer<f32> = gpu.upload("grad_coords", &vec![0.25; 3 * capacity]);
    let mut recorder = gpu.recorder("texel_map/test");
    op.forward(&mut recorder, &coords_buffer, &count, capacity);
    op.backward(&mut recorder, &coords_buffer, &count, capacity, &grad_rgb, &grad_coords);
    recorder.submit().unwrap();

    let mut want_texels = vec![0.0f32; texels.len()];
    let (mut want_rgb, mut want_coords) = (Vec::new(), Vec::new());
    for (c, g) in points::<f32, 3>(&coords[..3 * n]).iter().zip(points::<f32, 3>(&upstream)) {
        want_rgb.extend(cpu::forward(&texels, side, c));
        want_coords.extend(cpu::backward(&texels, side, c, &g, &mut want_texels).map(|x| x + 0.25));
    }
    let rgb = gpu.read(&op.rgb).unwrap();
    assert_close("rgb", &rgb[..3 * n], &want_rgb, VALUE);
    assert!(rgb[3 * n..].iter().all(|&x| x == 0.0), "rows beyond the count were written");
    assert_close("grad_texels", &gpu.read(&op.grad_texels).unwrap(), &want_texels, GRADIENT);
    let ours = gpu.read(&grad_coords).unwrap();
    assert_close("grad_coords", &ours[..3 * n], &want_coords, GRADIENT);
    assert!(ours[3 * n..].iter().all(|&x| x == 0.25), "gradients beyond the count were written");
}
