use glam::{Mat4, Quat, Vec3};

use super::*;
use crate::avatar::testing::glb::{Glb, f32_of};
use crate::avatar::testing::{textured, turning_avatar};
use crate::avatar::{UvLayout, write_vrm};

fn export(model: &AvatarModel) -> Vec<u8> {
    textured(model, |layout, texture| write_glb(model, layout, texture))
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
fn the_albedo_is_unlit_unless_the_lit_variant_is_chosen() {
    let document = Glb::parse(&export(&turning_avatar())).json;
    let primitive = &document["meshes"][0]["primitives"][0];
    let of_variant = |name: &str| {
        let variants = document["extensions"]["KHR_materials_variants"]["variants"].as_array().unwrap();
        let variant = variants.iter().position(|v| v["name"] == name).unwrap_or_else(|| panic!("no variant {name}"));
        let mappings = primitive["extensions"]["KHR_materials_variants"]["mappings"].as_array().unwrap();
        let mapped = |m: &&Value| m["variants"].as_array().unwrap().contains(&variant.into());
        &document["materials"][mappings.iter().find(mapped).unwrap()["material"].as_u64().unwrap() as usize]
    };
    let unlit = |material: &Value| material["extensions"].get("KHR_materials_unlit").is_some();
    let shown = &document["materials"][primitive["material"].as_u64().unwrap() as usize];
    assert!(unlit(shown) && shown == of_variant("captured"));
    let lit = of_variant("lit");
    assert!(!unlit(lit));
    assert_eq!(lit["pbrMetallicRoughness"], shown["pbrMetallicRoughness"]);
    for extension in ["KHR_materials_unlit", "KHR_materials_variants"] {
        assert!(document["extensionsUsed"].as_array().unwrap().contains(&extension.into()));
    }
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
    let vrm = textured(&still, |layout, texture| write_vrm(&still, layout, texture, Some(texture)));
    std::fs::write(folder.path().join("still.vrm"), vrm).unwrap();
    check.arg(folder.path().join("still.vrm"));
    let output = check.output().expect("node starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    eprint!("{}", String::from_utf8_lossy(&output.stdout));
}
