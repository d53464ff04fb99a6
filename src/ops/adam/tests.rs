use super::{Adam, AdamConfig, UniformAdam, cpu};
use crate::ops::testing::{VALUE, assert_close, golden, gpu};

struct Golden {
    config: AdamConfig,
    lr: f64,
    grads: Vec<f64>,
    params: Vec<f64>,
    steps: usize,
    n: usize,
}

fn load() -> Golden {
    let npz = golden("adam.npz");
    let config = AdamConfig {
        beta1: npz.scalar("beta1").unwrap(),
        beta2: npz.scalar("beta2").unwrap(),
        eps: npz.scalar("eps").unwrap(),
    };
    let grads = npz.get("grads").unwrap();
    Golden {
        config,
        lr: npz.scalar("lr").unwrap(),
        steps: grads.shape[0],
        n: grads.shape[1],
        grads: grads.data.clone(),
        params: npz.get("params").unwrap().data.clone(),
    }
}

#[test]
fn cpu_matches_golden() {
    let g = load();
    let mut params = g.params[..g.n].to_vec();
    let (mut m, mut v) = (vec![0.0; g.n], vec![0.0; g.n]);
    for t in 0..g.steps {
        cpu::step(&g.config, g.lr, t as u32 + 1, &mut params, &g.grads[t * g.n..][..g.n], &mut m, &mut v);
        assert_close("params", &params, &g.params[(t + 1) * g.n..][..g.n], 1e-12);
    }
}

#[test]
fn gpu_matches_golden() {
    let Some(gpu) = gpu("adam::gpu_matches_golden") else { return };
    let g = load();
    let f32s = |x: &[f64]| x.iter().map(|&x| x as f32).collect::<Vec<_>>();
    let params = gpu.upload("params", &f32s(&g.params[..g.n]));
    let adam = Adam::new(&gpu, "test", g.n, g.config);
    for t in 0..g.steps {
        let grads = gpu.upload("grads", &f32s(&g.grads[t * g.n..][..g.n]));
        let mut recorder = gpu.recorder("adam/test");
        adam.step(&mut recorder, &params, &grads, 0..g.n, g.lr as f32, t as u32 + 1);
        recorder.submit().unwrap();
        assert_close("params", &gpu.read(&params).unwrap(), &g.params[(t + 1) * g.n..][..g.n], VALUE);
    }
}

#[test]
fn gpu_leaves_what_lies_outside_the_range() {
    let Some(gpu) = gpu("adam::gpu_leaves_what_lies_outside_the_range") else { return };
    // One by one, by fours, by fours up to the end.
    for range in [3..5, 4..8, 4..6, 4..10] {
        let params = gpu.upload("params", &[1.0f32; 10]);
        let grads = gpu.upload("grads", &[1.0f32; 10]);
        let adam = Adam::new(&gpu, "test", 10, AdamConfig::default());
        let mut recorder = gpu.recorder("adam/test");
        adam.step(&mut recorder, &params, &grads, range.clone(), 0.1, 1);
        recorder.submit().unwrap();
        let after = gpu.read(&params).unwrap();
        for (i, x) in after.iter().enumerate() {
            let want = if range.contains(&i) { 0.9 } else { 1.0 };
            assert!((x - want).abs() < 1e-6, "{range:?}: params[{i}] = {x}, expected {want}");
        }
    }
}

#[test]
fn uniform_gpu_matches_the_twin() {
    let Some(gpu) = gpu("adam::uniform_gpu_matches_the_twin") else { return };
    let n = 1000;
    let config = AdamConfig::default();
    let mut want = vec![0.0f32; 3 * n];
    let (mut m, mut v) = (vec![0.0f32; 3 * n], 0.0f32);
    let params = gpu.zeros("params", 3 * n);
    let adam = UniformAdam::new(&gpu, "test", n, config);
    for t in 1..=3u32 {
        let grads: Vec<f32> = (0..3 * n)
            .map(|i| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(t) >> 20) as f32 - 2048.0)
            .collect();
        cpu::uniform_step(&config, 0.1, t, &mut want, &grads, &mut m, &mut v);
        let grads = gpu.upload("grads", &grads);
        let mut recorder = gpu.recorder("adam/test");
        adam.step(&mut recorder, &params, &grads, 0.1, t);
        recorder.submit().unwrap();
        assert_close("params", &gpu.read(&params).unwrap(), &want, 1e-5);
    }
}

#[test]
fn uniform_steps_keep_the_gradient_s_proportions() {
    let (mut params, mut m, mut v) = (vec![0.0f64; 6], vec![0.0; 6], 0.0);
    cpu::uniform_step(&AdamConfig::default(), 0.1, 1, &mut params, &[3.0, 4.0, 0.0, 0.0, 0.0, 0.5], &mut m, &mut v);
    assert_close("params", &params, &[-0.06, -0.08, 0.0, 0.0, 0.0, -0.01], 1e-6);
}
