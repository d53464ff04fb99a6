use super::{Anchor, AnchorConfig, cpu};
use crate::ops::testing::{assert_close, assert_gradient, gpu};

fn config() -> AnchorConfig {
    AnchorConfig { scales: vec![f64::INFINITY, 0.3, 0.1, 0.7] }
}

fn numbers(seed: usize) -> Vec<f64> {
    (0..28).map(|i| ((i * 37 + seed) % 11) as f64 * 0.05).collect()
}

#[test]
fn the_gradient_is_that_of_the_penalty() {
    let (values, start) = (numbers(0), numbers(5));
    let mut grads = vec![0.0; values.len()];
    cpu::backward(&config(), &values, &start, 1.0, &mut grads);
    assert_gradient("values", &values, &grads, |x| cpu::forward(&config(), x, &start));
}

#[test]
fn each_number_has_its_scale() {
    let start = numbers(0);
    let mut values = start.clone();
    values[8] += 1.0;
    assert_eq!(cpu::forward(&config(), &values, &start), 0.0);
    values[9] += 0.3;
    values[6] -= 0.2;
    assert!((cpu::forward(&config(), &values, &start) - 5.0).abs() < 1e-9);
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("anchor::gpu_matches_the_twin") else { return };
    let [values, start] = [numbers(0), numbers(5)].map(|v| v.iter().map(|&x| x as f32).collect::<Vec<f32>>());
    let mut want = vec![1.0f32; values.len()];
    cpu::backward(&config(), &values, &start, 0.7, &mut want);
    let (values, grads) = (gpu.upload("values", &values), gpu.upload("grads", &vec![1.0f32; want.len()]));
    let mut recorder = gpu.recorder("anchor/test");
    Anchor::new(&gpu, &config(), &start).backward(&mut recorder, &values, 0.7, &grads);
    recorder.submit().unwrap();
    assert_close("grads", &gpu.read(&grads).unwrap(), &want, 1e-5);
}
