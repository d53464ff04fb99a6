//! What is being fitted, on the host: the start of each stage, the checkpoint, the result.

use std::io::{Seek, Write};
use std::path::Path;

use super::checkpointed::Arrays;
use crate::atomic_file;
use crate::body::{Body, N_POSE};
use crate::npz::{Npz, NpzError, NpzWriter};
use crate::ops::light::Light;
use crate::ops::texture_field::{TextureFieldConfig, TextureFieldParams};

/// The version of the checkpoint format.
const VERSION: f64 = 4.0;

/// How far a fit has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// β, D, θ, R, t and one colour a face.
    Geometry,
    /// Hash texture, and β, D, θ, R, t through it; in `paper` θ, R, t alone.
    Texture,
    Done,
}

/// A plain texture on a layout of the faces, see [`crate::ops::texel_map`].
#[derive(Clone, Debug, PartialEq)]
pub struct Texels {
    /// `[U, 2]`: u to the right, v down, in [0, 1]
    pub uvs: Vec<[f32; 2]>,
    /// `[F, 3]`: corners of each face in `uvs`
    pub uv_faces: Vec<[u32; 3]>,
    pub side: usize,
    /// `[side, side, 3]`
    pub values: Vec<f32>,
}

impl Texels {
    /// All grey.
    pub fn grey(uvs: Vec<[f32; 2]>, uv_faces: Vec<[u32; 3]>, side: usize) -> Self {
        Self { uvs, uv_faces, side, values: vec![0.5; 3 * side * side] }
    }
}

/// All parameters of an avatar in the making (paper §3.1: β, D, {θᵢ, Rᵢ, tᵢ}, φ). The rotation Rᵢ is joint 0 of θᵢ.
#[derive(Clone, Debug, PartialEq)]
pub struct FitState {
    pub stage: Stage,
    /// Steps done in this stage.
    pub step: u32,
    /// `[B]`
    pub betas: Vec<f32>,
    /// `[V, 3]`
    pub offsets: Vec<f32>,
    /// `[N, 72]`
    pub poses: Vec<f32>,
    /// `[N, 72]`: the poses that the stage began with, which its joints are held near.
    pub stage_poses: Vec<f32>,
    /// `[N, 3]`
    pub transl: Vec<f32>,
    /// `[N, 3]`: the places that the stage began with.
    pub stage_transl: Vec<f32>,
    /// `[N, 3]`: the places that the stages which run one after the other began with; empty outside of a run.
    pub run_transl: Vec<f32>,
    /// `[F, 3]`, 0…1
    pub face_colours: Vec<f32>,
    /// The colours are in this light.
    pub light: Light,
    /// `[V, 3]`, 0…1
    pub texcoords: Vec<f32>,
    pub field: TextureFieldParams,
    /// Fitted in stage 2 instead of the field, where present.
    pub texels: Option<Texels>,
    /// Of a stage that was interrupted.
    pub progress: Option<Progress>,
}

/// What the rest of a stage follows from, besides the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    pub(super) begun: Begun,
    /// What the stage keeps from step to step.
    pub(super) kept: Arrays,
}

/// The parameters with which a phase began: its light, its shadows and what it takes for unseen are theirs.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Begun {
    betas: Vec<f32>,
    offsets: Vec<f32>,
    poses: Vec<f32>,
    transl: Vec<f32>,
    light: Light,
}

impl Begun {
    pub fn of(state: &FitState) -> Self {
        Self {
            betas: state.betas.clone(),
            offsets: state.offsets.clone(),
            poses: state.poses.clone(),
            transl: state.transl.clone(),
            light: state.light,
        }
    }

    /// `state` as it was when the phase began, as far as that matters.
    pub fn put_into(self, state: FitState) -> FitState {
        let Self { betas, offsets, poses, transl, light } = self;
        FitState { betas, offsets, poses, transl, light, ..state }
    }
}

/// The arrays of a state by their names in a checkpoint, to read or, with `mut`, to put back: one list for both ways, so that none forgets
/// a part.
macro_rules! arrays_of {
    ($state:expr $(, $mutable:tt)?) => {{
        let state: & $($mutable)? FitState = $state;
        let mut arrays = vec![
            ("betas", & $($mutable)? state.betas),
            ("offsets", & $($mutable)? state.offsets),
            ("poses", & $($mutable)? state.poses),
            ("stage_poses", & $($mutable)? state.stage_poses),
            ("transl", & $($mutable)? state.transl),
            ("stage_transl", & $($mutable)? state.stage_transl),
            ("face_colours", & $($mutable)? state.face_colours),
            ("texcoords", & $($mutable)? state.texcoords),
            ("field_table", & $($mutable)? state.field.table),
            ("field_w0", & $($mutable)? state.field.w0),
            ("field_w1", & $($mutable)? state.field.w1),
            ("field_w2", & $($mutable)? state.field.w2),
        ];
        if let Some(texels) = & $($mutable)? state.texels {
            arrays.push(("texels", & $($mutable)? texels.values));
        }
        if !state.run_transl.is_empty() {
            arrays.push(("run_transl", & $($mutable)? state.run_transl));
        }
        arrays
    }};
}

/// As [`arrays_of`], of a [`Begun`].
macro_rules! begun_arrays_of {
    ($begun:expr $(, $mutable:tt)?) => {{
        let begun: & $($mutable)? Begun = $begun;
        vec![
            ("begun_betas", & $($mutable)? begun.betas),
            ("begun_offsets", & $($mutable)? begun.offsets),
            ("begun_poses", & $($mutable)? begun.poses),
            ("begun_transl", & $($mutable)? begun.transl),
        ]
    }};
}

/// Before the names of what a stage keeps, in a checkpoint.
const KEPT: &str = "kept.";

impl FitState {
    /// The start: the body of stage 0, no offsets, grey faces, texture coordinates from the mean body's surface.
    pub fn new(
        body: &Body,
        betas: Vec<f32>,
        poses: &[[f32; N_POSE]],
        transl: &[[f32; 3]],
        field: TextureFieldConfig,
        seed: u64,
    ) -> Self {
        Self {
            stage: Stage::Geometry,
            step: 0,
            texcoords: initial_texcoords(body),
            betas,
            offsets: vec![0.0; body.n_vertices() * 3],
            poses: poses.concat(),
            stage_poses: poses.concat(),
            transl: transl.concat(),
            stage_transl: transl.concat(),
            run_transl: Vec::new(),
            face_colours: vec![0.5; body.n_faces() * 3],
            light: Light::EVEN,
            field: TextureFieldParams::random(&field, seed),
            texels: None,
            progress: None,
        }
    }

    pub fn n_frames(&self) -> usize {
        self.poses.len() / N_POSE
    }

    /// False where a parameter has become infinite or NaN.
    pub fn is_finite(&self) -> bool {
        self.light.is_sound() && arrays_of!(self).iter().all(|(_, values)| values.iter().all(|x| x.is_finite()))
    }

    /// Writes the state; the file appears whole or not at all.
    pub fn save(&self, path: &Path) -> Result<(), NpzError> {
        atomic_file::replace(path, |writer| self.write(NpzWriter::stored(writer)))
    }

    fn write(&self, mut npz: NpzWriter<impl Write + Seek>) -> Result<(), NpzError> {
        let stage = match self.stage {
            Stage::Geometry => 1,
            Stage::Texture => 2,
            Stage::Done => 3,
        };
        npz.add("version", &[], &[VERSION])?;
        npz.add("stage", &[], &[stage])?;
        npz.add("step", &[], &[self.step])?;
        npz.add("light", &[LIGHT], &light_numbers(&self.light))?;
        for (name, data) in arrays_of!(self) {
            npz.add(name, &[data.len()], data)?;
        }
        if let Some(Progress { begun, kept }) = &self.progress {
            npz.add("begun_light", &[LIGHT], &light_numbers(&begun.light))?;
            for (name, data) in begun_arrays_of!(begun) {
                npz.add(name, &[data.len()], data)?;
            }
            for (name, data) in kept {
                npz.add(&format!("{KEPT}{name}"), &[data.len()], data)?;
            }
        }
        npz.finish()?;
        Ok(())
    }

    /// Reads a checkpoint into a state of the same shapes. `None` where it belongs to another fit: another number of
    /// frames, another body, another field.
    pub fn resume(&self, path: &Path) -> Result<Option<Self>, NpzError> {
        let npz = Npz::open(path)?;
        if npz.scalar("version")? != VERSION {
            return Ok(None);
        }
        let mut state = Self { run_transl: Vec::new(), progress: None, ..self.clone() };
        state.stage = match npz.scalar("stage")? as u32 {
            1 => Stage::Geometry,
            2 => Stage::Texture,
            _ => Stage::Done,
        };
        state.step = npz.scalar("step")? as u32;
        state.light = light_in(&npz, "light")?;
        let mut whole = true;
        let mut take = |arrays: Vec<(&str, &mut Vec<f32>)>| -> Result<(), NpzError> {
            for (name, into) in arrays {
                let array = npz.get(name)?.f32();
                whole &= array.len() == into.len() && array.iter().all(|x| x.is_finite());
                *into = array;
            }
            Ok(())
        };
        if npz.arrays.contains_key("run_transl") {
            state.run_transl.clone_from(&state.transl);
        }
        take(arrays_of!(&mut state, mut))?;
        if npz.arrays.contains_key("begun_light") {
            let mut begun = Begun::of(&state);
            begun.light = light_in(&npz, "begun_light")?;
            take(begun_arrays_of!(&mut begun, mut))?;
            let named = npz.arrays.iter().filter_map(|(name, array)| Some((name.strip_prefix(KEPT)?, array)));
            let kept: Arrays = named.map(|(name, array)| (name.to_owned(), array.f32())).collect();
            whole &= begun.light.is_sound() && kept.values().flatten().all(|x| x.is_finite());
            state.progress = Some(Progress { begun, kept });
        }
        Ok((whole && state.light.is_sound()).then_some(state))
    }
}

/// Numbers of a light.
const LIGHT: usize = 13;

fn light_numbers(light: &Light) -> Vec<f32> {
    let Light { ambient, strength, direction, occlusion, slope } = *light;
    [&ambient[..], &strength, &direction, &slope, &[occlusion]].concat()
}

fn light_in(npz: &Npz, name: &str) -> Result<Light, NpzError> {
    let numbers = npz.shaped(name, &[LIGHT])?.f32();
    let three = |at: usize| std::array::from_fn(|k| numbers[at + k]);
    let [ambient, strength, direction, slope] = [0, 3, 6, 9].map(three);
    Ok(Light { ambient, strength, direction, occlusion: numbers[12], slope })
}

/// The mean body's vertices in the T-pose, scaled evenly into the unit cube with a margin in which learned coordinates
/// may move (paper §3.2). Even scaling keeps texels square on the surface.
fn initial_texcoords(body: &Body) -> Vec<f32> {
    let (low, high) = bounds(body);
    let scale = 1.0 / cube_side(body) as f32;
    body.v_template.iter().flat_map(|v| [0, 1, 2].map(|k| 0.5 + (v[k] - 0.5 * (low[k] + high[k])) * scale)).collect()
}

/// Metres of the mean body's surface along the side of the cube that the texture's coordinates lie in, at the start.
pub fn cube_side(body: &Body) -> f64 {
    let (low, high) = bounds(body);
    let side = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max).max(1e-6);
    f64::from(side) / 0.9
}

fn bounds(body: &Body) -> ([f32; 3], [f32; 3]) {
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for v in &body.v_template {
        for k in 0..3 {
            low[k] = low[k].min(v[k]);
            high[k] = high[k].max(v[k]);
        }
    }
    (low, high)
}
