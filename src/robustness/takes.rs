//! Clips filmed as people film them, and of other people: made anew instead of spoiled.

use super::cases::Case;
use crate::synth::{Build, Outfit, SynthOptions};

/// A clip to make, and what it is like.
pub struct Take {
    pub case: Case,
    pub film: fn(&mut SynthOptions),
}

const fn take(name: &'static str, what: &'static str, film: fn(&mut SynthOptions)) -> Take {
    Take { case: Case { name, what, spoil: |_, _| {} }, film }
}

/// The plain one first: all others are compared with it.
pub const TAKES: [Take; 14] = [
    take("plain", "a level camera some way off, one steady turn", |_| {}),
    take("tilted", "the camera looks down by 15°", |o| o.filming.tilt_degrees = 15.0),
    take("phone", "a phone held close: wide lens, upright picture, looking down by 15°", |o| {
        o.filming.tilt_degrees = 15.0;
        (o.filming.focal, o.filming.aspect, o.filming.fill) = (0.6, 16.0 / 9.0, 0.75);
        // The same person in as many pixels.
        o.size_px = 2 * (2 * o.size_px / 3);
    }),
    take("turns", "one and a half turns, now faster and now slower", |o| {
        (o.filming.turns, o.filming.speed_change) = (1.5, 0.6);
    }),
    take("arms", "arms that move by 30°", |o| o.filming.arm_swing_degrees = 30.0),
    take("hanging", "arms that hang at the sides", |o| o.filming.arms_down_degrees = 75.0),
    // As slowly as people do.
    take("steps", "turned by small steps, 240 frames", |o| {
        (o.filming.step_degrees, o.frames) = (20.0, 240);
    }),
    take("long", "600 frames", |o| o.frames = 600),
    take("small", "somebody small", |o| o.build = Build::Small),
    take("heavy", "somebody heavy", |o| o.build = Build::Heavy),
    take("loose", "wide clothes", |o| o.outfit = Outfit::Loose),
    take("hair", "much hair", |o| o.outfit = Outfit::Hair),
    take("skirt", "a skirt to the knees", |o| o.outfit = Outfit::Skirt),
    take("coat", "a coat to the shanks", |o| o.outfit = Outfit::Coat),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_take_but_the_first_differs() {
        let plain = format!("{:?}", SynthOptions::default());
        let mut names = std::collections::BTreeSet::new();
        for (i, take) in TAKES.iter().enumerate() {
            let mut options = SynthOptions::default();
            (take.film)(&mut options);
            assert_eq!(format!("{options:?}") == plain, i == 0, "{}", take.case.name);
            assert!(names.insert(take.case.name), "{} stands twice", take.case.name);
        }
    }
}
