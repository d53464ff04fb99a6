//! SMPL (Loper et al. 2015), SMPL-H (Romero et al. 2017) and SMPL-X (Pavlakos et al. 2019) model files as 24-joint
//! bodies.
//!
//! The joints 0–21 are the same in all three. SMPL's hand joints (22, 23) lie at the knuckles: for the models with
//! fingers they are the mean of the first joints of the four fingers, and take over all finger weights. SMPL-X's jaw
//! and eyes give their weights to the head. Pose blend shapes of joints that are left out are left out with them.

use super::{ImportError, bad, prune_weights};
use crate::body::{Body, Landmarks, N_JOINTS, PARENTS};
use crate::npz::{Array, Npz};

const ANY: usize = usize::MAX;

/// Shape components to keep: as many as motion libraries give betas for.
const MAX_BETAS: usize = 16;

/// All arrays that a body is made of, by each of their usual names.
pub const NAMES: [&str; 9] =
    ["v_template", "weights", "lbs_weights", "kintree_table", "f", "faces", "shapedirs", "J_regressor", "posedirs"];

/// Body joints that all models share.
const N_SHARED: usize = 22;

/// How a model's joints become our 24.
struct Reduction {
    n_joints: usize,
    /// First joint of the left hand's fingers; 15 joints a hand, three a finger: index, middle, little, ring, thumb.
    fingers: Option<usize>,
}

impl Reduction {
    fn of(n_joints: usize) -> Result<Self, ImportError> {
        let fingers = match n_joints {
            24 => None,
            52 => Some(22),
            55 => Some(25),
            _ => {
                return Err(bad(
                    "weights",
                    format!("{n_joints} joints, expected 24 (SMPL), 52 (SMPL-H) or 55 (SMPL-X)"),
                ));
            }
        };
        Ok(Self { n_joints, fingers })
    }

    /// Our joint that takes over the weights of the model's.
    fn target(&self, joint: usize) -> usize {
        match self.fingers {
            None => joint,
            _ if joint < N_SHARED => joint,
            Some(first) if joint >= first => N_SHARED + (joint - first) / 15,
            Some(_) => 15,
        }
    }

    /// The model's joints whose mean is ours.
    fn sources(&self, joint: usize) -> Vec<usize> {
        match self.fingers {
            Some(first) if joint >= N_SHARED => {
                (0..4).map(|finger| first + (joint - N_SHARED) * 15 + finger * 3).collect()
            }
            _ => vec![joint],
        }
    }
}

/// Vertices of the two topologies; nose, eyes, ears, big toes, small toes, heels, each left before right.
fn landmarks(n_vertices: usize) -> Result<Landmarks, ImportError> {
    let [nose, eyes, ears, big_toes, small_toes, heels] = match n_vertices {
        6_890 => [[332; 2], [2_800, 6_260], [583, 4_071], [3_216, 6_617], [3_226, 6_624], [3_387, 6_787]],
        10_475 => [[9_120; 2], [9_448, 9_929], [6, 616], [5_770, 8_463], [5_780, 8_474], [8_846, 8_635]],
        _ => {
            let reason = format!("{n_vertices} vertices, expected 6890 (SMPL, SMPL-H) or 10475 (SMPL-X)");
            return Err(bad("v_template", reason));
        }
    };
    let pair = |pair: [u32; 2]| pair.map(|v| vec![v]);
    Ok(Landmarks {
        nose: vec![nose[0]],
        eyes: pair(eyes),
        ears: pair(ears),
        big_toes: pair(big_toes),
        small_toes: pair(small_toes),
        heels: pair(heels),
    })
}

/// The one of an array's usual names that it has here. What is there and could not be read is an error.
fn name_in<'a>(model: &Npz, names: &[&'a str]) -> Result<Option<&'a str>, ImportError> {
    debug_assert!(names.iter().all(|name| NAMES.contains(name)), "{names:?}");
    if let Some(name) = names.iter().find(|name| model.arrays.contains_key(**name)) {
        return Ok(Some(name));
    }
    match names.iter().find_map(|name| model.skipped.get_key_value(*name)) {
        Some((name, reason)) => Err(bad(name, reason)),
        None => Ok(None),
    }
}

/// The array under the first of its usual names, with this shape.
fn named<'a>(model: &'a Npz, names: &[&str], shape: &[usize]) -> Result<&'a Array, ImportError> {
    let name = name_in(model, names)?.ok_or_else(|| bad(names[0], "missing"))?;
    Ok(model.shaped(name, shape)?)
}

/// The body of a model's arrays.
pub fn body(model: &Npz, name: &str) -> Result<Body, ImportError> {
    let v_template = named(model, &["v_template"], &[ANY, 3])?;
    let n = v_template.shape[0];
    let landmarks = landmarks(n)?;
    let weights = named(model, &["weights", "lbs_weights"], &[n, ANY])?;
    let reduction = Reduction::of(weights.shape[1])?;
    check_parents(model, &reduction)?;
    let faces = named(model, &["f", "faces"], &[ANY, 3])?;

    let dirs = named(model, &["shapedirs"], &[n, 3, ANY])?;
    // SMPL-X keeps its expressions behind the shape: 10 + 10 in the first release, 300 + 100 later.
    let n_shape = if reduction.n_joints == 55 && dirs.shape[2] == 20 { 10 } else { dirs.shape[2] };
    let n_betas = n_shape.min(MAX_BETAS);
    let shapedirs: Vec<f64> =
        dirs.data.chunks_exact(dirs.shape[2]).flat_map(|row| row[..n_betas].iter().copied()).collect();

    let regressor = named(model, &["J_regressor"], &[reduction.n_joints, n])?;
    let regress = |values: &[f64]| regress(regressor, &reduction, values);
    let (lbs_joints, lbs_weights) = weights
        .data
        .chunks_exact(reduction.n_joints)
        .map(|row| {
            let mut dense = [0.0; N_JOINTS];
            row.iter().enumerate().for_each(|(joint, weight)| dense[reduction.target(joint)] += weight);
            prune_weights(&dense)
        })
        .unzip();
    let v_template: Vec<[f32; 3]> = v_template.f32().as_chunks().0.to_vec();
    Ok(Body {
        name: name.to_owned(),
        j_template: regress(v_template.as_flattened().iter().map(|&x| f64::from(x)).collect::<Vec<_>>().as_slice())
            .as_chunks()
            .0
            .to_vec(),
        j_shapedirs: regress(&shapedirs),
        shapedirs: shapedirs.iter().map(|&x| x as f32).collect(),
        posedirs: posedirs(model, &reduction, n)?,
        n_betas,
        parents: PARENTS.to_vec(),
        lbs_joints,
        lbs_weights,
        faces: faces.data.as_chunks::<3>().0.iter().map(|f| f.map(|i| i as u32)).collect(),
        uvs: Vec::new(),
        uv_faces: Vec::new(),
        mirror: mirror(&v_template),
        keypoints: landmarks.keypoint_sets(),
        v_template,
    })
}

/// The model's skeleton must be SMPL's as far as we take it over. `kintree_table` is `[2, K]`: parents, joints.
fn check_parents(model: &Npz, reduction: &Reduction) -> Result<(), ImportError> {
    let table = named(model, &["kintree_table"], &[2, reduction.n_joints])?;
    let shared = if reduction.fingers.is_some() { N_SHARED } else { N_JOINTS };
    for (joint, (&found, &expected)) in table.data[..shared].iter().zip(&PARENTS).enumerate().skip(1) {
        if found != f64::from(expected) {
            return Err(bad("kintree_table", format!("joint {joint} has parent {found}, expected {expected}")));
        }
    }
    Ok(())
}

/// Applies the joint regressor to `[V, M]` values: `[24, M]`.
fn regress(regressor: &Array, reduction: &Reduction, values: &[f64]) -> Vec<f32> {
    let n = regressor.shape[1];
    let m = values.len() / n;
    let mut out = Vec::with_capacity(N_JOINTS * m);
    for joint in 0..N_JOINTS {
        let sources = reduction.sources(joint);
        let mut sum = vec![0.0; m];
        for source in &sources {
            let row = &regressor.data[source * n..][..n];
            for (vertex, weight) in row.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
                let at = &values[vertex * m..][..m];
                sum.iter_mut().zip(at).for_each(|(s, x)| *s += weight * x / sources.len() as f64);
            }
        }
        out.extend(sum.iter().map(|&x| x as f32));
    }
    out
}

/// `[207, V·3]`, or empty where the model has none. Unreadable ones are not none: the body would bend without them.
fn posedirs(model: &Npz, reduction: &Reduction, n_vertices: usize) -> Result<Vec<f32>, ImportError> {
    let Some(name) = name_in(model, &["posedirs"])? else { return Ok(Vec::new()) };
    let array = model.get(name)?;
    let (n_features, n) = ((reduction.n_joints - 1) * 9, n_vertices * 3);
    // The files have [V, 3, features]; what is prepared for PyTorch has [features, V·3].
    let (feature_stride, value_stride) = match array.shape[..] {
        [v, 3, p] if v == n_vertices && p == n_features => (1, p),
        [p, values] if p == n_features && values == n => (n, 1),
        _ => {
            let reason = format!("shape {:?}, expected [{n_vertices}, 3, {n_features}]", array.shape);
            return Err(bad("posedirs", reason));
        }
    };
    let kept = if reduction.fingers.is_some() { (N_SHARED - 1) * 9 } else { n_features };
    let mut out = vec![0.0; (N_JOINTS - 1) * 9 * n];
    for (feature, row) in out.chunks_exact_mut(n).take(kept).enumerate() {
        for (i, x) in row.iter_mut().enumerate() {
            *x = array.data[feature * feature_stride + i * value_stride] as f32;
        }
    }
    Ok(out)
}

/// For each vertex the nearest one to its mirror image; itself where none is within 2 cm.
fn mirror(vertices: &[[f32; 3]]) -> Vec<u32> {
    const NEAR: f32 = 0.02;
    // In the order of x, only a narrow band has to be looked at.
    let mut order: Vec<u32> = (0..vertices.len() as u32).collect();
    let x = |i: u32| vertices[i as usize][0];
    order.sort_by(|&a, &b| x(a).total_cmp(&x(b)));
    let nearest = |(i, v): (u32, &[f32; 3])| {
        let image = glam::Vec3::new(-v[0], v[1], v[2]);
        let start = order.partition_point(|&k| x(k) < image.x - NEAR);
        let band = order[start..].iter().take_while(|&&k| x(k) <= image.x + NEAR);
        let distances = band.map(|&k| (image.distance(vertices[k as usize].into()), k));
        let best = distances.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(distance, _)| *distance <= NEAR);
        best.map_or(i, |(_, k)| k)
    };
    (0u32..).zip(vertices).map(nearest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: usize = 6_890;

    /// A model with SMPL's vertex count whose first vertices are the test body's and the others copies of them. Joint
    /// `j` of the model lies on vertex `j`; vertex `i` hangs on joints `i` and `i + 1`, cyclically.
    fn model(n_joints: usize, n_shape: usize) -> Npz {
        let small = Body::test_body();
        let source = |i: usize| small.v_template[i % small.n_vertices()];
        let mut npz = Npz::default();
        let mut add = |name: &str, shape: &[usize], data: Vec<f64>| {
            npz.arrays.insert(name.to_owned(), Array::new(shape, data));
        };
        add("v_template", &[N, 3], (0..N).flat_map(|i| source(i).map(f64::from)).collect());
        let shapedirs = (0..N * 3 * n_shape).map(|i| (i % n_shape) as f64 + (i / (3 * n_shape)) as f64 * 1e-3);
        add("shapedirs", &[N, 3, n_shape], shapedirs.collect());
        let one_at = |n: usize, at: usize| (0..n).map(move |k| f64::from(u8::from(k == at)));
        add("J_regressor", &[n_joints, N], (0..n_joints).flat_map(|j| one_at(N, j)).collect());
        let weights = (0..N).flat_map(|i| {
            let at = [i % n_joints, (i + 1) % n_joints];
            (0..n_joints).map(move |j| {
                if j == at[0] {
                    0.75
                } else if j == at[1] {
                    0.25
                } else {
                    0.0
                }
            })
        });
        add("weights", &[N, n_joints], weights.collect());
        let mut parents: Vec<f64> = PARENTS.map(f64::from).into();
        parents.resize(n_joints, 20.0);
        parents[0] = 4_294_967_295.0;
        parents.extend((0..n_joints).map(|j| j as f64));
        add("kintree_table", &[2, n_joints], parents);
        add("f", &[2, 3], vec![0.0, 1.0, 2.0, 2.0, 1.0, 6_889.0]);
        npz
    }

    #[test]
    fn smpl_keeps_its_joints_and_follows_the_regressor() {
        let model = model(24, 10);
        let body = body(&model, "smpl").unwrap();
        body.check().unwrap();
        assert_eq!((body.n_betas, body.posedirs.len(), body.uvs.len()), (10, 0, 0));
        assert_eq!(body.j_template[7], body.v_template[7]);
        let betas = [0.5, -1.0, 2.0];
        for joint in [0, 5, 23] {
            let (j, v) = (body.shaped_joints(&betas)[joint], body.shaped_vertices(&betas)[joint]);
            assert!(glam::Vec3::from(j).distance(v.into()) < 1e-5);
        }
        assert_eq!((body.lbs_joints[30], body.lbs_weights[30]), ([6, 7, 0, 0], [0.75, 0.25, 0.0, 0.0]));
        assert_eq!(body.keypoint_set("coco17").unwrap().points.len(), 17);
    }

    #[test]
    fn finger_weights_go_to_the_hands_and_faces_to_the_head() {
        let smplx = Reduction::of(55).unwrap();
        assert_eq!([21, 22, 24, 25, 39, 40, 54].map(|j| smplx.target(j)), [21, 15, 15, 22, 22, 23, 23]);
        let smplh = Reduction::of(52).unwrap();
        assert_eq!([21, 22, 36, 37, 51].map(|j| smplh.target(j)), [21, 22, 22, 23, 23]);
        assert_eq!(smplh.sources(23), [37, 40, 43, 46]);

        let body = body(&model(52, 16), "smplh").unwrap();
        body.check().unwrap();
        assert_eq!((body.lbs_joints[22][0], body.lbs_weights[22][0]), (22, 1.0));
        let knuckles = [22, 25, 28, 31].map(|i: usize| glam::Vec3::from(body.v_template[i]));
        let mean = knuckles.iter().sum::<glam::Vec3>() / 4.0;
        assert!(mean.distance(body.j_template[22].into()) < 1e-6);
    }

    #[test]
    fn pose_blend_shapes_are_transposed() {
        let mut model = model(24, 1);
        let values: Vec<f64> = (0..N * 3 * 207).map(|i| (i / 207) as f64 + (i % 207) as f64 / 256.0).collect();
        model.arrays.insert("posedirs".to_owned(), Array::new(&[N, 3, 207], values));
        let body = body(&model, "smpl").unwrap();
        assert_eq!(body.posedirs[3 * N * 3 + 100], 100.0 + 3.0 / 256.0);
        assert_eq!(body.posedirs[206 * N * 3 + 7], 7.0 + 206.0 / 256.0);
    }

    #[test]
    fn the_mirror_is_the_nearest_image() {
        let body = Body::test_body();
        for (i, (&found, &expected)) in mirror(&body.v_template).iter().zip(&body.mirror).enumerate() {
            let [a, b] = [found, expected].map(|v| glam::Vec3::from(body.v_template[v as usize]));
            assert!(a.distance(b) < 1e-6, "vertex {i}: {found}, expected {expected}");
        }
        assert_eq!(mirror(&[[0.5, 0.0, 0.0], [-0.4, 0.0, 0.0]]), [0, 1]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let error = |change: fn(&mut Npz)| {
            let mut model = model(24, 2);
            change(&mut model);
            body(&model, "smpl").unwrap_err().to_string()
        };
        assert_eq!(error(|m| drop(m.arrays.remove("f"))), "f: missing");
        let reason = "an object of chumpy.reordering.transpose without `x`, expected numbers";
        for name in ["posedirs", "shapedirs", "weights", "J_regressor"] {
            let mut model = model(24, 2);
            model.arrays.remove(name);
            model.skipped.insert(name.to_owned(), reason.to_owned());
            assert_eq!(body(&model, "smpl").unwrap_err().to_string(), format!("{name}: {reason}"));
        }
        let odd = error(|m| drop(m.arrays.insert("v_template".to_owned(), Array::new(&[1, 3], vec![0.0; 3]))));
        assert_eq!(odd, "v_template: 1 vertices, expected 6890 (SMPL, SMPL-H) or 10475 (SMPL-X)");
        let tree = error(|m| m.arrays.get_mut("kintree_table").unwrap().data[5] = 0.0);
        assert_eq!(tree, "kintree_table: joint 5 has parent 0, expected 2");
    }
}
