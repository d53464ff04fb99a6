//! RGB and silhouettes against silhouettes alone, over persons in clothes of several kinds.

use anyhow::Result;
use image::RgbImage;

use super::painter::sheet;
use super::person::{Person, comparable, middle};
use super::{Context, Report, Study, Table, Verdict};
use crate::eval::Summary;
use crate::fit::FitConfig;
use crate::synth::{Outfit, SynthOptions};

pub const STUDY: Study = Study {
    name: "silhouettes",
    title: "RGB and silhouettes against silhouettes alone",
    claim: "A visual hull cannot see what is concave; with RGB the same mesh comes nearer to the true surface, for tight and \
            for loose clothes",
    section: "§4.4 Geometry reconstruction, the table of Chamfer and P2S against VideoAvatar",
    method: "Five made persons turn once in even light, so that a point keeps its colour as the method presumes; each wears \
             checked clothes of another kind, loose ones with folds whose ground no silhouette shows. \
             Both fits start from the poses and the shape that stage 0 finds in keypoints and masks, and take the same \
             passes, rates and regularisers; preset `silhouette-only` weighs no colour. No light \
             is modelled, frames count alike, and the gradient of D is diffused. Chamfer is the sum of both \
             directions as in the paper's table, P2S the mean distance of the truth's points to our surface; both in \
             centimetres after a similarity ([metrics](metrics.md)).",
    run: |context| run(context, &Settings::default()),
};

/// Side of the pictures of the figure before they are cropped.
const SHOWN_PX: u32 = 432;

/// What decides size and time.
#[derive(Clone, Debug)]
pub struct Settings {
    pub frames: usize,
    pub size_px: u32,
    /// Passes at half and at full resolution
    pub passes: [u32; 2],
    pub batch: usize,
    pub outfits: Vec<Outfit>,
    pub surfaces: usize,
}

impl Default for Settings {
    fn default() -> Self {
        let outfits = vec![Outfit::Tight, Outfit::Loose, Outfit::Breeches, Outfit::Hoodie, Outfit::Hair];
        Self { frames: 24, size_px: 288, passes: [20, 16], batch: 3, outfits, surfaces: 3 }
    }
}

/// `standard`'s geometry stage with these passes, and no stage 2.
fn shortened(config: FitConfig, settings: &Settings) -> FitConfig {
    let mut config = comparable(config);
    let phases = &mut config.geometry.phases;
    assert_eq!(phases.len(), settings.passes.len(), "phases of standard's geometry");
    phases.iter_mut().zip(settings.passes).for_each(|(phase, passes)| phase.epochs = passes);
    config.texture.phases.clear();
    config.batch = settings.batch;
    config
}

/// Runs the study at this size; an error where its clip, the device or a fit fails.
pub fn run(context: &Context<'_>, settings: &Settings) -> Result<Report> {
    let methods = [
        ("RGB + silhouettes", shortened(FitConfig::standard(context.seed), settings)),
        ("silhouettes alone", shortened(FitConfig::silhouette_only(context.seed), settings)),
    ];
    let mut scores: Vec<[Summary; 2]> = Vec::new();
    let mut pictures = Vec::new();
    for (k, &outfit) in settings.outfits.iter().enumerate() {
        let (each, row) = subject(context, settings, outfit, context.seed + k as u64, &methods)?;
        scores.push(each);
        pictures.push(row);
    }
    let names: Vec<String> = settings.outfits.iter().map(|outfit| format!("{outfit:?}").to_lowercase()).collect();
    let [chamfer, p2s] = [chamfer_sum, point_to_surface].map(|value| [0, 1].map(|m| column(&scores, m, value)));
    let columns: Vec<(&str, usize)> = names.iter().map(|n| (n.as_str(), 2)).chain([("mean", 2)]).collect();
    let mut table = Table::new("Reconstruction error, cm", "metric, method", &columns);
    for (metric, values) in [("Chamfer", &chamfer), ("P2S", &p2s)] {
        for (m, (method, _)) in methods.iter().enumerate() {
            let mean = values[m].iter().sum::<f64>() / values[m].len() as f64;
            let row: Vec<f64> = values[m].iter().copied().chain([mean]).collect();
            table.row(format!("{metric}, {method}"), &row);
        }
    }
    let verdicts = vec![verdict("Chamfer", &chamfer, &names), verdict("P2S", &p2s, &names)];
    let caption =
        format!("From left to right: the truth, RGB and silhouettes, silhouettes alone. {}", names.join(", "));
    let Settings { frames, size_px, passes, .. } = settings;
    let note = format!(
        "{frames} frames of {size_px}², poses found from keypoints and masks; {passes:?} passes at half and at \
         full resolution."
    );
    // Persons beside each other in two rows, so that the folds can be seen.
    let rows: Vec<Vec<RgbImage>> = pictures.chunks(2).map(|pair| pair.concat()).collect();
    Ok(Report { tables: vec![table], figures: vec![(sheet(&rows), caption)], verdicts, notes: vec![note] })
}

/// Both fits of one person: scores, and pictures of the truth and both.
fn subject(
    context: &Context<'_>,
    settings: &Settings,
    outfit: Outfit,
    seed: u64,
    methods: &[(&str, FitConfig); 2],
) -> Result<([Summary; 2], Vec<RgbImage>)> {
    let Settings { frames, size_px, surfaces, .. } = *settings;
    let options = SynthOptions {
        frames,
        size_px,
        truths: surfaces,
        outfit,
        checked: true,
        side_light: 0.0,
        seed,
        ..SynthOptions::default()
    };
    let mut person = Person::new(context, &options)?;
    let truth = person.truth(false)?;
    let start = person.start(&methods[0].1)?;
    let (surface, frame) = person.first_surface(&truth)?;
    let mut pictures = vec![middle(&person.lit(&surface, &start.camera, SHOWN_PX)?, 0.6)];
    let mut scores = Vec::new();
    for (name, config) in methods {
        (context.say)(&format!("{outfit:?}: {name}"));
        let fitted = person.fit(config, &start)?;
        let avatar = person.avatar(&fitted, config);
        if let Some(mesh) = avatar.mesh(Some(avatar.nearest_frame(frame))) {
            pictures.push(middle(&person.lit(&mesh, &start.camera, SHOWN_PX)?, 0.6));
        }
        scores.push(person.evaluate(avatar, &truth)?.summary);
    }
    let [ours, hull] = <[Summary; 2]>::try_from(scores).expect("two methods");
    Ok(([ours, hull], pictures))
}

fn chamfer_sum(summary: &Summary) -> f64 {
    summary.chamfer_sum_cm.unwrap_or(f64::NAN)
}

fn point_to_surface(summary: &Summary) -> f64 {
    summary.point_to_surface_cm.unwrap_or(f64::NAN)
}

fn column(scores: &[[Summary; 2]], method: usize, value: fn(&Summary) -> f64) -> Vec<f64> {
    scores.iter().map(|s| value(&s[method])).collect()
}

fn verdict(metric: &str, values: &[Vec<f64>; 2], names: &[String]) -> Verdict {
    let better: Vec<&str> =
        names.iter().enumerate().filter(|(k, _)| values[0][*k] < values[1][*k]).map(|(_, n)| n.as_str()).collect();
    let sum = |m: usize| values[m].iter().sum::<f64>();
    let gain = 100.0 * (1.0 - sum(0) / sum(1));
    let evidence =
        format!("lower for {} of {}: {}; {gain:.0} % over all", better.len(), names.len(), better.join(", "));
    Verdict::new(format!("RGB lowers {metric} for every person"), better.len() == names.len(), evidence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn a_small_study_compares_both_for_each_person() {
        let Some(gpu) = gpu("study::silhouettes::a_small_study_compares_both_for_each_person") else { return };
        let work = tempfile::tempdir().unwrap();
        let context = Context::for_test(gpu, work.path());
        let outfits = vec![Outfit::Loose, Outfit::Hair];
        let settings = Settings { frames: 6, size_px: 96, passes: [3, 1], batch: 3, outfits, surfaces: 1 };
        let report = run(&context, &settings).unwrap();
        let table = &report.tables[0];
        assert_eq!((table.rows.len(), table.columns.len()), (4, 3));
        for row in &table.rows {
            let values: Vec<f64> = row.values.iter().map(|v| v.unwrap()).collect();
            assert!(values.iter().all(|v| (0.05..20.0).contains(v)), "{}: {values:?}", row.label);
            assert!((values[2] - 0.5 * (values[0] + values[1])).abs() < 1e-9);
        }
        assert_ne!(table.rows[0].values, table.rows[1].values, "the methods differ");
        assert_eq!(report.verdicts.len(), 2);
    }

    #[test]
    fn one_worse_person_breaks_the_claim() {
        let names = ["a".to_owned(), "b".to_owned()];
        assert!(verdict("P2S", &[vec![1.0, 2.0], vec![1.1, 2.1]], &names).holds);
        let broken = verdict("P2S", &[vec![1.0, 2.2], vec![1.1, 2.1]], &names);
        assert!(!broken.holds && broken.evidence.contains("1 of 2: a"), "{}", broken.evidence);
    }
}
