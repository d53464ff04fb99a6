//! What an evaluation found.

use super::geometry::Distances;

/// A held-out picture on white.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ImageScore {
    pub name: String,
    pub psnr_db: f64,
    pub ssim: f64,
}

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
    pub novel_view_psnr_db: Option<f64>,
    pub novel_view_ssim: Option<f64>,
    pub novel_pose_psnr_db: Option<f64>,
    pub novel_pose_ssim: Option<f64>,
    pub scaled_novel_view_psnr_db: Option<f64>,
    pub scaled_novel_view_ssim: Option<f64>,
    pub scaled_novel_pose_psnr_db: Option<f64>,
    pub scaled_novel_pose_ssim: Option<f64>,
    /// Truth over ours.
    pub scale: Option<f64>,
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
    /// Mean scale of the alignments, truth over ours: one camera cannot tell a small person near from a tall one far.
    pub fn scale(&self) -> Option<f64> {
        mean(&self.geometry, |r| r.scale)
    }

    /// Fills the means in from the rows.
    pub fn summarise(&mut self) {
        self.summary = Summary {
            novel_view_psnr_db: mean(&self.novel_views, |r| r.psnr_db),
            novel_view_ssim: mean(&self.novel_views, |r| r.ssim),
            novel_pose_psnr_db: mean(&self.novel_poses, |r| r.psnr_db),
            novel_pose_ssim: mean(&self.novel_poses, |r| r.ssim),
            scaled_novel_view_psnr_db: mean(&self.scaled_novel_views, |r| r.psnr_db),
            scaled_novel_view_ssim: mean(&self.scaled_novel_views, |r| r.ssim),
            scaled_novel_pose_psnr_db: mean(&self.scaled_novel_poses, |r| r.psnr_db),
            scaled_novel_pose_ssim: mean(&self.scaled_novel_poses, |r| r.ssim),
            scale: self.scale(),
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

    /// The means as a table for people.
    pub fn table(&self) -> String {
        let s = &self.summary;
        let rows = [
            ("novel views   PSNR on white", s.novel_view_psnr_db, "dB", 2),
            ("              SSIM", s.novel_view_ssim, "", 4),
            ("novel poses   PSNR on white", s.novel_pose_psnr_db, "dB", 2),
            ("              SSIM", s.novel_pose_ssim, "", 4),
            ("  in our scale  novel views   PSNR on white", s.scaled_novel_view_psnr_db, "dB", 2),
            ("                              SSIM", s.scaled_novel_view_ssim, "", 4),
            ("                novel poses   PSNR on white", s.scaled_novel_pose_psnr_db, "dB", 2),
            ("                              SSIM", s.scaled_novel_pose_ssim, "", 4),
            ("                truth over ours", s.scale, "", 4),
            ("training masks  IoU", s.mask_iou, "", 4),
            ("surface       Chamfer (mean of both directions)", s.chamfer_cm, "cm", 3),
            ("              Chamfer (sum of both directions)", s.chamfer_sum_cm, "cm", 3),
            ("              point to surface", s.point_to_surface_cm, "cm", 3),
            ("  unaligned   Chamfer (mean of both directions)", s.unaligned_chamfer_cm, "cm", 3),
            ("              point to surface", s.unaligned_point_to_surface_cm, "cm", 3),
            ("joints        mean error", s.joints_cm, "cm", 2),
            ("              pelvis aligned", s.joints_root_aligned_cm, "cm", 2),
        ];
        let mut text = String::new();
        for (name, value, unit, digits) in rows {
            let value = value.map_or("—".to_owned(), |v| format!("{v:.digits$} {unit}"));
            text += &format!("{name:<50} {:>12}\n", value.trim_end());
        }
        text
    }
}
