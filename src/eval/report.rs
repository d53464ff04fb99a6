//! What an evaluation found.

use super::geometry::{Distances, Similarity};

/// How alike two pictures are, or means over such pictures.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ImageFigures {
    /// On white, the whole picture.
    pub psnr_db: f64,
    pub ssim: f64,
    pub psnr_black_db: f64,
    pub ssim_black: f64,
    /// On white, the pixels of the truth's mask; absent where that is empty.
    pub psnr_foreground_db: Option<f64>,
    pub ssim_foreground: Option<f64>,
    /// On white: 0 is none, 1 the most.
    pub flip: f64,
    pub flip_foreground: Option<f64>,
    /// On white, by the network that was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

/// A held-out picture against ours.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ImageScore {
    pub name: String,
    #[serde(flatten)]
    pub figures: ImageFigures,
}

impl ImageFigures {
    /// Means; `None` without pictures.
    pub fn mean(rows: &[ImageScore]) -> Option<Self> {
        let some = |value: fn(&ImageFigures) -> Option<f64>| {
            let values: Vec<f64> = rows.iter().filter_map(|r| value(&r.figures)).collect();
            mean(&values, |v| *v)
        };
        Some(Self {
            psnr_db: mean(rows, |r| r.figures.psnr_db)?,
            ssim: mean(rows, |r| r.figures.ssim)?,
            psnr_black_db: mean(rows, |r| r.figures.psnr_black_db)?,
            ssim_black: mean(rows, |r| r.figures.ssim_black)?,
            psnr_foreground_db: some(|r| r.psnr_foreground_db),
            ssim_foreground: some(|r| r.ssim_foreground),
            flip: mean(rows, |r| r.figures.flip)?,
            flip_foreground: some(|r| r.flip_foreground),
            lpips: some(|r| r.lpips),
        })
    }
}

/// Intersection over union of a frame's mask and the avatar's there, 0 to 1.
#[derive(Clone, Debug, serde::Serialize)]
pub struct FrameIou {
    /// Frame of the video
    pub frame: u32,
    pub iou: f64,
}

/// A posed surface against the truth's.
#[derive(Clone, Debug, serde::Serialize)]
pub struct GeometryScore {
    pub frame: u32,
    pub aligned: Distances,
    pub unaligned: Distances,
    /// Of the alignment: truth over ours.
    pub scale: f64,
    /// About the camera, truth over ours: what pictures of it leave open.
    pub camera_scale: f64,
    #[serde(skip)]
    pub alignment: Similarity,
}

/// Mean distance of the 24 joints over the frames, as they are and with the pelvis joints laid on each other.
#[derive(Clone, Debug, serde::Serialize)]
pub struct JointScore {
    pub mean_cm: f64,
    pub root_aligned_cm: f64,
}

/// Means; absent where the folder has no such truth.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Summary {
    pub novel_views: Option<ImageFigures>,
    pub novel_poses: Option<ImageFigures>,
    /// As the two above, in our scale.
    pub scaled_novel_views: Option<ImageFigures>,
    pub scaled_novel_poses: Option<ImageFigures>,
    /// After the similarity of their frame's surface.
    pub aligned_novel_views: Option<ImageFigures>,
    /// In our scale, with poses that were refined on the very pictures.
    pub refined_novel_poses: Option<ImageFigures>,
    /// Truth over ours, about the camera.
    pub scale: Option<f64>,
    /// Truth over ours, of the surfaces alone.
    pub size: Option<f64>,
    pub mask_iou: Option<f64>,
    pub chamfer_cm: Option<f64>,
    pub chamfer_sum_cm: Option<f64>,
    pub point_to_surface_cm: Option<f64>,
    pub unaligned_chamfer_cm: Option<f64>,
    pub unaligned_point_to_surface_cm: Option<f64>,
    pub joints_cm: Option<f64>,
    pub joints_root_aligned_cm: Option<f64>,
}

/// An evaluation in full; docs/metrics.md defines every figure.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Report {
    pub summary: Summary,
    pub novel_views: Vec<ImageScore>,
    pub novel_poses: Vec<ImageScore>,
    /// As the two above, with places and cameras in our units.
    pub scaled_novel_views: Vec<ImageScore>,
    pub scaled_novel_poses: Vec<ImageScore>,
    /// As the first, with the avatar moved by the similarity of the frame's surface, where there is one.
    pub aligned_novel_views: Vec<ImageScore>,
    /// As the scaled ones, with poses refined against the frozen avatar; empty where that was not asked for.
    pub refined_novel_poses: Vec<ImageScore>,
    pub mask_iou: Vec<FrameIou>,
    pub geometry: Vec<GeometryScore>,
    pub joints: Option<JointScore>,
    /// What was compared otherwise than it should be, one line each.
    pub warnings: Vec<String>,
}

fn mean<T>(rows: &[T], value: impl Fn(&T) -> f64) -> Option<f64> {
    (!rows.is_empty()).then(|| rows.iter().map(value).sum::<f64>() / rows.len() as f64)
}

impl Report {
    /// Mean scale about the camera, truth over ours: one camera cannot tell a small person near from a tall one far.
    pub fn scale(&self) -> Option<f64> {
        mean(&self.geometry, |r| r.camera_scale)
    }

    /// Mean scale of the alignments, truth over ours: of the surfaces alone, wherever they stand.
    pub fn size(&self) -> Option<f64> {
        mean(&self.geometry, |r| r.scale)
    }

    /// Fills the means in from the rows.
    pub fn summarise(&mut self) {
        self.summary = Summary {
            novel_views: ImageFigures::mean(&self.novel_views),
            novel_poses: ImageFigures::mean(&self.novel_poses),
            scaled_novel_views: ImageFigures::mean(&self.scaled_novel_views),
            scaled_novel_poses: ImageFigures::mean(&self.scaled_novel_poses),
            aligned_novel_views: ImageFigures::mean(&self.aligned_novel_views),
            refined_novel_poses: ImageFigures::mean(&self.refined_novel_poses),
            scale: self.scale(),
            size: self.size(),
            mask_iou: mean(&self.mask_iou, |r| r.iou),
            chamfer_cm: mean(&self.geometry, |r| r.aligned.chamfer_cm),
            chamfer_sum_cm: mean(&self.geometry, |r| r.aligned.chamfer_sum_cm),
            point_to_surface_cm: mean(&self.geometry, |r| r.aligned.point_to_surface_cm),
            unaligned_chamfer_cm: mean(&self.geometry, |r| r.unaligned.chamfer_cm),
            unaligned_point_to_surface_cm: mean(&self.geometry, |r| r.unaligned.point_to_surface_cm),
            joints_cm: self.joints.as_ref().map(|j| j.mean_cm),
            joints_root_aligned_cm: self.joints.as_ref().map(|j| j.root_aligned_cm),
        };
    }

    /// The sets of pictures that were compared, with what they are and their rows.
    pub fn picture_sets(&self) -> [(&'static str, &[ImageScore]); 6] {
        [
            ("novel views", &self.novel_views),
            ("novel poses", &self.novel_poses),
            ("novel views, in our scale", &self.scaled_novel_views),
            ("novel poses, in our scale", &self.scaled_novel_poses),
            ("novel views, aligned", &self.aligned_novel_views),
            ("novel poses, refined", &self.refined_novel_poses),
        ]
    }

    /// Names and values with their units of what is no picture, where there was a truth to compare with.
    pub fn shape_rows(&self) -> Vec<(&'static str, String)> {
        let s = &self.summary;
        let rows = [
            ("truth over ours", s.scale, "", 4),
            ("truth over ours, of the surfaces alone", s.size, "", 4),
            ("training masks, IoU", s.mask_iou, "", 4),
            ("Chamfer, mean of both directions", s.chamfer_cm, "cm", 3),
            ("Chamfer, sum of both directions", s.chamfer_sum_cm, "cm", 3),
            ("point to surface", s.point_to_surface_cm, "cm", 3),
            ("unaligned: Chamfer, mean of both directions", s.unaligned_chamfer_cm, "cm", 3),
            ("unaligned: point to surface", s.unaligned_point_to_surface_cm, "cm", 3),
            ("joints, mean error", s.joints_cm, "cm", 2),
            ("joints, pelvis aligned", s.joints_root_aligned_cm, "cm", 2),
        ];
        let row = |(name, value, unit, digits): (_, Option<f64>, _, usize)| {
            Some((name, format!("{:.digits$} {unit}", value?).trim_end().to_owned()))
        };
        rows.into_iter().filter_map(row).collect()
    }

    /// Names and means of the sets of pictures that there are: PSNR and SSIM on white, on black and of the foreground, FLIP
    /// of the picture and of the foreground, LPIPS.
    pub fn picture_rows(&self) -> Vec<(&'static str, [Option<f64>; 9])> {
        let means = self.picture_sets().into_iter().filter_map(|(name, rows)| Some((name, ImageFigures::mean(rows)?)));
        let row = |m: ImageFigures| {
            let on_colours = [m.psnr_db, m.ssim, m.psnr_black_db, m.ssim_black].map(Some);
            let [a, b, c, d] = on_colours;
            [a, b, c, d, m.psnr_foreground_db, m.ssim_foreground, Some(m.flip), m.flip_foreground, m.lpips]
        };
        means.map(|(name, means)| (name, row(means))).collect()
    }

    /// The means as a table for people.
    pub fn table(&self) -> String {
        let mut text = String::new();
        if !self.picture_rows().is_empty() {
            let heads = ["on white", "on black", "foreground", "FLIP"];
            let [a, b, c, d] = heads;
            text += &format!("{:<28}{a:>17}{b:>17}{c:>17}{d:>17}\n", "pictures: PSNR in dB, SSIM");
        }
        for (name, values) in self.picture_rows() {
            let cell = |k: usize, digits: usize| values[k].map_or("—".to_owned(), |v| format!("{v:.digits$}"));
            text += &format!("  {name:<26}");
            for k in [0, 2, 4] {
                text += &format!("{:>17}", format!("{} {}", cell(k, 2), cell(k + 1, 4)));
            }
            text += &format!("{:>17}", format!("{} {}", cell(6, 4), cell(7, 4)));
            text += &values[8].map_or(String::new(), |v| format!("   LPIPS {v:.4}"));
            text.push('\n');
        }
        for (name, value) in self.shape_rows() {
            text += &format!("{name:<50} {value:>12}\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_rows_of_what_there_was_to_compare_with() {
        let summary = Summary { mask_iou: Some(0.98765), joints_cm: Some(2.0), ..Summary::default() };
        let table = Report { summary, ..Report::default() }.table();
        let rows: Vec<Vec<&str>> = table.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows, [vec!["training", "masks,", "IoU", "0.9877"], vec!["joints,", "mean", "error", "2.00", "cm"]]);
    }
}
