//! Known poses that came with a clip: an npz in SMPL's or AMASS's layout.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use super::{BadInput, CaptureError, KnownPoses, Part, limits};
use crate::npz::{Array, Npz};

const EXPECTED: &str = "an npz with `poses` [N, 72] and `trans` or `pelvis` [N, 3], and optional `betas`";

/// Poses in degrees and places in centimetres show as numbers that no body reaches: four turns, and 100 m.
const MOST_RADIANS: f64 = 8.0 * std::f64::consts::PI;
const MOST_METRES: f64 = 100.0;
/// Of a shape coefficient.
const MOST_BETA: f64 = 1000.0;

/// Poses of all frames, and what was odd about them.
pub(super) fn read(path: &Path) -> Result<(KnownPoses, Vec<String>), CaptureError> {
    let open = |e| CaptureError::internal("cannot open the poses", e);
    let file = File::open(path).map_err(open)?;
    if file.metadata().map_err(open)?.len() > limits::POSES_BYTES {
        return Err(bad("the file is too large", format!("at most {} bytes", limits::POSES_BYTES)).into());
    }
    let npz = Npz::read(BufReader::new(file), limits::POSES_VALUES).map_err(|e| bad(e.to_string(), EXPECTED))?;
    Ok(parse(&npz)?)
}

fn bad(message: impl Into<String>, expected: impl Into<String>) -> BadInput {
    BadInput::new(Part::Poses, message, expected)
}

fn parse(npz: &Npz) -> Result<(KnownPoses, Vec<String>), BadInput> {
    let mut warnings = Vec::new();
    let poses = npz.arrays.get("poses").ok_or_else(|| missing(npz, &["poses"]))?;
    let (count, width) = match poses.shape[..] {
        [n, 24, 3] => (n, 72),
        // SMPL's body alone, SMPL, SMPL-H as in AMASS, SMPL-X: the first 66 numbers are the same joints.
        [n, width @ (66 | 72 | 156 | 165)] => (n, width),
        _ => return Err(bad(format!("`poses` has shape {:?}", poses.shape), "[N, 72]")),
    };
    check_rows("poses", poses, width, MOST_RADIANS, "radians")?;
    if width != 72 {
        warnings.push(format!("poses: {width} values a frame: the first 66 are taken and the hands left straight"));
    }
    let body = if width == 72 { 72 } else { 66 };
    let rows = (0..count).map(|i| {
        let mut row: Vec<f32> = poses.data[i * width..i * width + body].iter().map(|&x| x as f32).collect();
        row.resize(72, 0.0);
        row
    });
    let rows = rows.collect();
    let is_pelvis = npz.arrays.contains_key("pelvis");
    let names: &[&str] = if is_pelvis { &["pelvis"] } else { &["trans", "transl"] };
    let trans = names.iter().find_map(|name| npz.arrays.get(*name).map(|array| (*name, array)));
    let (name, trans) = trans.ok_or_else(|| missing(npz, &["trans", "transl", "pelvis"]))?;
    if trans.shape != [count, 3] {
        return Err(bad(format!("`{name}` has shape {:?}", trans.shape), format!("[{count}, 3], one row a pose")));
    }
    check_rows(name, trans, 3, MOST_METRES, "metres")?;
    let trans = trans.data.chunks_exact(3).map(|t| [t[0] as f32, t[1] as f32, t[2] as f32]).collect();
    let betas = npz.arrays.get("betas").map(betas).transpose()?;
    Ok((KnownPoses { poses: rows, trans, is_pelvis, betas }, warnings))
}

/// Why none of `names` is there: an array of another type is no array of numbers to the reader.
fn missing(npz: &Npz, names: &[&str]) -> BadInput {
    match npz.skipped.keys().find(|name| names.contains(&name.as_str())) {
        Some(name) => bad(format!("`{name}` is no array of float32, float64 or integers"), EXPECTED),
        None if names.len() == 1 => bad(format!("`{}` is missing", names[0]), EXPECTED),
        None => bad("`trans` or `pelvis` is missing", EXPECTED),
    }
}

fn check_rows(name: &str, array: &Array, width: usize, most: f64, unit: &str) -> Result<(), BadInput> {
    for (i, value) in array.data.iter().enumerate() {
        if !value.is_finite() || value.abs() > most {
            let message = format!("`{name}` holds {value}");
            return Err(bad(message, format!("{unit}, at most {most:.0}")).at(i / width));
        }
    }
    Ok(())
}

/// `[B]`, or `[1, B]`, or a row a frame, of which the mean is taken.
fn betas(array: &Array) -> Result<Vec<f32>, BadInput> {
    let width = array.shape.last().copied().unwrap_or(0);
    if !(1..=2).contains(&array.shape.len()) || width == 0 || width > 400 || array.data.is_empty() {
        return Err(bad(format!("`betas` has shape {:?}", array.shape), "[B] with at most 400 numbers"));
    }
    if array.data.iter().any(|value| !value.is_finite() || value.abs() > MOST_BETA) {
        return Err(bad("`betas` holds a number that is not finite or far too large", "shape coefficients"));
    }
    let rows = array.data.len() / width;
    let mean = |k| (0..rows).map(|i| array.data[i * width + k]).sum::<f64>() / rows as f64;
    Ok((0..width).map(|k| mean(k) as f32).collect())
}

impl KnownPoses {
    /// The same poses of the frames kept.
    pub(super) fn subset(&self, kept: &[usize]) -> Self {
        Self {
            poses: kept.iter().map(|&i| self.poses[i].clone()).collect(),
            trans: kept.iter().map(|&i| self.trans[i]).collect(),
            is_pelvis: self.is_pelvis,
            betas: self.betas.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn npz(arrays: &[(&str, &[usize], f64)]) -> Npz {
        let array = |shape: &[usize], value| Array::new(shape, vec![value; shape.iter().product()]);
        let arrays = arrays.iter().map(|(name, shape, value)| ((*name).to_owned(), array(shape, *value)));
        Npz { arrays: arrays.collect(), ..Npz::default() }
    }

    #[test]
    fn all_layouts_become_72_numbers() {
        for (shape, hands, warned) in [(&[2, 72][..], 0.5, 0), (&[2, 24, 3], 0.5, 0), (&[2, 156], 0.0, 1)] {
            let (poses, warnings) = parse(&npz(&[("poses", shape, 0.5), ("trans", &[2, 3], 1.0)])).unwrap();
            assert_eq!((poses.poses.len(), poses.poses[1].len()), (2, 72));
            assert_eq!((poses.poses[1][65], poses.poses[1][66], warnings.len()), (0.5, hands, warned));
            assert_eq!((poses.trans[1], poses.is_pelvis), ([1.0; 3], false));
        }
    }

    #[test]
    fn a_pelvis_wins_over_a_translation_and_betas_may_come_a_row_a_frame() {
        let arrays = npz(&[("poses", &[2, 72], 0.0), ("trans", &[2, 3], 1.0), ("pelvis", &[2, 3], 2.0)]);
        let (poses, _) = parse(&arrays).unwrap();
        assert!(poses.is_pelvis && poses.trans[0] == [2.0; 3] && poses.betas.is_none());
        let arrays = npz(&[("poses", &[2, 72], 0.0), ("trans", &[2, 3], 1.0), ("betas", &[2, 10], 3.0)]);
        assert_eq!(parse(&arrays).unwrap().0.betas.unwrap(), [3.0; 10]);
    }

    #[test]
    fn what_is_no_pose_is_refused() {
        let skipped = |name: &str| [(name.to_owned(), "objects".to_owned())].into();
        for (arrays, message) in [
            (npz(&[("trans", &[2, 3], 0.0)]), "`poses` is missing"),
            (npz(&[("poses", &[2, 71], 0.0), ("trans", &[2, 3], 0.0)]), "`poses` has shape [2, 71]"),
            (npz(&[("poses", &[2, 60], 0.0), ("trans", &[2, 3], 0.0)]), "`poses` has shape [2, 60]"),
            (npz(&[("poses", &[2, 72], 0.0)]), "`trans` or `pelvis` is missing"),
            (Npz { skipped: skipped("poses"), ..npz(&[]) }, "`poses` is no array of float32"),
            (Npz { skipped: skipped("transl"), ..npz(&[("poses", &[2, 72], 0.0)]) }, "`transl` is no array"),
            (npz(&[("poses", &[2, 72], 0.0), ("trans", &[3, 3], 0.0)]), "`trans` has shape [3, 3]"),
            (npz(&[("poses", &[2, 72], f64::NAN), ("trans", &[2, 3], 0.0)]), "`poses` holds NaN"),
            (npz(&[("poses", &[2, 72], 0.0), ("trans", &[2, 3], 5000.0)]), "`trans` holds 5000"),
            (npz(&[("poses", &[2, 72], 0.0), ("trans", &[2, 3], 0.0), ("betas", &[], 0.0)]), "`betas` has shape []"),
        ] {
            let error = parse(&arrays).map(|_| ()).unwrap_err();
            assert!(error.message.starts_with(message), "{error}");
        }
    }
}
