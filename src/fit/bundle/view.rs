//! What one frame says of the person as it stands: how points of the surface look, and how far its outline lies from the mask's edge.

use glam::{DVec2, DVec3, Vec3};

use super::kinematics::Kinematics;
use super::looks::{CHANNELS, Looks};
use crate::body::Body;
use crate::camera::Camera;
use crate::distance::signed_distance;
use crate::ops::hard_rasterize::{HardRasterizeConfig, cpu};
use crate::ops::skinning::cpu::Posed;

/// Cosine between a surface and the line of sight below which it is too oblique to be compared.
const OBLIQUE: f64 = 0.35;
/// A point lies no deeper behind what its pixel shows, metres.
const BEHIND: f64 = 0.008;
/// Nearer to the mask's edge there is something of the background, pixels.
const EDGE_PX: f32 = 2.0;
/// An outline this near the frame's border is no outline, pixels.
const BORDER: usize = 3;

/// The middle of a face, seen.
pub struct Sample {
    pub face: u32,
    pub values: [f32; CHANNELS],
    /// By how much the values grow with the point's way through the world, a metre.
    pub slopes: [Vec3; CHANNELS],
}

/// A pixel of the outline.
pub struct Rim {
    pub face: u32,
    pub bary: [f32; 3],
    /// How far the outline lies beyond the mask's edge here, pixels.
    pub off: f32,
    pub slope: Vec3,
}

/// One frame, linearised.
pub struct View<'a> {
    pub kinematics: Kinematics<'a>,
    pub samples: Vec<Sample>,
    pub rims: Vec<Rim>,
}

impl<'a> View<'a> {
    /// `camera` is of the frame's crop; `normals [V]` are of the T-pose.
    pub fn new(
        body: &'a Body,
        posed: &Posed<f32>,
        transl: [f32; 3],
        camera: &Camera,
        looks: &Looks,
        normals: &[DVec3],
    ) -> Self {
        let vertices: Vec<DVec3> = posed.vertices.iter().map(|v| DVec3::from(v.map(f64::from))).collect();
        let view: Vec<f32> = vertices.iter().flat_map(|v| camera.view(v.to_array())).map(|x| x as f32).collect();
        let image = cpu::forward(&HardRasterizeConfig::default(), camera, &view, &body.faces);
        let samples = (0..body.n_faces()).filter_map(|f| sample(body, &vertices, camera, looks, &image, f));
        Self {
            samples: samples.collect(),
            rims: rims(body, &vertices, camera, looks, &image),
            kinematics: Kinematics::new(body, posed, transl, normals),
        }
    }
}

/// How a point's place in the image moves with the point, pixels a metre: of x and of y.
fn projected(camera: &Camera, point: DVec3) -> [DVec3; 2] {
    let [x, y, z] = camera.view(point.to_array());
    let row = |r: usize| DVec3::from_slice(&camera.rotation[3 * r..3 * r + 3]);
    [camera.fx / z * (row(0) - x / z * row(2)), camera.fy / z * (row(1) - y / z * row(2))]
}

/// The pixel at a place of the frame.
fn pixel(camera: &Camera, [x, y]: [f64; 2]) -> Option<usize> {
    let within = (0.0..f64::from(camera.width)).contains(&x) && (0.0..f64::from(camera.height)).contains(&y);
    within.then(|| y as usize * camera.width as usize + x as usize)
}

fn sample(
    body: &Body,
    vertices: &[DVec3],
    camera: &Camera,
    looks: &Looks,
    image: &cpu::Image<f32>,
    f: usize,
) -> Option<Sample> {
    let [a, b, c] = body.faces[f].map(|v| vertices[v as usize]);
    let middle = (a + b + c) / 3.0;
    let normal = (b - a).cross(c - a).try_normalize()?;
    if (DVec3::from(camera.centre()) - middle).normalize_or_zero().dot(normal) < OBLIQUE {
        return None;
    }
    let place = camera.project(middle.to_array());
    let shown = f64::from(image.zbuf[pixel(camera, place)?]);
    if shown < 0.0 || camera.view(middle.to_array())[2] > shown + BEHIND || looks.beyond(place)? > -EDGE_PX {
        return None;
    }
    let (found, moves) = (looks.at(place)?, projected(camera, middle));
    let slope = |slope: [f32; 2]| (f64::from(slope[0]) * moves[0] + f64::from(slope[1]) * moves[1]).as_vec3();
    Some(Sample { face: f as u32, values: found.map(|look| look.value), slopes: found.map(|look| slope(look.slope)) })
}

fn rims(body: &Body, vertices: &[DVec3], camera: &Camera, looks: &Looks, image: &cpu::Image<f32>) -> Vec<Rim> {
    let [width, height] = [camera.width as usize, camera.height as usize];
    let inside: Vec<bool> = image.pix_to_face.iter().map(|&face| face >= 0).collect();
    let (Some(drawn), Some(mask)) = (signed_distance(&inside, width, height), &looks.beyond) else {
        return Vec::new();
    };
    let is_rim = |x: usize, y: usize| {
        let around = || (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| y * width + x));
        inside[y * width + x] && around().any(|i| !inside[i])
    };
    let places = (BORDER..height.saturating_sub(BORDER))
        .flat_map(|y| (BORDER..width.saturating_sub(BORDER)).map(move |x| (x, y)));
    let rim = |(x, y): (usize, usize)| {
        let i = y * width + x;
        let slope = |by: usize| f64::from(drawn[i + 2 * by] - drawn[i - 2 * by]);
        let out = DVec2::new(slope(1), slope(width)).try_normalize()?;
        let face = image.pix_to_face[i] as u32;
        let bary = [0, 1, 2].map(|k| image.bary_coords[3 * i + k]);
        let corners = body.faces[face as usize];
        let point = corners.iter().zip(bary).map(|(&v, b)| f64::from(b) * vertices[v as usize]).sum();
        let moves = projected(camera, point);
        Some(Rim { face, bary, off: mask[i] - drawn[i], slope: (out.x * moves[0] + out.y * moves[1]).as_vec3() })
    };
    places.filter(|&(x, y)| is_rim(x, y)).filter_map(rim).collect()
}
