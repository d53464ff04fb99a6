//! The avatar as a VRM 1.0 file: glTF with the extension `VRMC_vrm`, which tells programs for virtual persons which node is
//! which bone of a human. <https://github.com/vrm-c/vrm-specification/tree/master/specification/VRMC_vrm-1.0>
//!
//! VRM's rest pose is ours: a T-pose that faces +Z and stands on y = 0. VRM has no animations: the captured motion is in the
//! GLB alone.

use glam::{Quat, Vec3};
use serde_json::{Map, Value, json};

use super::gltf::{Rigged, Texture};
use super::{AvatarModel, RenderSpec, UvLayout, pose};
use crate::body::N_JOINTS;
use crate::body::joints::{HEAD, NECK, PELVIS, SPINE1, SPINE2, SPINE3};
use crate::camera::Camera;
use crate::picture::{Background, Light};

/// VRM's names of SMPL's joints (`humanoid.md`); SMPL's hands, the knuckles, are none of VRM's bones.
const BONES: [Option<&str>; N_JOINTS] = [
    Some("hips"),
    Some("leftUpperLeg"),
    Some("rightUpperLeg"),
    Some("spine"),
    Some("leftLowerLeg"),
    Some("rightLowerLeg"),
    Some("chest"),
    Some("leftFoot"),
    Some("rightFoot"),
    Some("upperChest"),
    Some("leftToes"),
    Some("rightToes"),
    Some("neck"),
    Some("leftShoulder"),
    Some("rightShoulder"),
    Some("head"),
    Some("leftUpperArm"),
    Some("rightUpperArm"),
    Some("leftLowerArm"),
    Some("rightLowerArm"),
    Some("leftHand"),
    Some("rightHand"),
    None,
    None,
];

/// From the root to the head.
const HEAD_CHAIN: [usize; 6] = [PELVIS, SPINE1, SPINE2, SPINE3, NECK, HEAD];

/// The side of a portrait, and what it shows of the person: head and shoulders.
const PORTRAIT_PX: u32 = 512;
const PORTRAIT_M: f64 = 0.75;

/// Builds `avatar.vrm`; `portrait` is a square picture of the person for lists of avatars.
///
/// Of what `meta.md` lets an author allow nothing is allowed: whose likeness it is, decides.
///
/// # Panics
/// When the layout has another number of faces than the body.
pub fn write_vrm(
    model: &AvatarModel,
    layout: &UvLayout,
    texture: &Texture<'_>,
    portrait: Option<&Texture<'_>>,
) -> Vec<u8> {
    let mut file = Rigged::new(model, layout, texture);
    let bones: Map<String, Value> = BONES
        .iter()
        .enumerate()
        .filter_map(|(joint, bone)| bone.map(|bone| (bone.to_owned(), json!({ "node": joint }))))
        .collect();
    let mut meta = json!({
        "name": "avatar",
        "authors": ["made with Effigy"],
        "licenseUrl": "https://vrm.dev/licenses/1.0/",
    });
    if let Some(portrait) = portrait {
        meta["thumbnailImage"] = file.image("portrait", portrait).into();
    }
    file.document["extensionsUsed"] = json!(["KHR_materials_unlit", "VRMC_vrm"]);
    file.document["extensions"] =
        json!({ "VRMC_vrm": { "specVersion": "1.0", "meta": meta, "humanoid": { "humanBones": bones } } });
    file.into_bytes()
}

/// Head and shoulders, in the captured frame in which the person faces the camera best.
///
/// # Panics
/// When the model has no frames.
pub(super) fn portrait(model: &AvatarModel) -> RenderSpec {
    let [x, y, z] = model.camera.centre().map(|x| x as f32);
    let eye = Vec3::new(x, y, z);
    let pelvis = Vec3::from(model.body.shaped_joints(&model.betas)[PELVIS]);
    let faces = |k: usize| {
        let spine = HEAD_CHAIN.iter().map(|&j| pose::joint_rotation(&model.poses[k], j)).product::<Quat>();
        (spine * Vec3::Z).dot((eye - pelvis - Vec3::from(model.transl[k])).normalize_or_zero())
    };
    let best = (0..model.poses.len()).max_by(|&a, &b| faces(a).total_cmp(&faces(b))).expect("a model has frames");
    let spec = RenderSpec::of_frame(model, best);
    let head = model.posed(&spec.pose, model.transl[best]).joints[HEAD].map(f64::from);
    let [x, y, depth] = model.camera.view(head);
    let side = f64::from(PORTRAIT_PX);
    let focal = side * depth / PORTRAIT_M;
    let [u, v] = [x, y].map(|x| focal * x / depth);
    let camera = Camera {
        width: PORTRAIT_PX,
        height: PORTRAIT_PX,
        fx: focal,
        fy: focal,
        cx: 0.5 * side - u,
        cy: 0.5 * side - v,
        distortion: [0.0; 5],
        ..model.camera.clone()
    };
    RenderSpec { camera, background: Background::Colour([222; 3]), light: Light::Captured, ..spec }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::testing::glb::Glb;
    use crate::avatar::testing::{textured, turning_avatar};
    use crate::body::PARENTS;

    /// What `humanoid.md` requires of a person with both arms and legs.
    const REQUIRED: [&str; 15] = [
        "hips",
        "spine",
        "head",
        "leftUpperLeg",
        "leftLowerLeg",
        "leftFoot",
        "rightUpperLeg",
        "rightLowerLeg",
        "rightFoot",
        "leftUpperArm",
        "leftLowerArm",
        "leftHand",
        "rightUpperArm",
        "rightLowerArm",
        "rightHand",
    ];

    /// Bones and the bones that they hang on, of those that an avatar has.
    const HANGS_ON: [(&str, &str); 21] = [
        ("spine", "hips"),
        ("chest", "spine"),
        ("upperChest", "chest"),
        ("neck", "upperChest"),
        ("head", "neck"),
        ("leftUpperLeg", "hips"),
        ("leftLowerLeg", "leftUpperLeg"),
        ("leftFoot", "leftLowerLeg"),
        ("leftToes", "leftFoot"),
        ("rightUpperLeg", "hips"),
        ("rightLowerLeg", "rightUpperLeg"),
        ("rightFoot", "rightLowerLeg"),
        ("rightToes", "rightFoot"),
        ("leftShoulder", "upperChest"),
        ("leftUpperArm", "leftShoulder"),
        ("leftLowerArm", "leftUpperArm"),
        ("leftHand", "leftLowerArm"),
        ("rightShoulder", "upperChest"),
        ("rightUpperArm", "rightShoulder"),
        ("rightLowerArm", "rightUpperArm"),
        ("rightHand", "rightLowerArm"),
    ];

    #[test]
    fn its_bones_are_those_of_a_human_in_vrms_rest_pose() {
        let model = turning_avatar();
        let vrm = Glb::parse(&textured(&model, |layout, texture| write_vrm(&model, layout, texture, Some(texture))));
        let extension = &vrm.json["extensions"]["VRMC_vrm"];
        assert_eq!(extension["specVersion"], "1.0");
        let used = vrm.json["extensionsUsed"].as_array().unwrap();
        assert!(used.contains(&"VRMC_vrm".into()));
        assert!(vrm.json.get("animations").is_none(), "VRM has no animations");
        let bones = &extension["humanoid"]["humanBones"];
        let node = |bone: &str| bones[bone]["node"].as_u64().unwrap_or_else(|| panic!("no {bone}")) as usize;
        REQUIRED.into_iter().for_each(|bone| assert!(node(bone) < N_JOINTS));
        for (bone, parent) in HANGS_ON {
            assert_eq!(PARENTS[node(bone)], node(parent) as i32, "{bone} hangs on {parent}");
        }
        assert_eq!(bones.as_object().unwrap().len(), HANGS_ON.len() + 1);

        let joints = vrm.joints(None);
        let at = |bone: &str| joints[node(bone)].w_axis;
        assert!(at("leftHand").x > 0.3 && at("rightHand").x < -0.3, "left is at +X");
        for side in ["left", "right"] {
            let arm = at(&format!("{side}Hand")) - at(&format!("{side}UpperArm"));
            assert!(arm.y.abs() < 0.05 * arm.length() && arm.z.abs() < 0.05 * arm.length(), "{side} arm: {arm}");
            assert!(at(&format!("{side}Toes")).z > at(&format!("{side}Foot")).z, "{side} toes point ahead");
        }
        let low = vrm.skinned(None).iter().map(|v| v.y).fold(f32::INFINITY, f32::min);
        assert!(low.abs() < 1e-5, "the lowest point at {low}");
    }

    #[test]
    fn its_meta_names_what_vrm_requires_and_the_portrait() {
        let model = turning_avatar();
        let meta = |portrait: bool| {
            let made =
                textured(&model, |layout, texture| write_vrm(&model, layout, texture, portrait.then_some(texture)));
            let mut vrm = Glb::parse(&made);
            (vrm.json["extensions"]["VRMC_vrm"]["meta"].take(), vrm.json["images"].as_array().unwrap().len())
        };
        let (with, images) = meta(true);
        assert_eq!((with["thumbnailImage"].as_u64(), images), (Some(1), 2));
        assert!(!with["name"].as_str().unwrap().is_empty());
        assert!(!with["authors"][0].as_str().unwrap().is_empty());
        assert_eq!(with["licenseUrl"], "https://vrm.dev/licenses/1.0/");
        let (without, images) = meta(false);
        assert_eq!((without.get("thumbnailImage"), images), (None, 1));
    }

    #[test]
    fn the_portrait_is_of_the_frame_that_faces_the_camera_with_the_head_in_its_middle() {
        let model = turning_avatar();
        let spec = portrait(&model);
        // The turning avatar's frames are 1.3 radians apart, the first looks into the camera.
        assert_eq!(spec.pose, model.poses[0]);
        let head = model.posed(&model.poses[0], model.transl[0]).joints[HEAD].map(f64::from);
        let [u, v] = spec.camera.project(spec.camera.view(head));
        let middle = 0.5 * f64::from(PORTRAIT_PX);
        assert!((u - middle).abs() < 1e-6 && (v - middle).abs() < 1e-6, "{u} {v}");
        spec.check(&model).unwrap();
    }
}
