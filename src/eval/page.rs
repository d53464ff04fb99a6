//! `eval.html`: an evaluation to be looked at, the worst first.

use super::report::{ImageScore, Report};
use super::shot::Shot;
use crate::page::{Page, inline_jpeg, shrunk};

/// Which pictures are compared, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Set {
    /// As the folder has them.
    Plain,
    /// With places and cameras in our units.
    Scaled,
    /// With our surface of the frame laid onto the truth's.
    Aligned,
    /// Scaled, and with refined poses.
    Refined,
}

impl Set {
    /// Below the folder of an evaluation.
    pub fn folder(self) -> &'static str {
        match self {
            Set::Plain => "",
            Set::Scaled => "scaled",
            Set::Aligned => "aligned",
            Set::Refined => "refined",
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Set::Plain => "as given:",
            Set::Scaled => "in our scale:",
            Set::Aligned => "aligned:",
            Set::Refined => "refined:",
        }
    }
}

/// Longest side of a card, four pictures wide.
const CARD_PX: u32 = 1100;
/// Rows of the tables of frames.
const WORST: usize = 10;

/// Pictures for the page.
#[derive(Default)]
pub(super) struct Cards {
    cards: Vec<(Set, ImageScore, String)>,
}

impl Cards {
    pub fn add(&mut self, set: Set, score: &ImageScore, shot: &Shot) {
        let html = inline_jpeg(&shrunk(&shot.card(), CARD_PX), 85, "truth, ours, outlines, FLIP");
        self.cards.push((set, score.clone(), html));
    }
}

/// The page of a finished report.
pub(super) fn html(report: &Report, cards: &Cards) -> String {
    let mut page = Page::new("Evaluation");
    let shown: Vec<_> = report.shape_rows().into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    page.figures(&shown);
    page.heading("Pictures, means");
    let head = [
        "",
        "PSNR, white",
        "SSIM, white",
        "PSNR, black",
        "SSIM, black",
        "PSNR, foreground",
        "SSIM, foreground",
        "FLIP",
        "FLIP, foreground",
        "LPIPS",
    ];
    page.table(&head, &means(report));
    for warning in &report.warnings {
        page.note("Compared otherwise than it should be:", warning, "");
    }
    pictures(&mut page, cards);
    frames(&mut page, report);
    page.paragraph("docs/metrics.md defines every figure.");
    page.finish()
}

fn means(report: &Report) -> Vec<Vec<String>> {
    let digits = [2, 4, 2, 4, 2, 4, 4, 4, 4];
    let row = |(name, values): (&str, [Option<f64>; 9])| {
        let cells = values.iter().zip(digits).map(|(v, d)| v.map_or("—".to_owned(), |v| format!("{v:.d$}")));
        std::iter::once(name.to_owned()).chain(cells).collect()
    };
    report.picture_rows().into_iter().map(row).collect()
}

/// All pictures, those of the last ways of comparing first: they tell most of the avatar itself.
fn pictures(page: &mut Page, cards: &Cards) {
    for (set, title) in [
        (Set::Refined, "Novel poses, refined on their pictures"),
        (Set::Aligned, "Novel views, aligned with the frame's surface"),
        (Set::Scaled, "In our scale"),
        (Set::Plain, "As given"),
    ] {
        let mut of_set: Vec<_> = cards.cards.iter().filter(|(s, ..)| *s == set).collect();
        if of_set.is_empty() {
            continue;
        }
        of_set.sort_by(|a, b| a.1.figures.psnr_db.total_cmp(&b.1.figures.psnr_db));
        page.heading(title);
        page.paragraph(
            "Worst first. Truth, ours, where only one of them is (blue: truth, red: ours), and FLIP from dark (0) to light (1).",
        );
        let figures = of_set.iter().map(|(_, s, html)| {
            let f = &s.figures;
            let foreground = f.psnr_foreground_db.map_or("—".to_owned(), |v| format!("{v:.1}"));
            let caption = format!(
                "{}: PSNR {:.1} dB, foreground {foreground} dB, SSIM {:.3}, FLIP {:.3}",
                s.name, f.psnr_db, f.ssim, f.flip
            );
            (html.clone(), caption)
        });
        page.figure_row(&figures.collect::<Vec<_>>());
    }
}

fn frames(page: &mut Page, report: &Report) {
    let mut masks: Vec<_> = report.mask_iou.iter().collect();
    masks.sort_by(|a, b| a.iou.total_cmp(&b.iou));
    if !masks.is_empty() {
        page.heading("Training masks, worst first");
        let rows = masks.iter().take(WORST).map(|m| vec![m.frame.to_string(), format!("{:.4}", m.iou)]);
        page.table(&["frame", "IoU"], &rows.collect::<Vec<_>>());
    }
    let mut surfaces: Vec<_> = report.geometry.iter().collect();
    surfaces.sort_by(|a, b| b.aligned.point_to_surface_cm.total_cmp(&a.aligned.point_to_surface_cm));
    if !surfaces.is_empty() {
        page.heading("Surfaces, worst first");
        let row = |g: &&super::report::GeometryScore| {
            let numbers = [
                g.aligned.point_to_surface_cm,
                g.aligned.chamfer_cm,
                g.unaligned.point_to_surface_cm,
                g.unaligned.chamfer_cm,
                g.camera_scale,
            ];
            std::iter::once(g.frame.to_string()).chain(numbers.iter().map(|v| format!("{v:.3}"))).collect()
        };
        let head = [
            "frame",
            "point to surface, cm",
            "Chamfer, cm",
            "unaligned: point to surface, cm",
            "Chamfer, cm",
            "truth over ours",
        ];
        page.table(&head, &surfaces.iter().take(WORST).map(row).collect::<Vec<_>>());
    }
}
