//! The flags: codes that stay, and advice.

use serde::Serialize;

/// Everything that can be flagged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    KeypointsOffMask,
    FewKeypoints,
    KeypointsNoisy,
    CutByBorder,
    Blurred,
    MaskFlickers,
    MaskEdgeOff,
    SecondBlob,
    SidesSwapped,
    FitMisses,
    NoFullTurn,
    FewFrames,
    BlurredClip,
    LowResolution,
    NearCamera,
    FocalEstimated,
    FocalSuspicious,
    FocalContradicted,
    PosesContradicted,
    HeightUnusual,
    ExposureChanges,
    ClothBetweenLegs,
    Spikes,
    FlippedFaces,
    UnseenArea,
}

/// In the order in which reports show them.
pub const KINDS: [Kind; 25] = [
    Kind::NoFullTurn,
    Kind::FewFrames,
    Kind::LowResolution,
    Kind::BlurredClip,
    Kind::NearCamera,
    Kind::FocalEstimated,
    Kind::FocalSuspicious,
    Kind::FocalContradicted,
    Kind::PosesContradicted,
    Kind::HeightUnusual,
    Kind::ExposureChanges,
    Kind::KeypointsOffMask,
    Kind::FewKeypoints,
    Kind::KeypointsNoisy,
    Kind::SidesSwapped,
    Kind::CutByBorder,
    Kind::MaskEdgeOff,
    Kind::SecondBlob,
    Kind::MaskFlickers,
    Kind::Blurred,
    Kind::FitMisses,
    Kind::ClothBetweenLegs,
    Kind::Spikes,
    Kind::FlippedFaces,
    Kind::UnseenArea,
];

impl Kind {
    /// Never changes once published.
    pub fn code(self) -> &'static str {
        match self {
            Kind::KeypointsOffMask => "keypoints_off_mask",
            Kind::FewKeypoints => "few_keypoints",
            Kind::KeypointsNoisy => "keypoints_noisy",
            Kind::CutByBorder => "cut_by_border",
            Kind::Blurred => "blurred",
            Kind::MaskFlickers => "mask_flickers",
            Kind::MaskEdgeOff => "mask_edge_off",
            Kind::SecondBlob => "second_blob",
            Kind::SidesSwapped => "sides_swapped",
            Kind::FitMisses => "fit_misses",
            Kind::NoFullTurn => "no_full_turn",
            Kind::FewFrames => "few_frames",
            Kind::BlurredClip => "blurred_clip",
            Kind::LowResolution => "low_resolution",
            Kind::NearCamera => "near_camera",
            Kind::FocalEstimated => "focal_estimated",
            Kind::FocalSuspicious => "focal_suspicious",
            Kind::FocalContradicted => "focal_contradicted",
            Kind::PosesContradicted => "poses_contradicted",
            Kind::HeightUnusual => "height_unusual",
            Kind::ExposureChanges => "exposure_changes",
            Kind::ClothBetweenLegs => "cloth_between_legs",
            Kind::Spikes => "spikes",
            Kind::FlippedFaces => "flipped_faces",
            Kind::UnseenArea => "unseen_area",
        }
    }

    /// What `value` and `limit` count.
    pub fn unit(self) -> &'static str {
        match self {
            Kind::KeypointsOffMask => "points in the worst frame",
            Kind::FewKeypoints => "points of limbs in the worst frame",
            Kind::KeypointsNoisy => "of the person's height, median over the frames",
            Kind::CutByBorder => "px along the border in the worst frame",
            Kind::Blurred => "sharpness over the clip's median, worst frame",
            Kind::MaskFlickers => "jump of the mask's area, worst frame",
            Kind::MaskEdgeOff => "px from the masks' edge outwards to the person's, median",
            Kind::SecondBlob => "of the person's area, worst frame",
            Kind::SidesSwapped => "of the frames",
            Kind::FitMisses => "IoU in the worst frame",
            Kind::NoFullTurn => "degrees",
            Kind::FewFrames => "frames",
            Kind::BlurredClip => "sharpness, median",
            Kind::LowResolution => "px of the person's height, median",
            Kind::NearCamera => "of the person's height, from camera to pelvis, median",
            Kind::FocalEstimated => "px",
            Kind::FocalSuspicious => "degrees along the longer side",
            Kind::FocalContradicted => "focal length that the clip tells, over the given one",
            Kind::PosesContradicted => "degrees that joints are off in a frame",
            Kind::HeightUnusual => "metres, undressed",
            Kind::ExposureChanges => "brightest over darkest frame",
            Kind::ClothBetweenLegs => "of the way from hip to ankle, where its hem is",
            Kind::Spikes => "vertices",
            Kind::FlippedFaces | Kind::UnseenArea => "of the surface",
        }
    }

    /// What a user does about it, one sentence.
    pub fn advice(self) -> &'static str {
        match self {
            Kind::KeypointsOffMask => {
                "Film one person alone, and make masks and keypoints from the very same frames; points that lie outside \
                 are little believed."
            }
            Kind::FewKeypoints => "Keep the whole body in view, evenly lit and apart from the background.",
            Kind::KeypointsNoisy => {
                "Use a detector that is more exact, or let it see larger pictures: poses and the places of joints come out worse."
            }
            Kind::CutByBorder => "Step back until head, hands and feet stay inside the picture during the whole turn.",
            Kind::Blurred => "Turn more slowly and film in more light, so that single frames are not smeared.",
            Kind::MaskFlickers => {
                "Use a segmentation that is steady over time, and a floor without a hard shadow of the person."
            }
            Kind::MaskEdgeOff => {
                "Make masks that end where the person does; these were moved all round, which rounds fingers and hair."
            }
            Kind::SecondBlob => "Remove everything from the masks that is not the person.",
            Kind::SidesSwapped => {
                "Nothing is to be done where the report looks right: left and right were exchanged back in these frames; \
                 a detector that sees backs better helps."
            }
            Kind::FitMisses => {
                "Look at these frames in the report: a mask that takes in background, or a pose that moves too fast, is \
                 the usual reason."
            }
            Kind::NoFullTurn => "Turn once all the way round: sides that no frame shows are guessed.",
            Kind::FewFrames => "Film the turn for two seconds or longer, or allow more frames.",
            Kind::BlurredClip => {
                "Lock the focus on the person, clean the lens and film in more light or with more bits."
            }
            Kind::LowResolution => {
                "Come nearer or film in a higher resolution, upright, so that the person fills the picture."
            }
            Kind::NearCamera => {
                "Step back and zoom in: from close by, feet and crown are seen at a slant, which tells less of poses and \
                 proportions."
            }
            Kind::FocalEstimated => "Give the camera's focal length: from a guess, size and distance are less exact.",
            Kind::FocalSuspicious => {
                "Check the focal length, or give it where none came with the clip: it belongs to the size of these very \
                 images, in pixels, and no phone is known for such a view."
            }
            Kind::FocalContradicted => {
                "Check the focal length: it belongs to the size of these very images, in pixels. One that the clip contradicts \
                 is replaced by the one that the clip tells, unless the job's options say `trust_camera`."
            }
            Kind::PosesContradicted => {
                "Leave the poses out where the person stands and turns: better ones are found without them. Worth giving are those of motion \
                 capture, or of a fit that has seen the whole clip."
            }
            Kind::HeightUnusual => {
                "Give the person's height (`height_m`): one camera cannot measure it, and with it the body's proportions come out \
                 better, too."
            }
            Kind::ExposureChanges => {
                "Lock exposure and white balance before filming (on many phones by a long touch on the person), and keep the light as it is."
            }
            Kind::ClothBetweenLegs => {
                "Nothing is to be done where poses look right: the legs alone carry this cloth, and how it falls when they part \
                 is a guess."
            }
            Kind::Spikes => "Look at the mesh: vertices stick out where masks or poses contradict each other.",
            Kind::FlippedFaces => {
                "Look at the mesh: the surface folds over itself where masks or poses contradict each other."
            }
            Kind::UnseenArea => {
                "Film with the arms away from the body and turn all the way: what no frame shows is filled in."
            }
        }
    }
}

/// One finding.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Flag {
    pub code: &'static str,
    /// What was found, for people.
    pub message: String,
    /// Frames of the video, ascending; empty where it is about the whole clip.
    pub frames: Vec<u32>,
    pub value: f64,
    /// What `value` was held against.
    pub limit: f64,
    pub unit: &'static str,
    pub advice: &'static str,
}

impl Flag {
    /// A flag about the whole clip.
    pub fn of_clip(kind: Kind, message: String, value: f64, limit: f64) -> Self {
        Self::of_frames(kind, message, Vec::new(), value, limit)
    }

    pub fn of_frames(kind: Kind, message: String, frames: Vec<u32>, value: f64, limit: f64) -> Self {
        Self { code: kind.code(), message, frames, value, limit, unit: kind.unit(), advice: kind.advice() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_is_documented_once() {
        let page = include_str!("../../docs/quality.md");
        for kind in KINDS {
            let row = format!("| `{}` |", kind.code());
            assert_eq!(page.matches(&row).count(), 1, "docs/quality.md: {row}");
        }
    }
}
