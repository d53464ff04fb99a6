//! Two stages against one: the paper's moving targets.

use anyhow::Result;
use image::RgbImage;

use super::painter::sheet;
use super::person::{Fitted, Person, comparable, middle};
use super::{Context, Report, Study, Table, Verdict};
use crate::avatar::ply::Mesh;
use crate::eval::Report as Scores;
use crate::fit::FitConfig;
use crate::fit::config::Preconditioner;
use crate::ops::Topology;
use crate::ops::{face_normals, normal_consistency};
use crate::synth::{Outfit, SynthOptions};

pub const STUDY: Study = Study {
    name: "stages",
    title: "Two stages against one (moving targets)",
    claim: "Fitting everything at once gives jagged meshes with blurry textures, because texture and deformation hinder each \
            other; one colour a face first, the texture after it, does not",
    section: "§3.6 Two-stage training",
    method: "One made person in loose clothes and even light. `joint` moves β, D, poses, places, hash texture and texture \
             coordinates in all its steps, as many as both stages have together, with the losses, weights and rates of the \
             two-stage fit's geometry; its last passes go on as stage 1 ends, so its shape moves longer. Its \
             soft image takes each face's colour from the texture, without a gradient. No light is modelled. Both start from what stage 0 finds in \
             keypoints and masks, and look at all pixels. Jaggedness is the paper's normal consistency, 1 − cos of the angle \
             between neighbouring faces, mean over the edges of the fitted T-pose; the truth's own is given beside it. Our \
             regularisers are the Laplacian of D, the diffusion of its gradient and smooth motion, besides the paper's normal \
             consistency and face areas; the second pair does without them.",
    run: |context| run(context, &Settings::default()),
};

/// What decides size and time.
#[derive(Clone, Debug)]
pub struct Settings {
    pub frames: usize,
    pub size_px: u32,
    /// Passes: geometry at half and at full resolution, texture
    pub passes: [u32; 3],
    pub batch: usize,
    pub truths: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self { frames: 24, size_px: 288, passes: [24, 16, 32], batch: 3, truths: 4 }
    }
}

fn two_stages(seed: u64, settings: &Settings) -> FitConfig {
    let mut config = comparable(FitConfig::standard(seed).with_shape_standing());
    let phases: Vec<_> = config.geometry.phases.iter_mut().chain(&mut config.texture.phases).collect();
    assert_eq!(phases.len(), settings.passes.len(), "phases of standard");
    phases.into_iter().zip(settings.passes).for_each(|(phase, passes)| phase.epochs = passes);
    config.batch = settings.batch;
    config.pixel_rate = 1.0;
    config
}

/// Mean of 1 − cos over pairs of neighbouring faces.
fn jaggedness(mesh: &Mesh) -> f64 {
    let vertices: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| v.map(f64::from)).collect();
    let pairs = Topology::new(mesh.vertices.len(), &mesh.faces).face_pairs;
    let normals = face_normals::cpu::forward(&mesh.faces, &vertices);
    normal_consistency::cpu::forward(&pairs, &normals) / pairs.len().max(1) as f64
}

/// Runs the study at this size; an error where its clip, the device or a fit fails.
pub fn run(context: &Context<'_>, settings: &Settings) -> Result<Report> {
    let Settings { frames, size_px, truths, .. } = *settings;
    let options = SynthOptions {
        frames,
        size_px,
        truths,
        outfit: Outfit::Loose,
        checked: true,
        side_light: 0.0,
        seed: context.seed,
        ..SynthOptions::default()
    };
    let mut person = Person::new(context, &options)?;
    let truth = person.truth(true)?;
    let start = person.start(&two_stages(context.seed, settings))?;
    let (surface, frame) = person.first_surface(&truth)?;
    let columns = [("PSNR, dB", 2), ("Chamfer (sum), cm", 3), ("P2S, cm", 3), ("1 − cos", 4)];
    let mut table = Table::new("Held-out views in our scale, surface, jaggedness", "fit", &columns);
    let mut pictures = vec![[person.lit(&surface, &start.camera, size_px)?, truth.views[0].on_white()?]];
    let mut values = Vec::new();
    for (name, config) in methods(context.seed, settings) {
        (context.say)(&name);
        let fitted = person.fit(&config, &start)?;
        let (scores, jagged, shown) = judge(&person, &fitted, &config, &truth, frame)?;
        let s = &scores.summary;
        let numbers =
            [s.scaled_novel_views.as_ref().map(|m| m.psnr_db), s.chamfer_sum_cm, s.point_to_surface_cm, Some(jagged)];
        values.push(numbers.map(|v| v.unwrap_or(f64::NAN)));
        table.row_with_gaps(name, numbers.to_vec());
        pictures.push(shown);
    }
    table.row_with_gaps("truth", vec![None, None, None, Some(jaggedness(&surface))]);
    let rows = [0, 1].map(|k| pictures.iter().map(|p| middle(&p[k], 0.62)).collect::<Vec<RgbImage>>());
    let caption = "Surface and a held-out view: truth; two stages and joint with our regularisers; two stages and joint with \
                   the paper's alone";
    let passes: u32 = settings.passes.iter().sum();
    let note = format!("{frames} frames of {size_px}², {passes} passes each, poses found from keypoints and masks.");
    let verdicts = REGULARISERS.iter().zip(values.chunks_exact(2)).flat_map(|(of, v)| verdicts(of, &v[0], &v[1]));
    Ok(Report {
        verdicts: verdicts.collect(),
        tables: vec![table],
        figures: vec![(sheet(&rows), caption.to_owned())],
        notes: vec![note],
    })
}

/// What holds the mesh besides the pictures.
const REGULARISERS: [&str; 2] = ["our regularisers", "the paper's regularisers"];

/// Two stages and one, with each set of regularisers.
fn methods(seed: u64, settings: &Settings) -> Vec<(String, FitConfig)> {
    let ours = two_stages(seed, settings);
    let mut papers = ours.clone();
    for stage in [&mut papers.geometry, &mut papers.texture] {
        (stage.weights.laplacian, stage.weights.motion) = (0.0, 0.0);
        stage.phases.iter_mut().for_each(|phase| phase.preconditioner = Preconditioner::None);
    }
    let pairs = REGULARISERS.iter().zip([ours, papers]);
    let both =
        pairs.map(|(of, two)| [(format!("two stages, {of}"), two.clone()), (format!("joint, {of}"), two.joint())]);
    both.flatten().collect()
}

/// Scores, jaggedness of the T-pose, and pictures of the surface and of a held-out view.
fn judge(
    person: &Person,
    fitted: &Fitted,
    config: &FitConfig,
    truth: &crate::eval::Subject,
    frame: u32,
) -> Result<(Scores, f64, [RgbImage; 2])> {
    let avatar = person.avatar(fitted, config);
    let rest = Mesh { vertices: avatar.rest_vertices(), faces: person.body.faces.clone(), colours: Vec::new() };
    let mesh = avatar.mesh(Some(avatar.nearest_frame(frame))).expect("the nearest frame is one");
    let surface = person.lit(&mesh, &fitted.camera, fitted.camera.width)?;
    let scores = person.evaluate(avatar.clone(), truth)?;
    let view = person.view(avatar, &truth.views[0], scores.scale().unwrap_or(1.0))?;
    Ok((scores, jaggedness(&rest), [surface, view]))
}

fn verdicts(of: &str, two: &[f64; 4], joint: &[f64; 4]) -> [Verdict; 3] {
    let against =
        |k: usize, digits: usize, unit: &str| format!("{:.digits$} against {:.digits$}{unit}", two[k], joint[k]);
    let claim = |what: &str| format!("with {of}, two stages {what}");
    [
        Verdict::new(claim("give smoother meshes than one"), two[3] < joint[3], against(3, 4, "")),
        Verdict::new(claim("come nearer to the surface"), two[1] < joint[1], against(1, 3, " cm Chamfer")),
        Verdict::new(claim("give better held-out views"), two[0] > joint[0], against(0, 2, " dB")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn a_small_study_compares_both() {
        let Some(gpu) = gpu("study::stages::a_small_study_compares_both") else { return };
        let work = tempfile::tempdir().unwrap();
        let context = Context::for_test(gpu, work.path());
        let settings = Settings { frames: 6, size_px: 96, passes: [2, 1, 2], batch: 3, truths: 1 };
        let report = run(&context, &settings).unwrap();
        let rows = &report.tables[0].rows;
        assert_eq!((rows.len(), rows[4].label.as_str()), (5, "truth"));
        assert!(rows[1].label.starts_with("joint") && rows[3].label.starts_with("joint"), "{rows:?}");
        for row in &rows[..4] {
            let values: Vec<f64> = row.values.iter().map(|v| v.unwrap()).collect();
            assert!(values[0] > 19.0 && values[1] > 0.0 && values[3] > 0.0, "{}: {values:?}", row.label);
        }
        assert_eq!(report.verdicts.len(), 6);
        assert_ne!(rows[0].values, rows[2].values, "the regularisers differ");
    }

    #[test]
    fn a_flat_sheet_is_not_jagged() {
        let vertices = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
        let faces = vec![[0, 1, 2], [1, 3, 2]];
        let mut mesh = Mesh { vertices, faces, colours: Vec::new() };
        assert!(jaggedness(&mesh).abs() < 1e-9);
        mesh.vertices[3][2] = 2f32.sqrt();
        assert!(jaggedness(&mesh) > 0.2);
    }
}
