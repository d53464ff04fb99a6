//! The hash texture against fixed coordinates and against a texel map.

use anyhow::{Context as _, Result};
use image::RgbImage;
use image::imageops::{self, FilterType};

use super::painter::{on_white, sheet};
use super::person::{Fitted, Person, comparable};
use super::{Context, Report, Study, Table, Verdict};
use crate::avatar::{Shading, SurfacePoint, SurfaceTexture, Tracer, UvLayout};
use crate::camera::Camera;
use crate::eval::{Novel, psnr, ssim};
use crate::fit::{FitConfig, FitState, Stage, Texels};
use crate::ops::texel_map;
use crate::synth::{Outfit, SynthOptions};

pub const STUDY: Study = Study {
    name: "texture",
    title: "Hash texture, learned coordinates and texel map",
    claim: "The hash texture does not waste its capacity on plain regions and keeps details sharp that a texel map blurs; \
            learned coordinates let it spend more on faces and logos",
    section: "§3.2 Texture representation",
    method: "Shape, poses and places are the truth's and stand, so that the texture alone differs; the light is \
             even. All three see the same \
             pixels in the same order for the same steps with the same optimiser; the texel map has as many texels as give \
             the same number of parameters, on the body's atlas. It is given at the default size and at an eighth of the \
             table. PSNR and SSIM are over held-out views on white; `face` and `logo` are PSNR over the crops that show \
             them.",
    run: |context| run(context, &Settings::default()),
};

/// What decides size and time.
#[derive(Clone, Debug)]
pub struct Settings {
    pub frames: usize,
    pub size_px: u32,
    pub passes: u32,
    pub views: usize,
    /// Entries of a level of the hash table, powers of two, one for each size that is compared.
    pub log2_hashmap_sizes: Vec<u32>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { frames: 16, size_px: 512, passes: 30, views: 4, log2_hashmap_sizes: vec![15, 12] }
    }
}

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Model {
    Learned,
    Fixed,
    Texels,
}

impl Model {
    const ALL: [Self; 3] = [Self::Learned, Self::Fixed, Self::Texels];

    fn name(self) -> &'static str {
        match self {
            Self::Learned => "hash, learned coordinates",
            Self::Fixed => "hash, fixed coordinates",
            Self::Texels => "texel map",
        }
    }
}

/// Stage 2 alone, poses standing.
fn config(seed: u64, settings: &Settings, log2_hashmap_size: u32, model: Model) -> FitConfig {
    let mut config = comparable(FitConfig::standard(seed).with_shape_standing());
    config.field.log2_hashmap_size = log2_hashmap_size;
    config.texture.phases.truncate(1);
    for phase in &mut config.texture.phases {
        (phase.epochs, phase.pose_rate) = (settings.passes, 0.0);
    }
    config.batch = 1;
    if model != Model::Learned {
        config.rates.texcoords = 0.0;
    }
    config
}

/// The texture's parameters, without coordinates.
fn n_parameters(state: &FitState) -> usize {
    let field = &state.field;
    match &state.texels {
        Some(texels) => texels.values.len(),
        None => field.table.len() + field.w0.len() + field.w1.len() + field.w2.len(),
    }
}

/// Scores of one texture: PSNR and SSIM of the views, PSNR of the crops.
struct Scores {
    model: Model,
    log2_hashmap_size: u32,
    parameters: usize,
    /// PSNR, SSIM, face, logo
    values: [f64; 4],
}

/// Runs the study at this size; an error where its clip, the device or a fit fails.
pub fn run(context: &Context<'_>, settings: &Settings) -> Result<Report> {
    let Settings { frames, size_px, views, .. } = *settings;
    let options = SynthOptions {
        frames,
        size_px,
        truths: views,
        outfit: Outfit::Tight,
        checked: true,
        side_light: 0.0,
        seed: context.seed,
        ..Default::default()
    };
    let person = Person::new(context, &options)?;
    let novels = person.truth(true)?.views;
    let truths = novels.iter().map(Novel::on_white).collect::<Result<Vec<_>, _>>()?;
    let crops = Crops::of(&person, &novels[0].camera)?;
    let mut rows = vec![crops.rows(&truths[0])];
    let mut scores: Vec<Scores> = Vec::new();
    for &size in &settings.log2_hashmap_sizes {
        for model in Model::ALL {
            (context.say)(&format!("{}, 2^{size} entries a level", model.name()));
            let config = config(context.seed, settings, size, model);
            let fitted = person.fit(&config, &start(&person, &config, model)?)?;
            let ours = pictures(&person, &fitted, &config, &novels)?;
            let mean = |value: fn(&RgbImage, &RgbImage) -> f64| {
                truths.iter().zip(&ours).map(|(t, o)| value(t, o)).sum::<f64>() / ours.len() as f64
            };
            let of_crop = |k: usize| psnr(&crops.cut(&truths[0], k), &crops.cut(&ours[0], k));
            rows.push(crops.rows(&ours[0]));
            scores.push(Scores {
                model,
                log2_hashmap_size: size,
                parameters: n_parameters(&fitted.state),
                values: [mean(psnr), mean(ssim), of_crop(0), of_crop(1)],
            });
        }
    }
    let names: Vec<String> = scores.iter().map(|s| format!("{}, {}", s.model.name(), s.parameters)).collect();
    let note = format!("{frames} frames of {size_px}², {} passes; shape and poses given.", settings.passes);
    Ok(Report {
        tables: vec![table(&scores)],
        figures: vec![(
            sheet(&transposed(rows)),
            format!("Face and logo of a held-out view: truth; {}", names.join("; ")),
        )],
        verdicts: verdicts(&scores),
        notes: vec![note],
    })
}

/// The truth's shape and poses with a fresh texture.
fn start(person: &Person, config: &FitConfig, model: Model) -> Result<Fitted> {
    let mut fitted = person.true_start(config)?;
    fitted.state.stage = Stage::Texture;
    if model == Model::Texels {
        let layout = UvLayout::of_body(&person.body);
        let side = (n_parameters(&fitted.state) as f64 / 3.0).sqrt().round() as usize;
        fitted.state.texels = Some(Texels::grey(layout.uvs, layout.uv_faces, side));
    }
    Ok(fitted)
}

/// The held-out views with this texture, on white.
fn pictures(person: &Person, fitted: &Fitted, config: &FitConfig, novels: &[Novel]) -> Result<Vec<RgbImage>> {
    let avatar = person.avatar(fitted, config);
    let posed = avatar.mesh(Some(0)).context("a clip has a frame")?;
    let tracer = Tracer::new(&person.gpu, &posed.faces, &posed.vertices);
    let hash = SurfaceTexture::new(&person.gpu, &avatar)?;
    let texel = |texels: &Texels, point: &SurfacePoint| -> [f32; 3] {
        let corners = texels.uv_faces[point.face as usize].map(|c| texels.uvs[c as usize]);
        let [u, v] = [0, 1].map(|k| (0..3).map(|c| point.bary[c] * corners[c][k]).sum::<f32>());
        texel_map::cpu::forward(&texels.values, texels.side, &[u, v, 0.0]).map(|x| x.clamp(0.0, 1.0))
    };
    let picture = |novel: &Novel| -> Result<RgbImage> {
        let drawn =
            tracer.trace(&posed.vertices, &novel.camera, 4, Shading::Samples, |points| match &fitted.state.texels {
                Some(texels) => Ok(points.iter().map(|p| texel(texels, p)).collect()),
                None => hash.colours(&person.gpu, points),
            })?;
        Ok(on_white(&drawn))
    };
    novels.iter().map(picture).collect()
}

/// Where a view shows the face and the logo: corner and side, pixels.
struct Crops([(u32, u32, u32); 2]);

/// Pixels of a crop in the figure.
const SHOWN_PX: u32 = 150;

impl Crops {
    /// Round the head's and the chest's joints of frame 0.
    fn of(person: &Person, camera: &Camera) -> Result<Self> {
        let joints = person.first_joints()?;
        let around = |joint: usize, up_m: f64, side_m: f64| {
            let [x, y, z] = joints[joint];
            let seen = camera.view([x, y - up_m, z]);
            let side = (camera.fx * side_m / seen[2]) as u32;
            let corner = |middle: f64, n: u32| (middle - 0.5 * side as f64).clamp(0.0, (n - side.min(n)) as f64) as u32;
            let [u, v] = camera.project(seen);
            (corner(u, camera.width), corner(v, camera.height), side)
        };
        Ok(Self([around(15, 0.05, 0.30), around(9, 0.0, 0.30)]))
    }

    fn cut(&self, picture: &RgbImage, k: usize) -> RgbImage {
        let (x, y, side) = self.0[k];
        imageops::crop_imm(picture, x, y, side, side).to_image()
    }

    /// Both crops, large enough to look at.
    fn rows(&self, picture: &RgbImage) -> Vec<RgbImage> {
        [0, 1].map(|k| imageops::resize(&self.cut(picture, k), SHOWN_PX, SHOWN_PX, FilterType::Nearest)).to_vec()
    }
}

fn transposed(rows: Vec<Vec<RgbImage>>) -> Vec<Vec<RgbImage>> {
    (0..2).map(|k| rows.iter().map(|row| row[k].clone()).collect()).collect()
}

fn table(scores: &[Scores]) -> Table {
    let columns = [("parameters", 0), ("PSNR, dB", 2), ("SSIM", 4), ("face, dB", 2), ("logo, dB", 2)];
    let mut table = Table::new("Held-out views at equal parameters", "texture", &columns);
    for s in scores {
        let [psnr, ssim, face, logo] = s.values;
        table.row(s.model.name(), &[s.parameters as f64, psnr, ssim, face, logo]);
    }
    table
}

fn verdicts(scores: &[Scores]) -> Vec<Verdict> {
    let mut sizes: Vec<u32> = scores.iter().map(|s| s.log2_hashmap_size).collect();
    sizes.dedup();
    let mut verdicts = Vec::new();
    for size in sizes {
        let of = |model: Model| scores.iter().find(|s| s.log2_hashmap_size == size && s.model == model);
        let (Some(learned), Some(fixed), Some(texels)) = (of(Model::Learned), of(Model::Fixed), of(Model::Texels))
        else {
            continue;
        };
        for (what, other) in [("a texel map", texels), ("fixed coordinates", fixed)] {
            let better = [0, 2, 3].iter().all(|&k| learned.values[k] > other.values[k]);
            let gain = |k: usize| format!("{:+.2}", learned.values[k] - other.values[k]);
            let evidence = format!("{} dB over all, {} face, {} logo", gain(0), gain(2), gain(3));
            let claim = format!(
                "with {} parameters the hash texture with learned coordinates beats {what} over all, on face and logo",
                learned.parameters
            );
            verdicts.push(Verdict::new(claim, better, evidence));
        }
    }
    verdicts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn a_small_study_compares_three_textures() {
        let Some(gpu) = gpu("study::texture::a_small_study_compares_three_textures") else { return };
        let work = tempfile::tempdir().unwrap();
        let context = Context::for_test(gpu, work.path());
        let settings = Settings { frames: 4, size_px: 96, passes: 6, views: 1, log2_hashmap_sizes: vec![8] };
        let report = run(&context, &settings).unwrap();
        let rows: Vec<Vec<f64>> =
            report.tables[0].rows.iter().map(|r| r.values.iter().map(|v| v.unwrap()).collect()).collect();
        assert_eq!(rows.len(), 3);
        for row in &rows {
            assert!((row[0] / rows[0][0] - 1.0).abs() < 0.03, "equal parameters: {rows:?}");
            assert!(row[1] > 22.0 && row[2] > 0.8, "it has learned something: {rows:?}");
        }
        assert_eq!(report.verdicts.len(), 2);
    }

    #[test]
    fn a_tie_on_the_logo_is_no_win() {
        let score = |model, values| Scores { model, log2_hashmap_size: 9, parameters: 10, values };
        let verdicts = verdicts(&[
            score(Model::Learned, [30.0, 0.9, 25.0, 24.0]),
            score(Model::Fixed, [29.0, 0.9, 24.0, 24.0]),
            score(Model::Texels, [29.0, 0.9, 24.0, 23.0]),
        ]);
        assert!(verdicts[0].holds && !verdicts[1].holds);
        assert!(verdicts[1].evidence.contains("+0.00 logo"), "{}", verdicts[1].evidence);
    }
}
