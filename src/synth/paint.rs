//! Made colours: skin, hair, patterned cloth with a logo, a painted face; and the light that falls on them.

use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::SynthOptions;
use super::clothes::{Dress, REGIONS, Region};
use crate::avatar::SurfacePoint;
use crate::body::{Body, KeypointSource};
use crate::ops::light::Exposure;
use crate::ops::light::occlusion::openness;
use crate::ops::light::shadow::visibility;

/// The look of one made person.
pub(super) struct Paint<'a> {
    body: &'a Body,
    dress: &'a Dress,
    skin: Vec3,
    hair: Vec3,
    iris: Vec3,
    top: [Vec3; 2],
    bottom: Vec3,
    shoes: Vec3,
    stripes_a_metre: f32,
    chest: Vec3,
    eyes: Vec<Vec3>,
    nose: Option<Vec3>,
    hips: [Vec3; 2],
    /// Whether the cloth is checked
    checked: bool,
    /// Towards the light, world space
    light: Vec3,
    /// Share of the light that comes from there; the rest comes from everywhere and is less in corners.
    side_light: f32,
}

/// The power of a point's openness that its ambient light has: a camera's gamma, no light thrown back.
const OCCLUSION: f32 = 1.0 / 2.2;

fn mix(a: Vec3, b: Vec3, t: f32) -> Vec3 {
    a + (b - a) * t.clamp(0.0, 1.0)
}

/// Smooth noise in [−1, 1] over space, features of about 1 / `frequency` metres.
fn noise(p: Vec3, frequency: f32) -> f32 {
    let (cell, part) = ((p * frequency).floor(), p * frequency - (p * frequency).floor());
    let part = part * part * (3.0 - 2.0 * part);
    let corner = |dx: i32, dy: i32, dz: i32| {
        let [x, y, z] = [cell.x as i32 + dx, cell.y as i32 + dy, cell.z as i32 + dz].map(|v| v as u32);
        let mut h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ z.wrapping_mul(0xc2b2_ae3d);
        h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
        h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
        (h ^ (h >> 15)) as f32 / u32::MAX as f32 * 2.0 - 1.0
    };
    let line = |dy, dz| corner(0, dy, dz) + (corner(1, dy, dz) - corner(0, dy, dz)) * part.x;
    let sheet = |dz| line(0, dz) + (line(1, dz) - line(0, dz)) * part.y;
    sheet(0) + (sheet(1) - sheet(0)) * part.z
}

impl<'a> Paint<'a> {
    pub fn random(body: &'a Body, betas: &[f32], dress: &'a Dress, options: &SynthOptions, rng: &mut Pcg64) -> Self {
        let joints: Vec<Vec3> = body.shaped_joints(betas).into_iter().map(Vec3::from).collect();
        let mut colour =
            |low: f32, high: f32| Vec3::from(std::array::from_fn(|_| low + (high - low) * rng.random::<f32>()));
        let (top, other, bottom, shoes) = (colour(0.15, 0.9), colour(0.15, 0.9), colour(0.1, 0.6), colour(0.05, 0.4));
        let hair = mix(Vec3::new(0.10, 0.07, 0.05), Vec3::new(0.55, 0.38, 0.2), rng.random());
        let skin = mix(Vec3::new(0.42, 0.27, 0.19), Vec3::new(0.88, 0.70, 0.60), rng.random());
        // The face's landmarks, from the keypoints' definition: nose, left and right eye.
        let landmark = |i: usize| match body.keypoint_set("coco17")?.points.get(i)? {
            KeypointSource::Vertices(v) => {
                Some(v.iter().map(|&v| Vec3::from(dress.rest[v as usize])).sum::<Vec3>() / v.len() as f32)
            }
            _ => None,
        };
        Self {
            body,
            dress,
            skin,
            hair,
            iris: mix(Vec3::new(0.2, 0.35, 0.6), Vec3::new(0.35, 0.2, 0.08), rng.random()),
            top: [top, other],
            bottom,
            shoes,
            stripes_a_metre: 6.0 + 18.0 * rng.random::<f32>(),
            chest: joints[9],
            eyes: [landmark(1), landmark(2)].into_iter().flatten().collect(),
            nose: landmark(0),
            hips: [joints[1], joints[2]],
            checked: options.checked,
            light: Vec3::new(-0.5, -0.8, -0.6).normalize(),
            side_light: options.side_light,
        }
    }

    /// What of the light reaches each vertex of the posed mesh; even light has no corners.
    pub fn exposures(&self, vertices: &[[f32; 3]]) -> Vec<Exposure> {
        if self.side_light == 0.0 {
            return vec![Exposure::FULL; vertices.len()];
        }
        let visible = visibility(self.light.to_array(), vertices, &self.body.faces);
        let open = openness(vertices, &self.body.faces).into_iter().map(|open| open.powf(OCCLUSION));
        open.zip(visible).map(|(ambient, lamp)| Exposure { ambient, lamp }).collect()
    }

    /// sRGB of a surface point under the light; `normals` and `exposures` are the posed mesh's, in the world.
    pub fn colour(&self, point: &SurfacePoint, normals: &[[f32; 3]], exposures: &[Exposure]) -> [f32; 3] {
        let face = self.body.faces[point.face as usize].map(|v| v as usize);
        let normal: Vec3 = (0..3).map(|k| Vec3::from(normals[face[k]]) * point.bary[k]).sum();
        let Exposure { ambient, lamp } = Exposure::weighted((0..3).map(|k| (point.bary[k], exposures[face[k]])));
        let lamp = lamp * normal.normalize_or_zero().dot(self.light).max(0.0);
        let shade = (1.0 - self.side_light) * ambient + self.side_light * lamp * 1.6;
        (self.albedo(point) * shade).clamp(Vec3::ZERO, Vec3::ONE).into()
    }

    fn albedo(&self, point: &SurfacePoint) -> Vec3 {
        let face = self.body.faces[point.face as usize].map(|v| v as usize);
        let p: Vec3 = (0..3).map(|k| Vec3::from(self.dress.rest[face[k]]) * point.bary[k]).sum();
        let claim = |r: usize| (0..3).map(|k| point.bary[k] * self.dress.claims[face[k]][r]).sum::<f32>();
        let best = (0..REGIONS.len()).max_by(|&a, &b| claim(a).total_cmp(&claim(b)));
        let grain = 1.0 + 0.08 * noise(p, 60.0) + 0.06 * noise(p, 15.0);
        grain
            * match REGIONS[best.unwrap_or(0)] {
                Region::Skin => self.face(p),
                Region::Hair => self.hair * (1.0 + 0.3 * noise(p * Vec3::new(3.0, 0.4, 3.0), 60.0)),
                Region::Top => self.shirt(p),
                Region::Bottom => self.trousers(p),
                Region::Shoes => self.shoes,
            }
    }

    fn face(&self, p: Vec3) -> Vec3 {
        for eye in &self.eyes {
            if p.z < eye.z - 0.04 {
                continue;
            }
            let d = p.truncate() - eye.truncate();
            let (brow, lash) = (Vec2::new(d.x, d.y - 0.017 + 6.0 * d.x * d.x), Vec2::new(d.x, 1.6 * d.y));
            if brow.x.abs() < 0.017 && brow.y.abs() < 0.0028 {
                return 0.6 * self.hair;
            }
            match lash.length() {
                r if r < 0.004 => return Vec3::splat(0.05),
                r if r < 0.008 && d.x.abs() < 0.0075 => return self.iris,
                r if r < 0.014 => return Vec3::splat(0.92),
                r if r < 0.016 => return 0.45 * self.skin,
                _ => {}
            }
        }
        let Some(nose) = self.nose else { return self.skin };
        let d = p - nose;
        if d.z < -0.05 {
            return self.skin;
        }
        let mouth = Vec2::new(d.x, d.y + 0.038) / Vec2::new(0.026, 0.009);
        if mouth.length_squared() < 1.0 {
            let parted = (mouth.y + 0.25 * mouth.x * mouth.x).abs() < 0.16;
            return if parted { Vec3::new(0.25, 0.08, 0.08) } else { mix(self.skin, Vec3::new(0.7, 0.2, 0.2), 0.7) };
        }
        if Vec2::new(d.x.abs() - 0.007, d.y + 0.012).length() < 0.003 {
            return 0.4 * self.skin;
        }
        let cheek = Vec2::new(d.x.abs() - 0.042, d.y + 0.005).length();
        mix(self.skin, Vec3::new(0.85, 0.42, 0.36), 0.35 * (1.0 - cheek / 0.025).max(0.0))
    }

    /// Plain with a seam, or checked.
    fn trousers(&self, p: Vec3) -> Vec3 {
        if p.x.abs() < 0.004 {
            return 0.6 * self.bottom;
        }
        let light = self.checked && self.check(p, self.hips[(p.x < 0.0) as usize], 0.09);
        if light { mix(self.bottom, Vec3::ONE, 0.35) } else { self.bottom }
    }

    /// Checks: stripes over the height, crossed with stripes round an upright axis at about `radius` metres.
    fn check(&self, p: Vec3, axis: Vec3, radius: f32) -> bool {
        let stripe = |along: f32| (along * self.stripes_a_metre).rem_euclid(1.0) < 0.4;
        stripe(p.y) != stripe(radius * (p.x - axis.x).atan2(p.z - axis.z))
    }

    /// Stripes or checks, and on the chest a disc with a triangle over two letters.
    fn shirt(&self, p: Vec3) -> Vec3 {
        let logo = (p - self.chest).truncate() / 0.095;
        if p.z > self.chest.z && logo.length_squared() < 1.0 {
            let corner =
                |k: f32| Vec2::new(0.0, 0.38) + Vec2::from_angle(std::f32::consts::TAU * (k / 3.0 + 0.25)) * 0.45;
            let inside = (0..3).all(|k| {
                let (a, b) = (corner(k as f32), corner(k as f32 + 1.0));
                (b - a).perp_dot(logo - a) > 0.0
            });
            let rim = logo.length() > 0.9;
            return if inside || rim {
                Vec3::new(0.95, 0.8, 0.1)
            } else if letters(logo) {
                Vec3::splat(0.95)
            } else {
                Vec3::new(0.08, 0.1, 0.3)
            };
        }
        if self.checked && p.x.abs() <= 0.2 {
            return self.top[self.check(p, Vec3::new(0.0, 0.0, self.chest.z), 0.15) as usize];
        }
        // On the trunk the stripes run round it, on the sleeves round the arm.
        let on_sleeve = p.x.abs() > 0.2 && p.y > self.chest.y - 0.2;
        let along = if on_sleeve { p.x.abs() } else { p.y };
        self.top[((along * self.stripes_a_metre).rem_euclid(1.0) < 0.35) as usize]
    }
}

/// "EF" in the lower half of the disc, five cells high; seen from the front, x runs to the wearer's left.
fn letters(logo: Vec2) -> bool {
    const ROWS: [&[u8]; 5] = [b"EEE.FFF", b"E...F..", b"EE..FF.", b"E...F..", b"EEE.F.."];
    let (column, row) = ((logo.x + 0.56) / 0.16, (0.1 - logo.y) / 0.14);
    let inside = (0.0..7.0).contains(&column) && (0.0..5.0).contains(&row);
    inside && ROWS[row as usize][column as usize] != b'.'
}
