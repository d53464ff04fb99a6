use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use super::{FEATURES, TextureField, TextureFieldConfig, TextureFieldError, TextureFieldParams, cpu};
use crate::npz::Npz;
use crate::ops::Real;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, golden, gpu};

fn golden_config(npz: &Npz) -> TextureFieldConfig {
    TextureFieldConfig {
        n_levels: npz.scalar("levels").unwrap() as usize,
        n_features_per_level: npz.scalar("features").unwrap() as usize,
        log2_hashmap_size: npz.scalar("log2_table").unwrap() as u32,
        base_resolution: npz.scalar("base_resolution").unwrap() as u32,
        per_level_scale: npz.scalar("growth").unwrap(),
        hidden_width: npz.get("w0").unwrap().shape[0],
    }
}

fn data<T: Real>(npz: &Npz, name: &str) -> Vec<T> {
    npz.get(name).unwrap().data.iter().map(|&x| T::of(x)).collect()
}

fn golden_params<T: Real>(npz: &Npz, prefix: &str) -> TextureFieldParams<T> {
    let get = |name: &str| data(npz, &format!("{prefix}{name}"));
    TextureFieldParams { table: get("table"), w0: get("w0"), w1: get("w1"), w2: get("w2") }
}

fn assert_params<A: Real>(ours: &TextureFieldParams<A>, want: &TextureFieldParams<f64>, tolerance: f64) {
    assert_close("grad_w2", &ours.w2, &want.w2, tolerance);
    assert_close("grad_w1", &ours.w1, &want.w1, tolerance);
    assert_close("grad_w0", &ours.w0, &want.w0, tolerance);
    assert_close("grad_table", &ours.table, &want.table, tolerance);
}

#[test]
fn level_offsets_match_golden() {
    let npz = golden("texture_field.npz");
    let config = golden_config(&npz);
    let mut offsets: Vec<usize> = config.levels().iter().map(|l| l.offset as usize).collect();
    offsets.push(config.n_entries());
    assert_eq!(offsets, npz.get("level_offsets").unwrap().usize());
}

#[test]
fn cpu_matches_golden() {
    let npz = golden("texture_field.npz");
    let config = golden_config(&npz);
    let params = golden_params::<f64>(&npz, "");
    let coords: Vec<f64> = data(&npz, "coords");
    assert_close("encoded", &cpu::encode(&config, &params.table, &coords), &data::<f64>(&npz, "encoded"), 1e-12);
    assert_close("rgb", &cpu::forward(&config, &params, &coords), &data::<f64>(&npz, "rgb"), 1e-12);
    let mut grads = TextureFieldParams::zeros(&config);
    let mut grad_coords = vec![0.0; coords.len()];
    cpu::backward(&config, &params, &coords, &data(&npz, "upstream"), &mut grads, &mut grad_coords);
    assert_params(&grads, &golden_params(&npz, "grad_"), 1e-10);
    assert_close("grad_coords", &grad_coords, &data::<f64>(&npz, "grad_coords"), 1e-10);
}

#[test]
fn gpu_matches_golden() {
    let Some(gpu) = gpu("texture_field::gpu_matches_golden") else { return };
    let npz = golden("texture_field.npz");
    let config = golden_config(&npz);
    let coords: Vec<f32> = data(&npz, "coords");
    let n = coords.len() / 3;
    let field = TextureField::new(&gpu, config, &golden_params(&npz, ""), n).unwrap();
    let coords = gpu.upload("coords", &coords);
    let count = gpu.upload("count", &[n as u32]);
    let grad_rgb = gpu.upload("grad_rgb", &data::<f32>(&npz, "upstream"));
    let grad_coords = gpu.zeros::<f32>("grad_coords", 3 * n);
    let mut recorder = gpu.recorder("texture_field/test");
    field.forward(&mut recorder, &coords, &count, n);
    field.backward(&mut recorder, &coords, &count, n, &grad_rgb, &grad_coords);
    field.settle(&mut recorder);
    recorder.submit().unwrap();
    assert_close("rgb", &gpu.read(&field.rgb).unwrap(), &data::<f64>(&npz, "rgb"), VALUE);
    assert_params(&field.gradients(&gpu).unwrap(), &golden_params(&npz, "grad_"), GRADIENT);
    assert_close("grad_coords", &gpu.read(&grad_coords).unwrap(), &data::<f64>(&npz, "grad_coords"), GRADIENT);
}

/// Random coordinates in `[low, high]`, weights of a size at which every layer matters.
fn random_case(config: &TextureFieldConfig, n: usize, range: (f64, f64)) -> (TextureFieldParams<f64>, Vec<f64>) {
    let mut rng = Pcg32::seed_from_u64(7);
    let mut uniform = |n: usize, low: f64, high: f64| -> Vec<f64> {
        // Rounded to f32, so that the device and the twin see the same cells.
        (0..n).map(|_| rng.random_range(low..high) as f32 as f64).collect()
    };
    let zeros = TextureFieldParams::<f64>::zeros(config);
    let params = TextureFieldParams {
        table: uniform(zeros.table.len(), -1.0, 1.0),
        w0: uniform(zeros.w0.len(), -0.5, 0.5),
        w1: uniform(zeros.w1.len(), -0.5, 0.5),
        w2: uniform(zeros.w2.len(), -0.5, 0.5),
    };
    (params, uniform(3 * n, range.0, range.1))
}

/// A level that is dense (resolution 3, 27 points in 32 entries) and two that are hashed.
fn small() -> TextureFieldConfig {
    TextureFieldConfig {
        n_levels: 3,
        n_features_per_level: FEATURES,
        log2_hashmap_size: 5,
        base_resolution: 3,
        per_level_scale: 1.7,
        hidden_width: 5,
    }
}

fn check_gradients(config: &TextureFieldConfig, params: &TextureFieldParams<f64>, coords: &[f64]) {
    let upstream: Vec<f64> = (0..coords.len()).map(|i| (i as f64 * 1.3).sin()).collect();
    let loss = |params: &TextureFieldParams<f64>, coords: &[f64]| -> f64 {
        cpu::forward(config, params, coords).iter().zip(&upstream).map(|(a, b)| a * b).sum()
    };
    let mut grads = TextureFieldParams::zeros(config);
    let mut grad_coords = vec![0.0; coords.len()];
    cpu::backward(config, params, coords, &upstream, &mut grads, &mut grad_coords);
    assert_gradient("grad_coords", coords, &grad_coords, |x| loss(params, x));
    let moved = |set: &dyn Fn(&mut TextureFieldParams<f64>)| {
        let mut params = params.clone();
        set(&mut params);
        loss(&params, coords)
    };
    assert_gradient("grad_table", &params.table, &grads.table, |x| moved(&|p| p.table = x.to_vec()));
    assert_gradient("grad_w0", &params.w0, &grads.w0, |x| moved(&|p| p.w0 = x.to_vec()));
    assert_gradient("grad_w1", &params.w1, &grads.w1, |x| moved(&|p| p.w1 = x.to_vec()));
    assert_gradient("grad_w2", &params.w2, &grads.w2, |x| moved(&|p| p.w2 = x.to_vec()));
}

#[test]
fn gradients_inside_dense_and_hashed_cells() {
    let config = small();
    assert_eq!(config.levels().iter().map(|l| l.hashed).collect::<Vec<_>>(), [false, true, true]);
    let (params, coords) = random_case(&config, 6, (0.05, 0.95));
    check_gradients(&config, &params, &coords);
}

#[test]
fn gradients_of_clamped_coordinates_are_zero() {
    let config = small();
    let (params, mut coords) = random_case(&config, 3, (0.05, 0.95));
    (coords[0], coords[4], coords[6], coords[8]) = (-0.3, 1.2, -2.0, 5.0);
    check_gradients(&config, &params, &coords);
    let mut grad_coords = vec![0.0; coords.len()];
    cpu::backward(&config, &params, &coords, &[1.0; 9], &mut TextureFieldParams::zeros(&config), &mut grad_coords);
    for i in [0, 4, 6, 8] {
        assert_eq!(grad_coords[i], 0.0, "grad_coords[{i}]");
    }
}

#[test]
fn gradients_with_silent_hidden_units() {
    let config = small();
    let (mut params, coords) = random_case(&config, 4, (0.05, 0.95));
    // Unit 1 of layer 0 sees only negative weights and positive features; unit 2 of layer 1 likewise.
    params.table.iter_mut().for_each(|x| *x = x.abs() + 0.01);
    params.w0[6..12].iter_mut().for_each(|x| *x = -x.abs() - 0.01);
    params.w1[10..15].iter_mut().for_each(|x| *x = -x.abs() - 0.01);
    check_gradients(&config, &params, &coords);
}

/// The corner beyond the last point of a dense level wraps around; nothing is read outside the table.
#[test]
fn the_upper_border_stays_inside_the_table() {
    let config = small();
    let (params, _) = random_case(&config, 1, (0.0, 1.0));
    let at = |x: f64| cpu::forward(&config, &params, &[x, x, x]);
    assert_eq!(at(1.0), at(7.0));
    assert_eq!(at(0.0), at(-7.0));
    assert!(at(f64::NAN).len() == 3);
}

/// In f64 this finest scale is a little below 63 and the middle of the cube a little below point 32; f32 must not lift
/// it over the border, where the gradient differs.
#[test]
fn the_middle_of_the_cube_keeps_its_cell_in_f32() {
    let growth = ((64f64.ln() - 4f64.ln()) / 7.0).exp();
    let config = TextureFieldConfig {
        n_levels: 8,
        base_resolution: 4,
        per_level_scale: growth,
        ..TextureFieldConfig::default()
    };
    let finest = config.levels()[7];
    assert!(finest.scale < 63.0 && finest.scale > 62.999_999);
    assert!(0.5 * finest.scale_of::<f32>() + 0.5 < 32.0);
    assert_eq!(config.levels()[0].scale_of::<f32>(), 3.0);
}

fn gpu_matches_cpu(test: &str, config: TextureFieldConfig, n: usize, listed: usize) {
    let Some(gpu) = gpu(test) else { return };
    let (params, coords) = random_case(&config, n, (-0.1, 1.1));
    let f32s = |x: &[f64]| x.iter().map(|&x| x as f32).collect::<Vec<_>>();
    let params32 = TextureFieldParams {
        table: f32s(&params.table),
        w0: f32s(&params.w0),
        w1: f32s(&params.w1),
        w2: f32s(&params.w2),
    };
    // A tenth of the pixels has no gradient.
    let upstream: Vec<f32> = (0..3 * n).map(|i| if i / 3 % 10 == 0 { 0.0 } else { (i as f32 * 1.3).sin() }).collect();
    let field = TextureField::new(&gpu, config, &params32, n).unwrap();
    let coords_buffer = gpu.upload("coords", &f32s(&coords));
    let count = gpu.upload("count", &[listed as u32]);
    let grad_rgb = gpu.upload("grad_rgb", &upstream);
    let grad_coords = gpu.upload("grad_coords", &vec![1.0f32; 3 * n]);
    let mut recorder = gpu.recorder("texture_field/test");
    field.forward(&mut recorder, &coords_buffer, &count, n);
    field.backward(&mut recorder, &coords_buffer, &count, n, &grad_rgb, &grad_coords);
    field.settle(&mut recorder);
    recorder.submit().unwrap();

    // The twin computes in f32 too: both see the same cells, since they round a position alike.
    let coords = f32s(&coords[..3 * listed]);
    let mut want_coords = vec![1.0f32; 3 * n];
    let mut want = TextureFieldParams::zeros(&config);
    let upstream = &upstream[..3 * listed];
    cpu::backward(&config, &params32, &coords, upstream, &mut want, &mut want_coords[..3 * listed]);
    let mut want_rgb = cpu::forward(&config, &params32, &coords);
    want_rgb.resize(3 * n, 0.0);
    assert_close("rgb", &gpu.read(&field.rgb).unwrap(), &want_rgb, VALUE);
    let ours = field.gradients(&gpu).unwrap();
    assert_close("grad_w2", &ours.w2, &want.w2, GRADIENT);
    assert_close("grad_w1", &ours.w1, &want.w1, GRADIENT);
    assert_close("grad_w0", &ours.w0, &want.w0, GRADIENT);
    assert_close("grad_table", &ours.table, &want.table, GRADIENT);
    assert_close("grad_coords", &gpu.read(&grad_coords).unwrap(), &want_coords, GRADIENT);
}

#[test]
fn gpu_matches_cpu_at_the_usual_size() {
    gpu_matches_cpu("texture_field::gpu_matches_cpu_at_the_usual_size", TextureFieldConfig::default(), 1500, 1300);
}

/// Widths that are no multiples of four, and a count of zero full chunks.
#[test]
fn gpu_matches_cpu_at_odd_widths() {
    gpu_matches_cpu("texture_field::gpu_matches_cpu_at_odd_widths", small(), 70, 67);
}

#[test]
fn an_empty_list_leaves_everything() {
    let Some(gpu) = gpu("texture_field::an_empty_list_leaves_everything") else { return };
    let config = small();
    let field = TextureField::new(&gpu, config, &TextureFieldParams::random(&config, 1), 10).unwrap();
    let coords = gpu.upload("coords", &[0.5f32; 30]);
    let count = gpu.upload("count", &[0u32]);
    let grad_coords = gpu.zeros::<f32>("grad_coords", 30);
    let mut recorder = gpu.recorder("texture_field/test");
    field.forward(&mut recorder, &coords, &count, 10);
    field.backward(&mut recorder, &coords, &count, 10, &coords, &grad_coords);
    field.settle(&mut recorder);
    recorder.submit().unwrap();
    assert_eq!(gpu.read(&field.rgb).unwrap(), [0.0; 30]);
    assert_eq!(field.gradients(&gpu).unwrap(), TextureFieldParams::zeros(&config));
}

#[test]
fn points_are_evaluated_in_passes() {
    let Some(gpu) = gpu("texture_field::points_are_evaluated_in_passes") else { return };
    let config = small();
    let params = TextureFieldParams::random(&config, 3);
    let field = TextureField::new(&gpu, config, &params, 16).unwrap();
    let coords: Vec<f32> = (0..3 * 50).map(|i| i as f32 / 150.0).collect();
    let rgb = field.eval_points(&gpu, &coords).unwrap();
    assert_close("rgb", &rgb, &cpu::forward(&config, &params, &coords), VALUE);
    assert_eq!(field.params(&gpu).unwrap(), params);
    let shown = TextureField::to_show(&gpu, config, &params, 16).unwrap();
    assert_eq!(shown.eval_points(&gpu, &coords).unwrap(), rgb);
    assert!(shown.grad_table.is_empty(), "only what learns has room for gradients");
}

#[test]
fn sizes_are_checked() {
    let config = TextureFieldConfig { n_features_per_level: 4, ..small() };
    let error = config.validate().unwrap_err();
    assert_eq!(error.to_string(), "texture field: n_features_per_level is 4, expected 2");
    assert!(TextureFieldConfig { n_levels: 16, hidden_width: 64, ..small() }.validate().is_ok());
    let error = TextureFieldConfig { hidden_width: 100, ..small() }.validate().unwrap_err();
    assert!(error.to_string().starts_with("texture field: hidden_width is 100 at 3 levels"), "{error}");
    let mut params = TextureFieldParams::random(&small(), 1);
    params.w1.pop();
    let error = params.validate(&small()).unwrap_err();
    assert_eq!(error, TextureFieldError::Length { array: "w1", got: 24, expected: 25 });
}

#[test]
fn a_seed_gives_the_same_parameters() {
    let config = small();
    let params = TextureFieldParams::random(&config, 5);
    assert_eq!(params, TextureFieldParams::random(&config, 5));
    assert_ne!(params, TextureFieldParams::random(&config, 6));
    assert!(params.table.iter().all(|x| x.abs() <= 1e-4));
}

#[test]
fn a_refined_field_shows_the_same_everywhere_and_has_more_to_learn() {
    // Levels that stay dense, that become dense, and that stay hashed.
    let from = TextureFieldConfig {
        n_levels: 5,
        log2_hashmap_size: 8,
        base_resolution: 4,
        per_level_scale: 2.0,
        hidden_width: 8,
        ..Default::default()
    };
    let to = from.refined(1.0 / 200.0, 13);
    assert_eq!((to.n_levels, to.log2_hashmap_size), (7, 13), "4, 8, … 256 cells");
    let hashed = |config: &TextureFieldConfig| config.levels().iter().map(|l| l.hashed).collect::<Vec<_>>();
    assert_eq!(hashed(&from), [false, true, true, true, true]);
    assert_eq!(hashed(&to), [false, false, false, true, true, true, true]);

    let mut rng = Pcg32::seed_from_u64(3);
    let mut numbers = |n: usize| (0..n).map(|_| rng.random_range(-1.0..1.0)).collect::<Vec<f32>>();
    let zeros = TextureFieldParams::<f32>::zeros(&from);
    let [table, w0, w1, w2] = [zeros.table, zeros.w0, zeros.w1, zeros.w2].map(|part| numbers(part.len()));
    let params = TextureFieldParams { table, w0, w1, w2 };
    let refined = params.refined(&from, &to, 1);
    refined.validate(&to).unwrap();
    let coords: Vec<f32> = numbers(3 * 500).into_iter().map(|x| 0.5 + 0.35 * x).collect();
    let before = cpu::forward(&from, &params, &coords);
    assert_close("rgb", &cpu::forward(&to, &refined, &coords), &before, 1e-6);

    // The new levels have a gradient, where their table is not zero.
    let mut grads = TextureFieldParams::zeros(&to);
    cpu::backward(&to, &refined, &coords, &vec![1.0; coords.len()], &mut grads, &mut vec![0.0; coords.len()]);
    let new = |w0: &[f32]| w0.chunks_exact(14).map(|row| row[10..].iter().map(|g| g.abs()).sum::<f32>()).sum::<f32>();
    assert!(new(&grads.w0) > 0.0 && new(&refined.w0) == 0.0);
}

#[test]
fn a_field_is_refined_to_a_cell_and_no_further_than_there_may_be() {
    let config = TextureFieldConfig::default();
    assert_eq!(config.refined(1.0, 10), config, "fine and large enough");
    let finest = |cell: f64| config.refined(cell, 17).levels().last().unwrap().scale;
    assert!((1000.0..1380.0).contains(&finest(1e-3)), "{}", finest(1e-3));
    let most = config.refined(1e-9, 17);
    most.validate().unwrap();
    assert!(TextureFieldConfig { n_levels: most.n_levels + 1, ..most }.validate().is_err());
}

#[test]
fn the_host_makes_room_for_what_shaders_index_by() {
    assert_eq!(super::MAX_LEVELS, crate::gpu::shader::shared_constant("shared/hash_grid", "MAX_LEVELS"));
}
