//! Made clothing: which part of the body wears what, and how far it stands off (the paper's D).

use glam::Vec3;
use rand::RngExt;
use rand_pcg::Pcg64;

use crate::avatar::vertex_normals;
use crate::body::Body;
use crate::math::smoothstep;

/// What covers a point; the index in [`Dress::regions`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Region {
    Skin,
    Hair,
    Top,
    Bottom,
    Shoes,
}

pub(super) const REGIONS: [Region; 5] = [Region::Skin, Region::Hair, Region::Top, Region::Bottom, Region::Shoes];

/// A dressed body in the T-pose.
pub(super) struct Dress {
    /// `[V, 3]` metres
    pub offsets: Vec<[f32; 3]>,
    /// `[V][5]`: how much each region claims the vertex; the largest interpolated claim wins at a point.
    pub claims: Vec<[f32; 5]>,
    /// `[V, 3]`: the T-pose with offsets
    pub rest: Vec<[f32; 3]>,
}

/// What a made person wears.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outfit {
    /// A cut drawn by the seed.
    #[default]
    Any,
    /// Close to the body from neck to ankles.
    Tight,
    /// A wide shirt and wide trousers in deep folds.
    Loose,
    /// Wide folded legs that end above the knee.
    Breeches,
    /// A thick top with a hood.
    Hoodie,
    /// Voluminous hair over close clothes.
    Hair,
    /// A skirt to the knees: cloth from leg to leg.
    Skirt,
    /// A coat that hangs to the shanks.
    Coat,
}

/// The cut of the clothes.
struct Cut {
    /// Lower end of the sleeve between shoulder (0) and wrist (1)
    sleeve: f32,
    /// Height of the hem, from hip (0) to ankle (1)
    hem: f32,
    /// Metres at the hem beyond the fit: a skirt or wide legs
    flare: f32,
    top_cm: f32,
    bottom_cm: f32,
    hair_cm: f32,
    hood: bool,
    /// How deep the folds of top and bottom reach into the cloth, part of its thickness.
    top_folds: f32,
    bottom_folds: f32,
}

impl Cut {
    fn of(outfit: Outfit, rng: &mut Pcg64) -> Self {
        let any = Self::random(rng);
        match outfit {
            Outfit::Any => any,
            Outfit::Tight => TIGHT,
            Outfit::Loose => Self {
                sleeve: 0.6,
                flare: 0.03,
                top_cm: 3.5,
                bottom_cm: 3.0,
                top_folds: 0.9,
                bottom_folds: 0.9,
                ..TIGHT
            },
            Outfit::Breeches => {
                Self { sleeve: 0.3, hem: 0.42, flare: 0.09, bottom_cm: 3.0, bottom_folds: 0.9, ..TIGHT }
            }
            Outfit::Hoodie => Self { hood: true, top_cm: 3.0, top_folds: 0.6, ..TIGHT },
            Outfit::Hair => Self { sleeve: 0.4, hair_cm: 5.0, ..TIGHT },
            Outfit::Skirt => Self { sleeve: 0.3, hem: 0.3, ..TIGHT },
            Outfit::Coat => Self { top_cm: 2.0, ..TIGHT },
        }
    }

    fn random(rng: &mut Pcg64) -> Self {
        let mut within = |low: f32, high: f32| low + (high - low) * rng.random::<f32>();
        Self {
            sleeve: within(0.25, 0.95),
            hem: within(0.35, 0.95),
            flare: within(0.0, 0.05),
            top_cm: within(1.0, 2.2),
            bottom_cm: within(0.8, 1.8),
            hair_cm: within(1.0, 2.5),
            hood: within(0.0, 1.0) < 0.5,
            top_folds: 0.0,
            bottom_folds: 0.0,
        }
    }
}

const TIGHT: Cut = Cut {
    sleeve: 0.92,
    hem: 0.95,
    flare: 0.0,
    top_cm: 0.5,
    bottom_cm: 0.5,
    hair_cm: 1.0,
    hood: false,
    top_folds: 0.0,
    bottom_folds: 0.0,
};

/// Folds around the trunk and around a leg.
const TRUNK_FOLDS: f32 = 7.0;
const LEG_FOLDS: f32 = 4.0;

pub(super) fn step(low: f32, high: f32, x: f32) -> f32 {
    smoothstep((x - low) / (high - low))
}

/// Dresses `body` of shape `betas`.
pub(super) fn dress(body: &Body, betas: &[f32], outfit: Outfit, rng: &mut Pcg64) -> Dress {
    let cut = Cut::of(outfit, rng);
    let shaped = body.shaped_vertices(betas);
    let joints: Vec<Vec3> = body.shaped_joints(betas).into_iter().map(Vec3::from).collect();
    let normals = vertex_normals(&shaped, &body.faces);
    let place = |v: usize| Place::of(body, v, Vec3::from(shaped[v]), &joints);
    let claims: Vec<[f32; 5]> = (0..shaped.len()).map(|v| place(v).claims(&cut)).collect();
    let mut offsets: Vec<Vec3> =
        (0..shaped.len()).map(|v| place(v).offset(&cut, &claims[v], Vec3::from(normals[v]))).collect();
    smooth(&body.faces, &mut offsets, 3);
    for (v, offset) in offsets.iter_mut().enumerate() {
        *offset -= Vec3::from(normals[v]) * place(v).folds(&cut, &claims[v]);
    }
    let rest = shaped.iter().zip(&offsets).map(|(&v, d)| (Vec3::from(v) + d).into()).collect();
    Dress { offsets: offsets.into_iter().map(Into::into).collect(), claims, rest }
}

/// A vertex as a tailor sees it.
struct Place<'a> {
    point: Vec3,
    joints: &'a [Vec3],
    /// Weight of the head, the neck, both arms, hands, legs, feet
    head: f32,
    neck: f32,
    arm: f32,
    hand: f32,
    leg: f32,
    foot: f32,
}

impl<'a> Place<'a> {
    fn of(body: &Body, v: usize, point: Vec3, joints: &'a [Vec3]) -> Self {
        let weight = |which: &[u32]| body.weight_of(v, |joint| which.contains(&joint));
        Self {
            point,
            joints,
            head: weight(&[15]),
            neck: weight(&[12]),
            arm: weight(&[16, 17, 18, 19]),
            hand: weight(&[20, 21, 22, 23]),
            leg: weight(&[1, 2, 4, 5]),
            foot: weight(&[7, 8, 10, 11]),
        }
    }

    /// From the shoulder (0) to the wrist (1).
    fn along_arm(&self) -> f32 {
        (self.point.x.abs() - self.joints[16].x) / (self.joints[20].x - self.joints[16].x)
    }

    /// From the hip (0) to the ankle (1).
    fn along_leg(&self) -> f32 {
        (self.joints[1].y - self.point.y) / (self.joints[1].y - self.joints[7].y)
    }

    fn claims(&self, cut: &Cut) -> [f32; 5] {
        let (neck, head) = (self.joints[12], self.joints[15]);
        let waist = 0.5 * (self.joints[0].y + self.joints[3].y);
        let sleeve = step(cut.sleeve + 0.02, cut.sleeve - 0.02, self.along_arm());
        let sleeved = if self.arm + self.hand > 0.5 { sleeve } else { 1.0 };
        let below_neck = step(neck.y + 0.045, neck.y + 0.015, self.point.y);
        let top = step(waist - 0.02, waist + 0.02, self.point.y) * sleeved * below_neck;
        let hem = step(cut.hem + 0.02, cut.hem - 0.02, self.along_leg());
        let bottom = step(waist + 0.02, waist - 0.02, self.point.y) * hem * (1.0 - self.foot).max(0.0);
        let shoes = step(0.35, 0.65, self.foot) * step(0.10, 0.06, self.point.y - self.joints[10].y);
        // Hair: the upper head and its back.
        let (up, back) = (self.point.y - head.y, head.z - self.point.z);
        let hair = self.head * step(0.0, 0.02, back + 1.5 * (up - 0.07)) * step(-0.03, 0.0, up);
        let skin = 0.5 * (1.0 - top.max(bottom).max(shoes).max(hair)) + 0.25;
        [skin, hair, top, bottom, shoes]
    }

    fn offset(&self, cut: &Cut, claims: &[f32; 5], normal: Vec3) -> Vec3 {
        let [_, hair, top, bottom, shoes] = *claims;
        let ripple = 0.0025 * (40.0 * self.point.y + 6.0 * self.point.x).sin() * (25.0 * self.point.x).cos();
        let cloth = 0.01 * (top * cut.top_cm + bottom * cut.bottom_cm) + (top + bottom).min(1.0) * ripple;
        let mut offset = normal * (cloth + 0.01 * hair * cut.hair_cm + 0.006 * shoes);
        // The flare grows from the hips to the hem, away from the body's axis.
        let away = Vec3::new(self.point.x, 0.0, self.point.z).normalize_or_zero();
        offset += away * cut.flare * bottom * self.leg * (self.along_leg() / cut.hem).clamp(0.0, 1.0);
        if cut.hood {
            let nape = self.joints[12] + Vec3::new(0.0, -0.02, -0.07);
            let near = (-self.point.distance_squared(nape) / 0.005).exp();
            offset += Vec3::new(0.0, 0.2, -1.0) * 0.05 * near * (1.0 - self.head) * (1.0 - 0.5 * self.neck);
        }
        offset
    }
}

impl Place<'_> {
    /// How deep the folds are here, metres: valleys down the trunk and the legs between ridges, so that no silhouette shows
    /// their ground.
    fn folds(&self, cut: &Cut, claims: &[f32; 5]) -> f32 {
        let [_, _, top, bottom, _] = *claims;
        let valley = |axis: Vec3, count: f32| {
            let around = (self.point.x - axis.x).atan2(self.point.z - axis.z);
            let wave = 0.5 + 0.5 * (count * around + 0.6 * (7.0 * self.point.y).sin()).cos();
            wave * wave
        };
        let chest = self.joints[9].y;
        let trunk = top * (1.0 - self.arm - self.hand).max(0.0) * step(chest + 0.12, chest - 0.05, self.point.y);
        let leg = bottom * self.leg * step(0.05, 0.25, self.along_leg());
        let hip = self.joints[if self.point.x > 0.0 { 1 } else { 2 }];
        0.01 * (trunk * cut.top_folds * cut.top_cm * valley(self.joints[0], TRUNK_FOLDS)
            + leg * cut.bottom_folds * cut.bottom_cm * valley(hip, LEG_FOLDS))
    }
}

/// Means over neighbours, `rounds` times.
fn smooth(faces: &[[u32; 3]], offsets: &mut Vec<Vec3>, rounds: usize) {
    for _ in 0..rounds {
        let mut sums = offsets.clone();
        let mut counts = vec![1.0f32; offsets.len()];
        for face in faces {
            for k in 0..3 {
                let (a, b) = (face[k] as usize, face[(k + 1) % 3] as usize);
                sums[a] += offsets[b];
                sums[b] += offsets[a];
                counts[a] += 1.0;
                counts[b] += 1.0;
            }
        }
        *offsets = sums.into_iter().zip(counts).map(|(s, n)| s / n).collect();
    }
}
