//! The perturbations, one at a time, and some of them at once.

use rand_pcg::Pcg64;

use super::footage::Footage;
use super::{hand, images, keypoints, masks};

/// A way to spoil a clip.
pub struct Case {
    /// On the command line and of folders.
    pub name: &'static str,
    /// For people.
    pub what: &'static str,
    pub spoil: fn(&mut Footage, &mut Pcg64),
}

/// The clean clip first: all others are compared with it.
pub const CASES: [Case; 23] = [
    Case { name: "clean", what: "the clip as it is", spoil: |_, _| {} },
    Case { name: "focal-unknown", what: "no camera given", spoil: |f, _| f.camera = None },
    Case { name: "focal-long", what: "focal length 30 % too long", spoil: |f, _| scale_focal(f, 1.3) },
    Case { name: "focal-short", what: "focal length 30 % too short", spoil: |f, _| scale_focal(f, 0.7) },
    Case { name: "turn-270", what: "three quarters of a turn", spoil: |f, _| f.shorten(f.frames.len() * 3 / 4) },
    Case { name: "frames-8", what: "8 frames", spoil: |f, _| f.max_frames = Some(8) },
    Case { name: "masks-holes", what: "masks: three holes in each", spoil: masks::holes },
    Case { name: "masks-hand", what: "masks: no left hand", spoil: masks::missing_hand },
    Case { name: "masks-eroded", what: "masks: 3 px smaller all round", spoil: masks::eroded },
    Case { name: "masks-dilated", what: "masks: 3 px larger all round", spoil: masks::dilated },
    Case { name: "masks-shadow", what: "masks: a shadow at the feet in 2 of 5 frames", spoil: masks::shadow },
    Case { name: "masks-blob", what: "masks: a second part beside the person", spoil: masks::second_blob },
    Case {
        name: "keypoints-noise",
        what: "keypoints: noise of σ = 6 px",
        spoil: |f, rng| keypoints::noisy(f, 6.0, rng),
    },
    Case { name: "keypoints-dropped", what: "keypoints: a fifth missing", spoil: keypoints::dropped },
    Case {
        name: "keypoints-swapped",
        what: "keypoints: left and right exchanged in back views",
        spoil: keypoints::swapped_backs,
    },
    Case {
        name: "keypoints-person",
        what: "keypoints: of somebody else in a quarter of the frames",
        spoil: keypoints::second_person,
    },
    Case { name: "motion-blur", what: "pictures smeared over 9 px", spoil: images::motion_blur },
    Case { name: "compressed", what: "video of 500 kbit/s, 4:2:0", spoil: |f, _| f.bit_rate = Some(500) },
    Case { name: "feet-cut", what: "a tenth of the person cut off below", spoil: images::feet_cut },
    Case { name: "head-cut", what: "a tenth of the person cut off above", spoil: images::head_cut },
    Case { name: "gains", what: "light changes by up to a fifth from frame to frame", spoil: images::gains },
    Case { name: "shaken", what: "a camera held in the hand, which sways and trembles", spoil: hand::shaken },
    Case {
        name: "several",
        what: "several at once: no camera given, held in the hand, light that changes, 1,500 kbit/s, masks 3 px larger with \
               shadows at the feet, keypoints of σ = 2 px and a fifth missing",
        spoil: several,
    },
];

fn scale_focal(footage: &mut Footage, factor: f64) {
    if let Some(camera) = &mut footage.camera {
        (camera.fx, camera.fy) = (camera.fx * factor, camera.fy * factor);
    }
}

/// What a phone, a matting network and a detector do at once.
fn several(footage: &mut Footage, rng: &mut Pcg64) {
    hand::shaken(footage, rng);
    images::gains(footage, rng);
    masks::shadow(footage, rng);
    masks::dilated(footage, rng);
    keypoints::noisy(footage, 2.0, rng);
    keypoints::dropped(footage, rng);
    footage.camera = None;
    footage.bit_rate = Some(1500);
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::super::footage::testing::footage;
    use super::*;

    #[test]
    fn every_case_but_the_first_spoils_something() {
        let clean = footage();
        let state = |f: &Footage| {
            (f.frames.clone(), f.masks.clone(), f.keypoints.clone(), f.camera.clone(), f.bit_rate, f.max_frames)
        };
        let mut names = std::collections::BTreeSet::new();
        for (i, case) in CASES.iter().enumerate() {
            let mut spoiled = clean.clone();
            (case.spoil)(&mut spoiled, &mut Pcg64::seed_from_u64(4));
            assert_eq!(state(&spoiled) == state(&clean), i == 0, "{}", case.name);
            assert!(names.insert(case.name), "{} stands twice", case.name);
            assert_eq!(spoiled.frames.len(), spoiled.masks.len(), "{}", case.name);
        }
    }
}
