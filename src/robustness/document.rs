//! docs/robustness.md and docs/filming.md with their pictures.

use std::fmt::Write;

use anyhow::Result;
use image::{Rgb, RgbImage};

use super::cases::Case;
use super::run::{Outcome, Settings, Status};
use crate::page::strip;

/// Decibels that a single perturbation may cost.
const ALLOWED_DB: f64 = 3.0;
/// Cases a row of the picture.
const COLUMNS: usize = 3;

/// What a page compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comparison {
    /// One clip, spoiled.
    Spoiled,
    /// Clips made in other ways.
    Filmed,
}

impl Comparison {
    /// Of the page's file, and of its pictures' folder.
    pub fn name(self) -> &'static str {
        match self {
            Comparison::Spoiled => "robustness",
            Comparison::Filmed => "filming",
        }
    }

    fn title(self) -> &'static str {
        match self {
            Comparison::Spoiled => "What spoiled clips come to",
            Comparison::Filmed => "What clips come to that are filmed in other ways",
        }
    }

    fn method(self, settings: &Settings) -> String {
        let preset = &settings.preset;
        match self {
            Comparison::Spoiled => {
                let clip = settings.clip.file_name().unwrap_or_default().to_string_lossy();
                format!(
                    "The clip `{clip}` was spoiled in one way at a time, or in several where a row says so, fitted with \
                     `{preset}`, and compared with the unspoiled truth."
                )
            }
            Comparison::Filmed => format!(
                "Made persons (`effigy synth`), filmed and turning in one other way at a time, fitted with `{preset}`, each \
                 compared with its own truth. Pictures of other sizes and other people are not as hard, so a change of PSNR \
                 is partly theirs."
            ),
        }
    }
}

/// What a row comes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Holds,
    /// Worse, and the report says why.
    Said,
    /// Worse, and nothing says so.
    Silent,
    Refused,
    Crashed,
    /// No picture of it or of the first row to compare
    Uncompared,
}

impl Verdict {
    fn of(outcome: &Outcome, clean: &Outcome) -> Self {
        match outcome.status {
            Status::Crashed(_) => return Verdict::Crashed,
            Status::Refused(_) => return Verdict::Refused,
            Status::Fitted => {}
        }
        let Some(drop) = worst_drop(outcome, clean) else { return Verdict::Uncompared };
        if drop <= ALLOWED_DB {
            Verdict::Holds
        } else if new_flags(outcome, clean).is_empty() {
            Verdict::Silent
        } else {
            Verdict::Said
        }
    }

    fn text(self) -> &'static str {
        match self {
            Verdict::Holds => "holds",
            Verdict::Said => "worse, flagged",
            Verdict::Silent => "**worse, not flagged**",
            Verdict::Refused => "refused",
            Verdict::Crashed => "**crashed**",
            Verdict::Uncompared => "not compared",
        }
    }
}

/// The larger loss of novel views and poses against the clean clip.
fn worst_drop(outcome: &Outcome, clean: &Outcome) -> Option<f64> {
    let drops = [(clean.views_db, outcome.views_db), (clean.poses_db, outcome.poses_db)];
    drops.into_iter().filter_map(|(clean, ours)| Some(clean? - ours?)).reduce(f64::max)
}

/// Flags that the clean clip has not.
fn new_flags<'a>(outcome: &'a Outcome, clean: &Outcome) -> Vec<&'a str> {
    outcome.flags.iter().filter(|flag| !clean.flags.contains(flag)).map(String::as_str).collect()
}

/// The page. `rows` are cases with their outcomes, the one that they are compared with first.
///
/// # Panics
/// Without rows.
pub fn document(
    comparison: Comparison,
    settings: &Settings,
    command: &str,
    device: &str,
    rows: &[(&Case, Outcome)],
) -> String {
    let clean = &rows[0].1;
    let mut text = format!(
        "# {}\n\nWritten by `{command}` on {device}.\n\n{} PSNR is of held-out pictures on white in our scale (*aligned*: views of the avatar after its surface was laid onto the truth's, so without errors of place and focal length), \
         Chamfer the mean of both directions after alignment ([definitions](metrics.md)); in brackets the change against the \
         first row. A case *holds* where neither PSNR falls by more than {ALLOWED_DB:.0} dB. Otherwise the report should say \
         what was wrong: the flags ([what they mean](quality.md)) are those that the first row does not raise",
        comparison.title(),
        comparison.method(settings)
    );
    text += &match &clean.flags[..] {
        [] => " (it raises none).\n\n".to_owned(),
        flags => format!(" (it raises `{}`).\n\n", flags.join("`, `")),
    };
    text += "| | case | novel views, dB | aligned, dB | novel poses, dB | Chamfer, cm | joints, cm | flags | |\n|-:|---|-:|-:|-:|-:|-:|---|---|\n";
    for (i, (case, outcome)) in rows.iter().enumerate() {
        let figures = [
            with_change(outcome.views_db, clean.views_db, 2, i > 0),
            with_change(outcome.aligned_views_db, clean.aligned_views_db, 2, i > 0),
            with_change(outcome.poses_db, clean.poses_db, 2, i > 0),
            with_change(outcome.chamfer_cm, clean.chamfer_cm, 3, i > 0),
            with_change(outcome.joints_cm, clean.joints_cm, 2, i > 0),
        ];
        let flags: Vec<String> = new_flags(outcome, clean).iter().map(|flag| format!("`{flag}`")).collect();
        let verdict = Verdict::of(outcome, clean);
        let mut last = if i == 0 { String::new() } else { verdict.text().to_owned() };
        if let Status::Refused(why) | Status::Crashed(why) = &outcome.status {
            let _ = write!(last, ": {}", why.replace('|', "\\|"));
        }
        let (what, flags) = (case.what, flags.join(" "));
        let _ = writeln!(text, "| {} | {what} | {} | {flags} | {last} |", i + 1, figures.join(" | "));
    }
    let count = |wanted: Verdict| rows[1..].iter().filter(|(_, o)| Verdict::of(o, clean) == wanted).count();
    let [holds, said, silent, refused, crashed] =
        [Verdict::Holds, Verdict::Said, Verdict::Silent, Verdict::Refused, Verdict::Crashed].map(count);
    let uncompared = match count(Verdict::Uncompared) {
        0 => String::new(),
        n => format!(", {n} not compared"),
    };
    let _ = write!(
        text,
        "\nOf {} others {holds} hold, {said} are worse and flagged, {silent} worse and not flagged, {refused} refused, \
         {crashed} crashed{uncompared}.\n",
        rows.len() - 1
    );
    let _ = write!(text, "\n![each case: input, a held-out view, a held-out pose]({}/cases.jpg)\n", comparison.name());
    text += "\nThe cases in the order of the \
             table, three a row, each with its first frame as the fit sees it (dark outside the mask), a held-out view and a \
             held-out pose of the avatar.\n";
    text
}

fn with_change(value: Option<f64>, clean: Option<f64>, digits: usize, change: bool) -> String {
    match (value, clean) {
        (Some(value), Some(clean)) if change => format!("{value:.digits$} ({:+.digits$})", value - clean),
        (Some(value), _) => format!("{value:.digits$}"),
        (None, _) => "–".to_owned(),
    }
}

/// The pieces of all cases on one sheet; an empty place where a case has no avatar.
///
/// # Errors
/// Where a piece cannot be read.
pub fn sheet(settings: &Settings, rows: &[(&Case, Outcome)]) -> Result<RgbImage> {
    let mut pieces = Vec::new();
    for (case, outcome) in rows {
        let path = settings.work.join(case.name).join("piece.png");
        let piece = match outcome.status {
            Status::Fitted => image::open(&path)?.into_rgb8(),
            _ => RgbImage::from_pixel(3, 1, Rgb([255; 3])),
        };
        pieces.push(piece);
    }
    let (width, height) = pieces.iter().fold((1, 1), |(w, h), p| (w.max(p.width()), h.max(p.height())));
    let place = |piece: &RgbImage| {
        let mut place = RgbImage::from_pixel(width, height, Rgb([255; 3]));
        image::imageops::replace(&mut place, piece, 0, 0);
        place
    };
    let lines: Vec<RgbImage> =
        pieces.chunks(COLUMNS).map(|row| strip(&row.iter().map(place).collect::<Vec<_>>(), 14, [255; 3])).collect();
    let sheet_width = lines.iter().map(RgbImage::width).max().unwrap_or(1);
    let mut sheet = RgbImage::from_pixel(sheet_width, (height + 10) * lines.len() as u32, Rgb([255; 3]));
    for (i, line) in lines.iter().enumerate() {
        image::imageops::replace(&mut sheet, line, 0, i as i64 * i64::from(height + 10));
    }
    Ok(sheet)
}

#[cfg(test)]
mod tests {
    use super::super::cases::CASES;
    use super::*;

    fn outcome(case: &str, views: f64, flags: &[&str]) -> Outcome {
        Outcome {
            case: case.to_owned(),
            status: Status::Fitted,
            views_db: Some(views),
            aligned_views_db: Some(30.0),
            poses_db: Some(25.0),
            chamfer_cm: Some(0.5),
            joints_cm: None,
            flags: flags.iter().map(|f| (*f).to_owned()).collect(),
            secs: 1.0,
        }
    }

    #[test]
    fn rows_tell_what_holds_and_what_was_said() {
        let refused = Outcome {
            status: Status::Refused("masks: frame 3".to_owned()),
            views_db: None,
            aligned_views_db: None,
            poses_db: None,
            chamfer_cm: None,
            ..outcome("d", 0.0, &[])
        };
        let outcomes = [
            outcome("clean", 28.0, &["few_frames"]),
            outcome("a", 25.5, &["few_frames"]),
            outcome("b", 24.0, &["few_frames", "blurred_clip"]),
            outcome("c", 24.0, &["few_frames"]),
            refused,
        ];
        let rows: Vec<(&Case, Outcome)> = CASES.iter().zip(outcomes).collect();
        let settings = Settings {
            clip: "data/subject".into(),
            work: "work".into(),
            effigy: "effigy".into(),
            preset: "draft".to_owned(),
            body: "test".to_owned(),
            max_frames: None,
            seed: 0,
            truths: 4,
        };
        let page = document(Comparison::Spoiled, &settings, "effigy robustness data/subject", "a device", &rows);
        for part in [
            "it raises `few_frames`",
            "| 1 | the clip as it is | 28.00 | 30.00 | 25.00 | 0.500 | – |  |  |",
            "25.50 (-2.50) | 30.00 (+0.00) | 25.00 (+0.00) | 0.500 (+0.000) | – |  | holds |",
            "| `blurred_clip` | worse, flagged |",
            "|  | **worse, not flagged** |",
            "refused: masks: frame 3 |",
            "Of 4 others 1 hold, 1 are worse and flagged, 1 worse and not flagged, 1 refused, 0 crashed.",
        ] {
            assert!(page.contains(part), "`{part}` is not in\n{page}");
        }
    }

    #[test]
    fn nothing_holds_where_nothing_was_compared() {
        let refused =
            Outcome { status: Status::Refused("no".to_owned()), views_db: None, ..outcome("clean", 0.0, &[]) };
        let refused = Outcome { poses_db: None, ..refused };
        assert_eq!(Verdict::of(&outcome("a", 28.0, &[]), &refused), Verdict::Uncompared);
        assert_eq!(Verdict::of(&refused, &outcome("clean", 28.0, &[])), Verdict::Refused);
    }
}
