//! What makes a body valid. Whatever reads a body checks it; the fit and its unchecked kernels rely on it.

use std::collections::HashSet;

use super::{Body, JOINT_NAMES, KeypointSource, N_JOINTS};

/// An array of a body that is not what it must be.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("body array `{array}`: {reason}")]
pub struct InvalidBody {
    pub array: String,
    pub reason: String,
}

fn fail<T>(array: &str, reason: String) -> Result<T, InvalidBody> {
    Err(InvalidBody { array: array.to_owned(), reason })
}

impl Body {
    /// Checks lengths, finiteness, index ranges, weights and the skeleton's order.
    pub fn check(&self) -> Result<(), InvalidBody> {
        self.check_lengths()?;
        self.check_values()?;
        self.check_skeleton()?;
        self.check_weights()?;
        self.check_faces()?;
        self.check_mirror()?;
        self.check_keypoints()
    }

    fn check_lengths(&self) -> Result<(), InvalidBody> {
        let (v, b, f) = (self.n_vertices(), self.n_betas, self.n_faces());
        let none_or = |n: usize, have: usize| if have == 0 { 0 } else { n };
        let expected = [
            ("shapedirs", self.shapedirs.len(), v * 3 * b, "V·3·B"),
            ("posedirs", self.posedirs.len(), none_or((N_JOINTS - 1) * 9 * v * 3, self.posedirs.len()), "207·V·3 or 0"),
            ("j_template", self.j_template.len(), N_JOINTS, "24"),
            ("j_shapedirs", self.j_shapedirs.len(), N_JOINTS * 3 * b, "24·3·B"),
            ("parents", self.parents.len(), N_JOINTS, "24"),
            ("lbs_joints", self.lbs_joints.len(), v, "V"),
            ("lbs_weights", self.lbs_weights.len(), v, "V"),
            ("mirror", self.mirror.len(), v, "V"),
            ("uv_faces", self.uv_faces.len(), none_or(f, self.uvs.len()), "F, or 0 without `uvs`"),
        ];
        for (array, have, want, meaning) in expected {
            if have != want {
                return fail(array, format!("length {have}, expected {want} ({meaning})"));
            }
        }
        if v == 0 || f == 0 {
            return fail(if v == 0 { "v_template" } else { "faces" }, "empty".to_owned());
        }
        Ok(())
    }

    fn check_values(&self) -> Result<(), InvalidBody> {
        let arrays: [(&str, &[f32]); 7] = [
            ("v_template", self.v_template.as_flattened()),
            ("shapedirs", &self.shapedirs),
            ("posedirs", &self.posedirs),
            ("j_template", self.j_template.as_flattened()),
            ("j_shapedirs", &self.j_shapedirs),
            ("lbs_weights", self.lbs_weights.as_flattened()),
            ("uvs", self.uvs.as_flattened()),
        ];
        for (array, values) in arrays {
            if let Some(i) = values.iter().position(|x| !x.is_finite()) {
                return fail(array, format!("value {i} is {}, expected a finite number", values[i]));
            }
        }
        Ok(())
    }

    fn check_skeleton(&self) -> Result<(), InvalidBody> {
        for (joint, &parent) in self.parents.iter().enumerate() {
            let in_order = if joint == 0 { parent == -1 } else { (0..joint as i32).contains(&parent) };
            if !in_order {
                let name = JOINT_NAMES[joint];
                let reason = format!(
                    "{name} (joint {joint}) has parent {parent}, expected −1 for the root and an earlier joint elsewhere"
                );
                return fail("parents", reason);
            }
        }
        Ok(())
    }

    fn check_weights(&self) -> Result<(), InvalidBody> {
        for (i, (joints, weights)) in self.lbs_joints.iter().zip(&self.lbs_weights).enumerate() {
            if let Some(joint) = joints.iter().find(|&&j| j as usize >= N_JOINTS) {
                return fail("lbs_joints", format!("vertex {i} hangs on joint {joint}, expected below {N_JOINTS}"));
            }
            let sum: f32 = weights.iter().sum();
            if (sum - 1.0).abs() > 1e-4 || weights.iter().any(|&w| w < 0.0) {
                return fail("lbs_weights", format!("vertex {i} has {weights:?}, expected weights ≥ 0 that sum to 1"));
            }
        }
        Ok(())
    }

    fn check_faces(&self) -> Result<(), InvalidBody> {
        for (array, faces, limit) in
            [("faces", &self.faces, self.n_vertices()), ("uv_faces", &self.uv_faces, self.uvs.len())]
        {
            for (i, &[a, b, c]) in faces.iter().enumerate() {
                if [a, b, c].iter().any(|&k| k as usize >= limit) {
                    return fail(array, format!("face {i} is {:?}, expected indices below {limit}", [a, b, c]));
                }
                if array == "faces" && (a == b || b == c || c == a) {
                    return fail(array, format!("face {i} is {:?}, expected three different vertices", [a, b, c]));
                }
            }
        }
        Ok(())
    }

    fn check_mirror(&self) -> Result<(), InvalidBody> {
        let limit = self.n_vertices();
        match self.mirror.iter().position(|&m| m as usize >= limit) {
            Some(i) => fail("mirror", format!("vertex {i} mirrors {}, expected below {limit}", self.mirror[i])),
            None => Ok(()),
        }
    }

    fn check_keypoints(&self) -> Result<(), InvalidBody> {
        let mut formats = HashSet::new();
        for set in &self.keypoints {
            if !formats.insert(&set.format) {
                return fail("keypoints", format!("format {} stands twice", set.format));
            }
            for (i, point) in set.points.iter().enumerate() {
                let (indices, limit) = match point {
                    KeypointSource::Joint(joint) => (std::slice::from_ref(joint), N_JOINTS),
                    KeypointSource::Joints(joints) => (&joints[..], N_JOINTS),
                    KeypointSource::Vertices(vertices) => (&vertices[..], self.n_vertices()),
                };
                if indices.is_empty() || indices.iter().any(|&k| k as usize >= limit) {
                    let format = &set.format;
                    return fail(
                        "keypoints",
                        format!("{format} point {i} is {point:?}, expected indices below {limit}"),
                    );
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_test_body_is_valid() {
        assert_eq!(Body::test_body().check(), Ok(()));
    }

    #[test]
    fn every_kind_of_damage_is_named() {
        type Damage = fn(&mut Body);
        let cases: [(&str, Damage); 10] = [
            ("v_template", |b| b.v_template[3][1] = f32::NAN),
            ("shapedirs", |b| b.shapedirs.truncate(10)),
            ("parents", |b| b.parents[4] = 7),
            ("lbs_weights", |b| b.lbs_weights[5] = [0.5, 0.4, 0.0, 0.0]),
            ("lbs_joints", |b| b.lbs_joints[5][1] = 24),
            ("faces", |b| b.faces[0][2] = b.v_template.len() as u32),
            ("faces", |b| b.faces[7][1] = b.faces[7][0]),
            ("uv_faces", |b| b.uv_faces.truncate(1)),
            ("mirror", |b| b.mirror[0] = u32::MAX),
            ("keypoints", |b| b.keypoints[1].points[2] = KeypointSource::Joint(24)),
        ];
        for (array, damage) in cases {
            let mut body = Body::test_body();
            damage(&mut body);
            assert_eq!(body.check().unwrap_err().array, array);
        }
    }
}
