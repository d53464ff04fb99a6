//! The dented cube: what silhouettes cannot tell, and colours can.

use std::collections::BTreeMap;
use std::sync::Arc;

use anyhow::{Result, ensure};
use glam::{DMat3, DVec3, Vec3};
use image::{GrayImage, RgbImage};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::objective::{Border, ImageTerms, Objective, Soft, View};
use super::painter::{Painter, on_white, sheet};
use super::{Context, Report, Study, Table, Verdict};
use crate::avatar::Picture;
use crate::avatar::ply::Mesh;
use crate::camera::Camera;
use crate::eval::{Similarity, distances, mask_iou, psnr};
use crate::gpu::Gpu;
use crate::ops::adam::{AdamConfig, UniformAdam};
use crate::ops::diffuse::Diffuse;
use crate::ops::project::Project;
use crate::ops::{Corners, Topology};

pub const STUDY: Study = Study {
    name: "cube",
    title: "The dented cube",
    claim: "A cube and the same cube with all its faces dented inwards have the same silhouettes from all sides, so \
            silhouettes cannot tell them apart; with the same texture on both, RGB can",
    section: "§3.1, A motivating toy problem",
    method: "The truth is a cube of side 1 whose six faces are dented like bowls; its edges stay. Both fits start from the \
             plain cube, move all vertices freely, and use the same cameras, renderer, optimiser and steps; they differ \
             only in their loss: the silhouettes' IoU alone, or with it the colours, hard and soft. Each face has its known \
             colour. No term but the pictures' holds the mesh; its gradient is diffused over the surface. Targets are \
             rendered with 4 × 4 samples a pixel. Chamfer is the mean of both directions in percent of the side.",
    run: |context| run(context, &Settings::default()),
};

/// What decides size and time.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Squares along an edge
    pub squares: usize,
    /// Depth of a dent's middle, in sides
    pub dent: f64,
    pub views: usize,
    pub size_px: u32,
    pub steps: u32,
    /// Views a step
    pub batch: usize,
    /// Learning rate of the vertices at the start, in sides; it falls to a tenth.
    pub rate: f32,
    /// Pairs of diffusion steps over the gradient at the start and at the end
    pub diffusion: (usize, usize),
    /// Side of a picture of the figure
    pub figure_px: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            squares: 16,
            dent: 0.18,
            views: 24,
            size_px: 128,
            steps: 400,
            batch: 4,
            rate: 4e-3,
            diffusion: (12, 2),
            figure_px: 240,
        }
    }
}

/// Camera distance in sides. The whole cube is seen between 2 and 4.
const DISTANCE: f64 = 3.0;
const DEPTH: (f64, f64) = (1.9, 4.1);

fn objective(rgb: bool) -> Objective {
    Objective {
        border: Border::Edge,
        hard_rgb: rgb,
        soft_rgb: rgb.then_some(Soft { sigma: 1e-4, depth_softness_m: 0.02 }),
        // One colour a face: the borders within the surface carry its gradient.
        min_step: 0.0,
        rgb_weight: 1.0,
        silhouette_weight: 2.0,
    }
}

/// Runs the study at this size; an error where its clip, the device or a fit fails.
pub fn run(context: &Context<'_>, settings: &Settings) -> Result<Report> {
    let gpu = &context.gpu;
    let mut rng = Pcg64::seed_from_u64(context.seed);
    let cube = cube(settings.squares, 0.0);
    let truth = Mesh { vertices: self::cube(settings.squares, settings.dent).vertices, ..cube.clone() };
    let colours = colours(&cube, &mut rng);
    let cameras: Vec<Camera> = (0..settings.views).map(|i| camera(settings.size_px, i, settings.views)).collect();
    let painter = Painter::new(gpu, &cube.faces, &cube.vertices, &colours);
    let targets = cameras.iter().map(|c| painter.textured(&truth.vertices, c)).collect::<Result<Vec<_>>>()?;
    let fit = |what: &str, rgb: bool| {
        (context.say)(what);
        fit(gpu, &cube, &colours, &cameras, &targets, settings, rgb, context.seed)
    };
    let by_silhouettes = fit("the dented cube from silhouettes", false)?;
    let by_rgb = fit("the dented cube from colours and silhouettes", true)?;

    let score = |mesh: &Mesh| score(&painter, mesh, &truth, &cameras, &targets);
    let (start, silhouettes, rgb) = (score(&cube)?, score(&by_silhouettes)?, score(&by_rgb)?);
    let columns = [("Chamfer, % of a side", 3), ("IoU of the silhouettes", 4), ("PSNR of the colours, dB", 1)];
    let mut table = Table::new("The mesh against the dented cube, over the views of the fit", "mesh", &columns);
    for (label, s) in [("plain cube (start)", start), ("silhouettes alone", silhouettes), ("RGB and silhouettes", rgb)]
    {
        table.row(label, &[s.chamfer, s.iou, s.psnr]);
    }
    let ratio = silhouettes.chamfer / rgb.chamfer;
    let left = silhouettes.chamfer / start.chamfer;
    Ok(Report {
        tables: vec![table],
        figures: vec![(
            figure(&painter, [&truth, &by_silhouettes, &by_rgb], settings.figure_px)?,
            "Columns: the truth, the fit from silhouettes alone, the fit from RGB and silhouettes. Rows: with the \
             texture, without it under a light from the side, and cut through the middle."
                .to_owned(),
        )],
        verdicts: vec![
            Verdict::new(
                "The plain and the dented cube have the same silhouettes",
                start.iou > 0.999,
                format!("IoU {:.4}", start.iou),
            ),
            Verdict::new(
                "Silhouettes alone do not recover the dents",
                left > 0.8,
                format!("{:.0} % of the start's Chamfer is left", 100.0 * left),
            ),
            Verdict::new(
                "RGB recovers the dents: its Chamfer is at least 5 times lower",
                ratio >= 5.0,
                format!("{ratio:.1} times lower"),
            ),
        ],
        notes: vec![format!(
            "{} faces, dents {} of a side deep, {} views of {}², {} steps of {} views.",
            cube.faces.len(),
            settings.dent,
            settings.views,
            settings.size_px,
            settings.steps,
            settings.batch
        )],
    })
}

/// A cube of side 1 around the origin, `squares`² squares of two triangles a side, whose sides sink by `dent` in the
/// middle and not at the edges. Faces are counter-clockwise seen from outside.
fn cube(squares: usize, dent: f64) -> Mesh {
    let n = squares as i64;
    let mut index: BTreeMap<[i64; 3], u32> = BTreeMap::new();
    let mut mesh = Mesh::default();
    for side in 0..6 {
        let (axis, sign) = (side / 2, if side % 2 == 0 { 1 } else { -1 });
        let mut vertex = |i: i64, j: i64| {
            let mut grid = [0; 3];
            grid[axis] = sign * n;
            grid[(axis + 1) % 3] = sign * (2 * i - n);
            grid[(axis + 2) % 3] = 2 * j - n;
            *index.entry(grid).or_insert_with(|| {
                let mut p = grid.map(|g| 0.5 * g as f64 / n as f64);
                let bowl = |k: usize| 1.0 - 4.0 * p[(axis + k) % 3].powi(2);
                p[axis] -= sign as f64 * dent * bowl(1) * bowl(2);
                mesh.vertices.push(p.map(|x| x as f32));
                mesh.vertices.len() as u32 - 1
            })
        };
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
            // Diagonals alternate, so that the mesh has no grain.
            mesh.faces.extend(if (i + j) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
        }
    }
    mesh
}

/// One colour a face `[F, 3]`: waves over the surface, of lengths that guide from afar and from near, and some noise.
fn colours(cube: &Mesh, rng: &mut Pcg64) -> Vec<[f32; 3]> {
    let mut direction = || Vec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - 1.0;
    let waves: Vec<[(Vec3, f32); 3]> = [3.0f32, 6.0, 12.0]
        .iter()
        .map(|&turns| [(); 3].map(|()| (direction().normalize_or(Vec3::X) * turns, direction().x * 3.0)))
        .collect();
    let mut colour = |face: &[u32; 3]| {
        let centre = face.iter().map(|&v| Vec3::from(cube.vertices[v as usize])).sum::<Vec3>() / 3.0;
        std::array::from_fn(|c| {
            let sum: f32 = waves.iter().map(|w| (w[c].0.dot(centre) * 2.0 + w[c].1).sin()).sum();
            (0.5 + 0.2 * sum + 0.1 * (rng.random::<f32>() - 0.5)).clamp(0.05, 0.95)
        })
    };
    cube.faces.iter().map(&mut colour).collect()
}

/// Camera `i` of `n` that look at the cube from all sides, evenly spread over the sphere (a Fibonacci lattice).
fn camera(size_px: u32, i: usize, n: usize) -> Camera {
    let height = 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
    let around = i as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let ring = (1.0 - height * height).sqrt();
    look_from(size_px, DVec3::new(ring * around.cos(), height, ring * around.sin()))
}

fn look_from(size_px: u32, direction: DVec3) -> Camera {
    let forward = -direction.normalize();
    let right = forward.cross(DVec3::Y).normalize_or(DVec3::X);
    // Rows are the camera's axes: x right, y down, z forward.
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    let (size, focal) = (size_px as f64, 1.5 * size_px as f64);
    Camera {
        rotation: rotation.transpose().to_cols_array(),
        translation: [0.0, 0.0, DISTANCE],
        ..Camera::pinhole(size_px, size_px, [focal, focal, 0.5 * size, 0.5 * size])
    }
}

#[expect(clippy::too_many_arguments, reason = "a fit reads a mesh, its looks, its targets and its settings")]
fn fit(
    gpu: &Arc<Gpu>,
    start: &Mesh,
    colours: &[[f32; 3]],
    cameras: &[Camera],
    targets: &[Picture],
    settings: &Settings,
    rgb: bool,
    seed: u64,
) -> Result<Mesh> {
    let topology = Topology::new(start.vertices.len(), &start.faces);
    let corners = Arc::new(Corners::new(gpu, &start.faces, &topology));
    let pixels = |t: &Picture| t.transparent().pixels().map(|p| p.0).collect::<Vec<_>>();
    let views: Vec<View> = cameras.iter().zip(targets).map(|(c, t)| View::new(gpu, c.clone(), &pixels(t))).collect();
    let terms = ImageTerms::new(gpu, &corners, &views, objective(rgb));
    let diffuse = Diffuse::new(gpu, &topology.neighbours.starts, &topology.neighbours.items);
    let adam = UniformAdam::new(gpu, "vertices", start.vertices.len(), AdamConfig::default());
    let project = Project::new(gpu);
    let n = start.vertices.len();
    let vertices = gpu.upload("study/vertices", start.vertices.as_flattened());
    let colours = gpu.upload("study/face_colours", colours.as_flattened());
    let [view, grad_view, grad] = ["view", "grad_view", "grad"].map(|name| gpu.zeros::<f32>(name, 3 * n));
    let screen = gpu.zeros::<f32>("study/screen", 2 * n);
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut order: Vec<usize> = Vec::new();
    for step in 1..=settings.steps {
        let done = step as f32 / settings.steps as f32;
        let mut recorder = gpu.recorder("study/cube");
        recorder.clear(&grad);
        for _ in 0..settings.batch {
            if order.is_empty() {
                order = (0..views.len()).collect();
                order.shuffle(&mut rng);
            }
            let seen = &views[order.pop().expect("there are views")];
            project.forward(&mut recorder, &seen.camera, &vertices, &view, &screen);
            recorder.clear(&grad_view);
            let part = 1.0 / settings.batch as f32;
            terms.record(&mut recorder, seen, &view, DEPTH, &colours, part, &grad_view);
            project.view_backward(&mut recorder, &seen.camera, &grad_view, &grad);
        }
        let (coarse, fine) = (settings.diffusion.0 as f32, settings.diffusion.1 as f32);
        diffuse.apply(&mut recorder, &grad, (coarse + (fine - coarse) * done).round() as usize);
        adam.step(&mut recorder, &vertices, &grad, settings.rate * 0.1f32.powf(done), step);
        recorder.submit()?;
        if step % 20 == 0 || step == settings.steps {
            let losses = terms.take_losses(gpu)?;
            ensure!(losses.iter().all(|l| l.is_finite()), "step {step}: losses {losses:?}");
        }
    }
    Ok(Mesh { vertices: gpu.read(&vertices)?.as_chunks().0.to_vec(), ..start.clone() })
}

#[derive(Clone, Copy, Debug)]
struct Score {
    /// Percent of a side
    chamfer: f64,
    iou: f64,
    psnr: f64,
}

fn score(painter: &Painter<'_>, mesh: &Mesh, truth: &Mesh, cameras: &[Camera], targets: &[Picture]) -> Result<Score> {
    let (mut iou, mut decibels) = (0.0, 0.0);
    for (camera, target) in cameras.iter().zip(targets) {
        let ours = painter.textured(&mesh.vertices, camera)?;
        let masks: [GrayImage; 2] = [ours.coverage(), target.coverage()];
        iou += mask_iou(&masks[0], &masks[1]) / cameras.len() as f64;
        decibels += psnr(&on_white(&ours), &on_white(target)) / cameras.len() as f64;
    }
    let chamfer = distances(mesh, truth, &Similarity::IDENTITY).chamfer_cm;
    Ok(Score { chamfer, iou, psnr: decibels })
}

fn figure(painter: &Painter<'_>, meshes: [&Mesh; 3], side: u32) -> Result<RgbImage> {
    let camera = look_from(side, DVec3::new(0.75, 0.55, 0.9));
    let light = Vec3::new(0.2, 0.9, 0.5).normalize();
    let mut rows = vec![Vec::new(); 3];
    for mesh in meshes {
        rows[0].push(on_white(&painter.textured(&mesh.vertices, &camera)?));
        rows[1].push(on_white(&painter.lit(&mesh.vertices, &camera, light)?));
        rows[2].push(cut(mesh, side));
    }
    Ok(sheet(&rows))
}

/// The plane z = 0.001 through a mesh: dark inside, by the parity of the crossings to the left.
fn cut(mesh: &Mesh, side: u32) -> RgbImage {
    const Z: f32 = 0.001;
    let mut segments = Vec::new();
    for face in &mesh.faces {
        let corners = face.map(|v| mesh.vertices[v as usize]);
        let ends: Vec<[f32; 2]> = [[0, 1], [1, 2], [2, 0]]
            .into_iter()
            .map(|[a, b]| (corners[a], corners[b]))
            .filter(|(a, b)| (a[2] > Z) != (b[2] > Z))
            .map(|(a, b)| {
                let t = (Z - a[2]) / (b[2] - a[2]);
                [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]
            })
            .collect();
        if let [a, b] = ends[..] {
            segments.push((a, b));
        }
    }
    let place = |i: u32| 1.3 * ((i as f32 + 0.5) / side as f32 - 0.5);
    RgbImage::from_fn(side, side, |px, py| {
        let (x, y) = (place(px), -place(py));
        let crossings = segments
            .iter()
            .filter(|(a, b)| (a[1] > y) != (b[1] > y) && a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) < x);
        image::Rgb(if crossings.count() % 2 == 1 { [70, 90, 130] } else { [255; 3] })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn the_cube_is_closed_and_looks_outwards() {
        for dent in [0.0, 0.18] {
            let mesh = cube(4, dent);
            assert_eq!((mesh.vertices.len(), mesh.faces.len()), (6 * 16 + 2, 6 * 32));
            let topology = Topology::new(mesh.vertices.len(), &mesh.faces);
            assert_eq!(2 * topology.face_pairs.len(), 3 * mesh.faces.len(), "every edge has two faces");
            let volume: f32 = mesh
                .faces
                .iter()
                .map(|f| f.map(|v| Vec3::from(mesh.vertices[v as usize])))
                .map(|[a, b, c]| a.dot(b.cross(c)) / 6.0)
                .sum();
            // A bowl takes away dent · (2/3)², less on a coarse grid.
            let want = 1.0 - 6.0 * dent as f32 * 4.0 / 9.0;
            assert!((volume - want).abs() < 0.06, "volume {volume}, expected about {want}");
        }
    }

    #[test]
    fn colours_pull_the_cube_towards_its_dents_and_silhouettes_do_not() {
        let Some(gpu) = gpu("study::colours_pull_the_cube_towards_its_dents_and_silhouettes_do_not") else { return };
        let work = tempfile::tempdir().unwrap();
        let context = Context::for_test(gpu, work.path());
        let settings = Settings {
            squares: 8,
            views: 12,
            size_px: 64,
            steps: 200,
            batch: 2,
            rate: 6e-3,
            diffusion: (4, 1),
            figure_px: 48,
            ..Settings::default()
        };
        let report = run(&context, &settings).unwrap();
        let chamfer: Vec<f64> = report.tables[0].rows.iter().map(|r| r.values[0].unwrap()).collect();
        let [start, silhouettes, rgb] = chamfer[..] else { panic!("{chamfer:?}") };
        assert!(silhouettes > 0.9 * start, "{chamfer:?}");
        assert!(rgb < 0.6 * start, "{chamfer:?}");
        let (figure, _) = &report.figures[0];
        // The middle of the cuts through truth and start: a dent reaches where the cube is still whole.
        let at = |column: u32| figure.get_pixel(column * 48 + 24, 2 * 48 + 8).0;
        assert_eq!((at(0), at(1)), ([255; 3], [70, 90, 130]));
    }
}
