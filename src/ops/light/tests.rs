use super::{Exposure, Light, ShadedRows, Shading, Write, cpu};
use crate::ops::Topology;
use crate::ops::interpolate::{Interpolate, Sampling};
use crate::ops::testing::{assert_close, assert_gradient, gpu};

const LIGHT: Light = Light {
    ambient: [0.5, 0.6, 0.7],
    strength: [0.6, 0.5, 0.3],
    direction: [0.48, -0.6, -0.64],
    occlusion: 0.35,
    slope: [0.1, -0.2, -0.4],
};

/// Two faces that share an edge.
const FACES: [[u32; 3]; 2] = [[0, 1, 2], [2, 1, 3]];

fn numbers(n: usize) -> Vec<f64> {
    (0..n).map(|k| ((k * 7919) % 17) as f64 / 8.0 - 1.0).collect()
}

#[test]
fn the_lamp_reaches_round_the_body_and_no_further() {
    let even = Light { slope: [0.0; 3], ..LIGHT };
    let [x, y, z] = LIGHT.direction.map(f64::from);
    let full = cpu::shade(&even, [x, y, z], [1.0; 2]);
    let away = cpu::shade(&even, [-x, -y, -z], [1.0; 2]);
    // Across the terminator: a normal at right angles to the lamp.
    let across = cpu::shade(&even, [-y, x, 0.0], [1.0; 2]);
    for k in 0..3 {
        assert!((full[k] - f64::from(LIGHT.ambient[k] + LIGHT.strength[k])).abs() < 1e-6);
        assert!((away[k] - f64::from(LIGHT.ambient[k])).abs() < 1e-6);
        let want = f64::from(LIGHT.ambient[k]) + f64::from(LIGHT.strength[k]) * 0.6 / 1.6;
        assert!((across[k] - want).abs() < 1e-6);
    }
    assert_eq!(cpu::shade(&LIGHT, [0.0f64; 3], [1.0; 2]), LIGHT.ambient.map(f64::from), "no normal, no lamp, no slope");
    assert_eq!(cpu::shade(&even, [x, y, z], [1.0, 0.0]), LIGHT.ambient.map(f64::from), "in a shadow");
    assert_eq!(cpu::shade(&LIGHT, [x, y, z], [0.0; 2]), [0.0; 3], "shut in");
    assert_eq!(Light::EVEN.shade([0.3, 0.4, -0.5], Light::EVEN.exposure(0.2, 0.7)), [1.0; 3]);
}

#[test]
fn ambient_light_is_brighter_on_one_side_and_less_in_a_corner() {
    let dark = Light { strength: [0.0; 3], ..LIGHT };
    let shade = |n: [f32; 3], open| dark.shade(n, dark.exposure(open, 1.0))[0] / dark.ambient[0];
    for (n, want) in [([0.0, -2.0, 0.0], 1.2), ([0.0, 0.0, -3.0], 1.4), ([0.0, 0.0, 3.0], 0.6)] {
        assert!((shade(n, 1.0) - want).abs() < 1e-6, "{n:?}");
    }
    let half_open = shade([0.0, 0.0, -1.0], 0.5) / shade([0.0, 0.0, -1.0], 1.0);
    assert!((half_open - 0.7846).abs() < 1e-3, "{half_open} where half of the surroundings are seen");
    assert_eq!(LIGHT.exposure(1.0, 0.7), Exposure { ambient: 1.0, lamp: 0.7 });
}

#[test]
fn a_light_is_checked() {
    assert!(LIGHT.is_sound() && Light::EVEN.is_sound());
    assert!(!Light { direction: [1.0, 1.0, 0.0], ..LIGHT }.is_sound());
    assert!(!Light { slope: [0.0, 0.8, 0.8], ..LIGHT }.is_sound());
    assert!(!Light { occlusion: -1.0, ..LIGHT }.is_sound());
    assert!(!Light { ambient: [f32::NAN, 0.0, 0.0], ..LIGHT }.is_sound());
}

#[test]
fn the_product_is_its_own_backward_pass() {
    let (normals, upstream) = (numbers(12), numbers(12).into_iter().rev().collect::<Vec<_>>());
    let exposure = [1.0, 1.0, 0.9, 0.0, 0.3, 0.5, 0.6, 0.25];
    let apply = |values: &[f64]| cpu::apply(&LIGHT, &normals, &exposure, values);
    let loss = |values: &[f64]| apply(values).iter().zip(&upstream).map(|(a, b)| a * b).sum::<f64>();
    assert_gradient("values", &numbers(12), &apply(&upstream), loss);
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("light::gpu_matches_the_twin") else { return };
    let values: Vec<f32> = (0..300).map(|k| (k % 11) as f32 * 0.1).collect();
    let parts: Vec<f32> = (0..200).map(|k| (k % 7) as f32 / 6.0).collect();
    let shading = Shading::new(&gpu, &Topology::new(4, &FACES));
    let [p, v] = [&parts, &values].map(|x| gpu.upload("x", x));
    let [over, add, cut] = [9.0f32, 1.0, 9.0].map(|x| gpu.upload("shaded", &[x; 300]));
    let count = gpu.upload("count", &[90u32]);
    let rows = ShadedRows::Counted(&count, 100);
    let mut recorder = gpu.recorder("light/test");
    for (shaded, write) in [(&over, Write::Over), (&add, Write::Add), (&cut, Write::Cut)] {
        shading.apply(&mut recorder, &LIGHT, rows, &p, &v, shaded, write);
    }
    recorder.submit().unwrap();
    // Straight at the lamp, and no slope: what reaches the rows is their part of the shade.
    let normals: Vec<f32> = std::iter::repeat_n(LIGHT.direction, 90).flatten().collect();
    let want = cpu::apply(&Light { slope: [0.0; 3], ..LIGHT }, &normals, &parts[..180], &values[..270]);
    let over = gpu.read(&over).unwrap();
    assert_close("over", &over[..270], &want, 1e-6);
    assert_eq!(over[270..], [9.0; 30], "rows behind the count stay");
    let added: Vec<f32> = want.iter().map(|x| x + 1.0).collect();
    assert_close("add", &gpu.read(&add).unwrap()[..270], &added, 1e-6);
    let cut_off: Vec<f32> = want.iter().map(|x| x.min(1.0)).collect();
    assert!(cut_off != want, "nothing was brighter than white");
    assert_close("cut", &gpu.read(&cut).unwrap()[..270], &cut_off, 1e-6);
}

#[test]
fn light_on_vertices_and_pixels_matches_the_twin() {
    let Some(gpu) = gpu("light::light_on_vertices_and_pixels_matches_the_twin") else { return };
    // The last vertex belongs to no face.
    let shading = Shading::new(&gpu, &Topology::new(5, &FACES));
    let face_normals: Vec<f32> = vec![0.0, 0.2, -1.0, 0.5, 0.0, -2.0];
    let (on_faces, on_vertices) = (gpu.upload("face_normals", &face_normals), gpu.zeros::<f32>("vertex_normals", 15));
    let pix_to_face = gpu.upload("pix_to_face", &[-1i32, 1, 0, -1]);
    let bary: Vec<f32> = vec![0.0, 0.0, 0.0, 0.2, 0.3, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let bary_coords = gpu.upload("bary", &bary);
    let faces = gpu.upload("faces", FACES.as_flattened());
    let list = Interpolate::new(&gpu, 4, 4, 0);
    let (texcoords, parts) = (gpu.zeros::<f32>("texcoords", 12), gpu.zeros::<f32>("parts", 8));
    let face_parts = gpu.zeros::<f32>("face_parts", 4);
    let open = [1.0f32, 0.8, 0.6, 0.4, 9.0];
    let visible = [1.0f32, 0.5, 0.25, 0.0, 9.0];
    let exposure: Vec<f32> = open.iter().zip(visible).flat_map(|(&open, visible)| [open, visible]).collect();
    let exposure = gpu.upload("exposure", &exposure);
    let values: Vec<f32> = (1..=12).map(|k| k as f32 * 0.1).collect();
    let (values, shaded) = (gpu.upload("values", &values), gpu.upload("shaded", &[9.0f32; 12]));
    let mut recorder = gpu.recorder("light/test");
    shading.vertex_normals(&mut recorder, &on_faces, &on_vertices);
    list.forward(&mut recorder, 4, &pix_to_face, &bary_coords, &faces, &texcoords, Sampling::ALL);
    shading.face_parts(&mut recorder, &LIGHT, &exposure, &faces, &on_faces, &face_parts);
    shading.pixel_parts(
        &mut recorder,
        &LIGHT,
        &exposure,
        &list,
        4,
        &pix_to_face,
        &bary_coords,
        &faces,
        &on_vertices,
        &parts,
    );
    shading.apply(&mut recorder, &LIGHT, ShadedRows::Listed(&list, 4), &parts, &values, &shaded, Write::Over);
    recorder.submit().unwrap();
    let want = cpu::vertex_normals(&FACES, &face_normals, 5);
    assert_close("vertex_normals", &gpu.read(&on_vertices).unwrap(), &want, 1e-6);
    let unit = |v: usize| [want[3 * v], want[3 * v + 1], want[3 * v + 2]];
    let second: [f32; 3] = std::array::from_fn(|k| 0.2 * unit(2)[k] + 0.3 * unit(1)[k] + 0.5 * unit(3)[k]);
    let parts = gpu.read(&parts).unwrap();
    let reaching = [0.2 * 0.6 + 0.3 * 0.8 + 0.5 * 0.4, 0.2 * 0.25 + 0.3 * 0.5 + 0.5 * 0.0, 1.0, 1.0];
    let want_parts = [(second, [reaching[0], reaching[1]]), (unit(0), [1.0, 1.0])].map(|(normal, [ambient, lamp])| {
        let parts = cpu::parts(&LIGHT, normal);
        [ambient * parts[0], lamp * parts[1]]
    });
    assert_close("parts", &parts[..4], want_parts.as_flattened(), 1e-6);
    let products = cpu::apply(&LIGHT, &[second, unit(0)].concat(), &reaching, &[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
    let shaded = gpu.read(&shaded).unwrap();
    assert_close("shaded", &shaded[..6], &products, 1e-6);
    assert_eq!(shaded[6..], [9.0; 6], "rows behind the list stay");
    let of_face = |f: usize, [ambient, lamp]: [f32; 2]| {
        let parts = cpu::parts(&LIGHT, [0, 1, 2].map(|k| face_normals[3 * f + k]));
        [ambient / 3.0 * parts[0], lamp / 3.0 * parts[1]]
    };
    let want = [of_face(0, [2.4, 1.75]), of_face(1, [1.8, 0.75])];
    assert_close("face_parts", &gpu.read(&face_parts).unwrap(), want.as_flattened(), 1e-6);
}
