use glam::{Mat4, Quat, Vec3, Vec4};
use serde_json::Value;

use super::*;
use crate::avatar::testing::turning_avatar;
use crate::avatar::{UvLayout, bake};

/// A GLB read back by the rules of the format, knowing nothing of the writer.
struct Glb {
    json: Value,
    binary: Vec<u8>,
}

impl Glb {
    fn parse(bytes: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let json_len = word(12);
        assert!(json_len % 4 == 0 && &bytes[16..20] == b"JSON");
        let json = serde_json::from_slice(&bytes[20..20 + json_len]).unwrap();
        let at = 20 + json_len;
        assert_eq!(&bytes[at + 4..at + 8], b"BIN\0");
        assert_eq!(at + 8 + word(at), bytes.len());
        Self { json, binary: bytes[at + 8..].to_vec() }
    }

    /// Rows of an accessor as numbers.
    fn accessor(&self, index: &Value) -> Vec<Vec<f32>> {
        let accessor = &self.json["accessors"][index.as_u64().unwrap() as usize];
        let view = &self.json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let offset = view["byteOffset"].as_u64().unwrap() as usize;
        let bytes = &self.binary[offset..offset + view["byteLength"].as_u64().unwrap() as usize];
        assert_eq!(offset % 4, 0);
        let numbers: Vec<f32> = match accessor["componentType"].as_u64().unwrap() {
            5121 => bytes.iter().map(|&b| b as f32).collect(),
            5125 => bytes.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b) as f32).collect(),
            5126 => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
            other => panic!("component type {other}"),
        };
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            other => panic!("type {other}"),
        };
        assert_eq!(numbers.len(), width * accessor["count"].as_u64().unwrap() as usize);
        numbers.chunks(width).map(<[f32]>::to_vec).collect()
    }

    fn attribute(&self, name: &str) -> Vec<Vec<f32>> {
        self.accessor(&self.json["meshes"][0]["primitives"][0]["attributes"][name])
    }

    /// World matrices of the joints at keyframe `k` of the animation, or at rest.
    fn joints(&self, k: Option<usize>) -> Vec<Mat4> {
        let nodes = self.json["nodes"].as_array().unwrap();
        let mut local: Vec<(Vec3, Quat)> = nodes
            .iter()
            .map(|n| {
                let t = n["translation"].as_array();
                let t = t.map_or(Vec3::ZERO, |t| Vec3::from_slice(&t.iter().map(f32_of).collect::<Vec<_>>()));
                (t, Quat::IDENTITY)
            })
            .collect();
        let animation = &self.json["animations"][0];
        for channel in animation["channels"].as_array().unwrap() {
            let Some(k) = k else { break };
            let sampler = &animation["samplers"][channel["sampler"].as_u64().unwrap() as usize];
            let value = &self.accessor(&sampler["output"])[k];
            let node = &mut local[channel["target"]["node"].as_u64().unwrap() as usize];
            match channel["target"]["path"].as_str().unwrap() {
                "translation" => node.0 = Vec3::from_slice(value),
                "rotation" => node.1 = Quat::from_slice(value),
                other => panic!("path {other}"),
            }
        }
        let mut world = vec![Mat4::NAN; nodes.len()];
        let mut stack: Vec<(usize, Mat4)> = self.json["scenes"][0]["nodes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|n| (n.as_u64().unwrap() as usize, Mat4::IDENTITY))
            .collect();
        while let Some((node, parent)) = stack.pop() {
            world[node] = parent * Mat4::from_rotation_translation(local[node].1, local[node].0);
            let children = nodes[node]["children"].as_array().into_iter().flatten();
            stack.extend(children.map(|c| (c.as_u64().unwrap() as usize, world[node])));
        }
        world
    }

    /// The skinned positions (glTF 2.0, section 3.7.3.3).
    fn skinned(&self, k: Option<usize>) -> Vec<Vec3> {
        let skin = &self.json["skins"][0];
        let world = self.joints(k);
        let inverse = self.accessor(&skin["inverseBindMatrices"]);
        let matrices: Vec<Mat4> = skin["joints"]
            .as_array()
            .unwrap()
            .iter()
            .zip(&inverse)
            .map(|(j, m)| world[j.as_u64().unwrap() as usize] * Mat4::from_cols_slice(m))
            .collect();
        let (positions, joints, weights) =
            (self.attribute("POSITION"), self.attribute("JOINTS_0"), self.attribute("WEIGHTS_0"));
        (0..positions.len())
            .map(|v| {
                let p = Vec3::from_slice(&positions[v]).extend(1.0);
                let sum = (0..4).map(|k| weights[v][k] * (matrices[joints[v][k] as usize] * p)).sum::<Vec4>();
                sum.truncate()
            })
            .collect()
    }
}

fn f32_of(value: &Value) -> f32 {
    value.as_f64().unwrap() as f32
}

/// A small baked texture by the vertices' positions; needs no device.
pub(super) fn export(model: &AvatarModel) -> Vec<u8> {
    let layout = UvLayout::of_body(&model.body);
    let image =
        bake::<std::convert::Infallible>(&layout, 64, |points| Ok(vec![[0.8, 0.5, 0.2]; points.len()])).unwrap();
    let mut png = std::io::Cursor::new(Vec::new());
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    write_glb(model, &layout, &Texture { bytes: png.get_ref(), mime: "image/png" })
}

/// For each vertex of the file, the body's vertex: the same split again.
fn body_vertices(model: &AvatarModel) -> Vec<usize> {
    let split = split(&model.body.faces, &UvLayout::of_body(&model.body));
    split.corners.iter().map(|c| c[0] as usize).collect()
}

#[test]
fn the_animated_file_reproduces_our_skinning_at_every_frame() {
    let model = turning_avatar();
    let glb = Glb::parse(&export(&model));
    let rows: Vec<f32> =
        glb.json["asset"]["extras"]["gltf_from_world"].as_array().unwrap().iter().map(f32_of).collect();
    let gltf_from_world = Mat4::from_cols_slice(&rows).transpose();
    let sources = body_vertices(&model);
    for k in 0..model.poses.len() {
        let ours = model.posed(&model.poses[k], model.transl[k]).vertices;
        for (theirs, &source) in glb.skinned(Some(k)).iter().zip(&sources) {
            let want = gltf_from_world.transform_point3(Vec3::from(ours[source]));
            assert!(theirs.distance(want) < 1e-4, "frame {k}, vertex {source}: {theirs}, expected {want}");
        }
    }
}

#[test]
fn the_person_stands_upright_on_the_ground_at_rest_and_in_motion() {
    let model = turning_avatar();
    let glb = Glb::parse(&export(&model));
    for k in [None, Some(0), Some(3)] {
        let (skinned, joints) = (glb.skinned(k), glb.joints(k));
        let low = skinned.iter().map(|v| v.y).fold(f32::INFINITY, f32::min);
        assert!(low.abs() < if k.is_none() { 1e-5 } else { 0.06 }, "frame {k:?}: lowest point at {low}");
        let head = joints[15].w_axis.y - joints[0].w_axis.y;
        assert!(head > 0.5, "frame {k:?}: the head is {head} above the pelvis");
    }
    // Facing +Z at rest: the toes lie before the ankles.
    let rest = glb.joints(None);
    assert!(rest[10].w_axis.z > rest[7].w_axis.z);
}

#[test]
fn keyframes_follow_the_video_and_turn_the_short_way() {
    let model = turning_avatar();
    let glb = Glb::parse(&export(&model));
    let animation = &glb.json["animations"][0];
    assert_eq!(animation["channels"].as_array().unwrap().len(), 25);
    let times = glb.accessor(&animation["samplers"][0]["input"]);
    assert_eq!(times.iter().map(|t| t[0]).collect::<Vec<_>>(), [0, 2, 4, 6, 8].map(|f| f as f32 / 30.0));
    for sampler in &animation["samplers"].as_array().unwrap()[1..] {
        for pair in glb.accessor(&sampler["output"]).windows(2) {
            let dot: f32 = pair[0].iter().zip(&pair[1]).map(|(a, b)| a * b).sum();
            assert!(dot >= 0.0);
        }
    }
}

/// The direction of the spine in the second frame of a person before a camera that is tilted by so many radians.
fn spine_after_tilt(mut model: AvatarModel, tilt: f32) -> Vec3 {
    let tilt = Quat::from_rotation_x(tilt);
    for (pose, transl) in model.poses.iter_mut().zip(&mut model.transl) {
        let root = tilt * pose::joint_rotation(pose, 0);
        pose[..3].copy_from_slice(&root.to_scaled_axis().to_array());
        *transl = (tilt * Vec3::from(*transl)).into();
    }
    let joints = Glb::parse(&export(&model)).joints(Some(1));
    (joints[15].w_axis - joints[0].w_axis).truncate().normalize()
}

#[test]
fn a_tilted_camera_is_levelled() {
    let partly = turning_avatar;
    let untilted = spine_after_tilt(partly(), 0.0);
    assert!(spine_after_tilt(partly(), 0.3).y > 0.999);
    assert!(spine_after_tilt(partly(), 0.1).y < 0.996, "who is seen from one side may lean");
    // All the way round a lean of the camera's is told from the person's own.
    let mut round = turning_avatar();
    let n = 12;
    let [pose, transl] = [round.poses[0].to_vec(), round.transl[0].to_vec()];
    let root = pose::joint_rotation(&round.poses[0], 0);
    round.frames = (0..n).collect();
    round.transl = vec![transl.try_into().unwrap(); n as usize];
    let turned = |i: u32| {
        let mut pose: pose::Pose = pose.clone().try_into().unwrap();
        let turn = Quat::from_rotation_y(i as f32 * std::f32::consts::TAU / n as f32);
        pose[..3].copy_from_slice(&(turn * root).to_scaled_axis().to_array());
        pose
    };
    round.poses = (0..n).map(turned).collect();
    let spine = spine_after_tilt(round, 0.1);
    assert!(spine.y > untilted.y - 1e-3, "{spine}, {untilted} untilted");
}

#[test]
fn vertices_split_at_texture_seams_only() {
    let model = turning_avatar();
    let glb = Glb::parse(&export(&model));
    let (body, layout) = (&model.body, UvLayout::of_body(&model.body));
    let pairs: std::collections::HashSet<_> =
        body.faces.iter().flatten().zip(layout.uv_faces.iter().flatten()).collect();
    assert_eq!(glb.attribute("POSITION").len(), pairs.len());
    let primitive = &glb.json["meshes"][0]["primitives"][0];
    assert_eq!(glb.accessor(&primitive["indices"]).len(), 3 * body.n_faces());
}

#[test]
fn influences_are_merged_and_normalised() {
    let (joints, weights) = influences([3, 7, 3, 9], [0.2, 0.0, 0.2, 0.6]);
    assert_eq!(joints, [3, 9, 0, 0]);
    assert!((weights[0] - 0.4).abs() < 1e-6 && (weights[1] - 0.6).abs() < 1e-6 && weights[2..] == [0.0, 0.0]);
}

/// The Khronos validator, where `npm ci` has put it (tools/gltf-validate); CI requires it.
#[test]
fn the_khronos_validator_finds_no_errors_and_no_warnings() {
    let tool = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/gltf-validate");
    if !tool.join("node_modules/gltf-validator").is_dir() {
        assert!(std::env::var_os("CI").is_none(), "CI requires `npm ci --prefix tools/gltf-validate`");
        eprintln!("ignored: the validator is not installed (npm ci --prefix tools/gltf-validate)");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let moving = turning_avatar();
    let still = AvatarModel { frames: vec![7], poses: vec![moving.poses[1]], transl: vec![[0.0; 3]], ..moving.clone() };
    let mut check = std::process::Command::new("node");
    check.arg(tool.join("validate.mjs"));
    for (name, model) in [("moving.glb", &moving), ("still.glb", &still)] {
        std::fs::write(folder.path().join(name), export(model)).unwrap();
        check.arg(folder.path().join(name));
    }
    let output = check.output().expect("node starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    eprint!("{}", String::from_utf8_lossy(&output.stdout));
}
