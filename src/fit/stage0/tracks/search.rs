//! Which points are followed, and for how long.

use glam::DVec2;
use rayon::prelude::*;

use super::flow::{self, LEVELS};
use super::picture::Picture;
use crate::capture::Capture;

/// A point of the person over consecutive frames.
pub struct Track {
    pub first: usize,
    /// Where it lies in `first` and the frames after it, image pixels.
    pub places: Vec<DVec2>,
}

/// Half a patch's side, over the person's height in the image, and its bounds in pixels.
const RADIUS: f64 = 0.016;
const RADII: (f64, f64) = (4.0, 9.0);
/// Distance between points that begin in one frame, over the height.
const APART: f64 = 0.035;
/// Times over the clip that points are chosen.
const STARTS: usize = 24;
/// Shorter ones tell nothing.
pub const LEAST_FRAMES: usize = 4;
/// By how much a point followed there and back may miss itself, pixels.
const THERE_AND_BACK: f64 = 0.5;
/// Faster points are lost, heights a frame.
const FASTEST: f64 = 0.06;

/// Whether all frames have colours and masks.
pub fn shows_pictures(capture: &Capture) -> bool {
    capture.frames.iter().all(|f| f.rgb.len() == 3 * f.mask.len() && !f.mask.is_empty())
}

/// Points that can be followed, those seen longest first. Frames without colours have none. `None` where `goes_on`, asked before
/// each frame, said no.
pub fn find(capture: &Capture, height_px: f64, mut goes_on: impl FnMut() -> bool) -> Option<Vec<Track>> {
    if !shows_pictures(capture) {
        return Some(Vec::new());
    }
    let frames = &capture.frames;
    let radius = (RADIUS * height_px).clamp(RADII.0, RADII.1).round() as i32;
    let every = frames.len().div_ceil(STARTS).max(1);
    let (mut ended, mut alive): (Vec<Track>, Vec<Track>) = (Vec::new(), Vec::new());
    let mut before: Option<Picture> = None;
    for (t, frame) in frames.iter().enumerate() {
        if !goes_on() {
            return None;
        }
        let now = Picture::new(frame, LEVELS);
        if let Some(before) = &before {
            let follow = |track: &Track| step(before, &now, *track.places.last()?, radius, FASTEST * height_px);
            let places: Vec<Option<DVec2>> = alive.par_iter().map(follow).collect();
            for (mut track, next) in std::mem::take(&mut alive).into_iter().zip(places) {
                match next {
                    Some(next) => {
                        track.places.push(next);
                        alive.push(track);
                    }
                    None => ended.push(track),
                }
            }
        }
        if t % every == 0 {
            let started = corners(&now, radius, APART * height_px);
            alive.extend(started.into_iter().map(|at| Track { first: t, places: vec![at] }));
        }
        before = Some(now);
    }
    ended.extend(alive);
    ended.retain(|track| track.places.len() >= LEAST_FRAMES);
    ended.sort_by_key(|track| (std::cmp::Reverse(track.places.len()), track.first));
    Some(ended)
}

/// To the next frame, not farther than `most` pixels, if the way back leads to the same point.
fn step(from: &Picture, to: &Picture, at: DVec2, radius: i32, most: f64) -> Option<DVec2> {
    let next = flow::follow(from, to, at, radius).filter(|next| next.distance(at) < most)?;
    let back = flow::follow(to, from, next, radius)?;
    (back.distance(at) <= THERE_AND_BACK).then_some(next)
}

/// Places with texture in both directions, the best first, none nearer to a better one than `apart`.
fn corners(picture: &Picture, radius: i32, apart: f64) -> Vec<DVec2> {
    let level = &picture.levels[0];
    let stride = (apart / 3.0).max(1.0) as usize;
    let in_row = |y: usize| {
        let row = (0..level.width).step_by(stride).map(move |x| DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
        let inside = row.filter(|at| level.is_inside(*at)).map(|at| (flow::texture(level, at, radius), at));
        inside.filter(|(texture, _)| *texture > 0.0).collect::<Vec<_>>()
    };
    let mut candidates: Vec<(f64, DVec2)> =
        (0..level.height).into_par_iter().step_by(stride).flat_map_iter(in_row).collect();
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen: Vec<DVec2> = Vec::new();
    for (_, at) in candidates {
        if chosen.iter().all(|other| other.distance(at) >= apart) {
            chosen.push(at);
        }
    }
    chosen.into_iter().map(|at| at + picture.origin).collect()
}
