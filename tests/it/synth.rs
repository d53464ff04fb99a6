//! A made clip and its evaluation: an avatar with the clip's own truth must score as the truth.

use std::path::Path;
use std::sync::Arc;

use effigy::avatar::{AvatarModel, Renderer, ply};
use effigy::body::Body;
use effigy::camera::Camera;
use effigy::eval::{EvalOptions, ImageFigures, NovelPose, Subject, evaluate};
use effigy::npz::Npz;
use effigy::ops::texture_field::{TextureFieldConfig, TextureFieldParams};
use effigy::synth::{SynthOptions, synthesise};

fn options() -> SynthOptions {
    SynthOptions { frames: 4, size_px: 96, truths: 2, seed: 11, ..SynthOptions::default() }
}

/// The avatar that the folder's truth describes, all in one colour.
fn truth_avatar(folder: &Path) -> AvatarModel {
    let body = Body::test_body();
    let npz = Npz::open(&folder.join("truth/poses.npz")).unwrap();
    let betas = npz.get("betas").unwrap().f32();
    let canonical = std::fs::File::open(folder.join("truth/canonical.ply")).unwrap();
    let canonical = ply::read(std::io::BufReader::new(canonical)).unwrap();
    let (shaped, pelvis) = (body.shaped_vertices(&betas), body.shaped_joints(&betas)[0]);
    let minus = |a: [f32; 3], b: [f32; 3]| -> [f32; 3] { std::array::from_fn(|k| a[k] - b[k]) };
    let poses: Vec<[f32; 72]> = npz.get("poses").unwrap().f32().as_chunks().0.to_vec();
    let trans: Vec<[f32; 3]> = npz.get("trans").unwrap().f32().as_chunks().0.to_vec();
    let camera: Camera = serde_json::from_slice(&std::fs::read(folder.join("camera.json")).unwrap()).unwrap();
    let texture_config = TextureFieldConfig { n_levels: 2, log2_hashmap_size: 8, ..Default::default() };
    AvatarModel {
        offsets: canonical.vertices.iter().zip(shaped).map(|(&v, s)| minus(v, s)).collect(),
        texcoords: vec![[0.5; 3]; body.n_vertices()],
        texture: TextureFieldParams::zeros(&texture_config),
        texture_config,
        light: effigy::ops::light::Light::EVEN,
        face_colours: vec![[0.5; 3]; body.n_faces()],
        frames: (0..poses.len() as u32).collect(),
        transl: trans.into_iter().map(|t| minus(t, pelvis)).collect(),
        pelvis_moved: [0.0; 3],
        poses,
        fps: 30.0,
        camera,
        betas,
        body,
    }
}

#[test]
fn the_truth_scores_as_the_truth_and_a_moved_one_by_how_far_it_moved() {
    let Some(gpu) = crate::fit::gpu("the_truth_scores_as_the_truth_and_a_moved_one_by_how_far_it_moved") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut frames = 0;
    synthesise(&gpu, &Body::test_body(), &options(), folder.path(), |done, _| frames = done).unwrap();
    assert_eq!(frames, 4);
    let subject = Subject::open(folder.path()).unwrap();
    assert_eq!((subject.views.len(), subject.poses.len(), subject.surfaces.len()), (2, 2, 2));

    let truth = truth_avatar(folder.path());
    let out = folder.path().join("pictures");
    std::fs::create_dir(&out).unwrap();
    let renderer = Renderer::new(&gpu, &Arc::new(truth.clone())).unwrap();
    let report =
        evaluate(&renderer, &subject, &EvalOptions { out: Some(&out), ..EvalOptions::default() }, |_| {}).unwrap();
    let s = &report.summary;
    assert!(s.mask_iou.unwrap() > 0.995, "{s:?}");
    assert!(s.chamfer_cm.unwrap() < 1e-3 && s.unaligned_point_to_surface_cm.unwrap() < 1e-3, "{s:?}");
    assert!(s.joints_cm.unwrap() < 1e-3, "{s:?}");
    // The silhouettes agree; the avatar is grey where the truth has colours. A picture with nobody in it would have 16 dB.
    for means in [&s.novel_views, &s.novel_poses].map(|m| m.as_ref().unwrap()) {
        assert!(means.psnr_db > 22.0 && means.psnr_foreground_db.unwrap() < means.psnr_db, "{s:?}");
        assert!(means.flip > 0.0 && means.flip_foreground.unwrap() > 2.0 * means.flip, "{s:?}");
    }
    let page = std::fs::read_to_string(out.join("eval.html")).unwrap();
    assert_eq!(page.matches("<img").count(), 10, "four pictures, as given and in our scale, and two views aligned");
    assert!(page.contains("view_01: PSNR") && page.contains("pose_00: PSNR"));
    assert!(report.warnings.is_empty());
    for folder in [out.clone(), out.join("scaled")] {
        let files = std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().path());
        assert_eq!(files.filter(|path| path.extension().is_some_and(|e| e == "png")).count(), 4);
    }

    // A pose is drawn where the list has it: a hand's breadth aside it is another picture.
    let mut aside = Subject::default();
    aside.poses = subject.poses.clone();
    for novel in &mut aside.poses {
        let NovelPose::Pose(_, pelvis) = &mut novel.pose else { panic!("{novel:?}") };
        pelvis[0] += 0.1;
    }
    let off =
        evaluate(&renderer, &aside, &EvalOptions::default(), |_| {}).unwrap().summary.novel_poses.unwrap().psnr_db;
    assert!(off < s.novel_poses.as_ref().unwrap().psnr_db - 2.0, "{off} dB");

    // A fit that found a focal length of its own has the person's size, and sees it from as much further away.
    let mut far = truth.clone();
    (far.camera.fx, far.camera.fy) = (1.1 * far.camera.fx, 1.1 * far.camera.fy);
    far.transl.iter_mut().for_each(|t| t[2] *= 1.1);
    let report =
        evaluate(&Renderer::new(&gpu, &Arc::new(far)).unwrap(), &subject, &EvalOptions::default(), |_| {}).unwrap();
    let far = &report.summary;
    assert!(far.scale.unwrap() < 0.95 && (far.size.unwrap() - 1.0).abs() < 0.005, "{far:?}");
    let psnr = |means: &Option<ImageFigures>| means.as_ref().unwrap().psnr_db;
    assert!((psnr(&far.scaled_novel_poses) - psnr(&s.scaled_novel_poses)).abs() < 0.2, "{far:?}");
    assert!(psnr(&far.scaled_novel_views) < psnr(&s.scaled_novel_views) - 0.5, "{far:?}");

    let scaled = s.scaled_novel_poses.clone();

    let mut moved = truth;
    moved.transl.iter_mut().for_each(|t| t[0] += 0.03);
    let report =
        evaluate(&Renderer::new(&gpu, &Arc::new(moved)).unwrap(), &subject, &EvalOptions::default(), |_| {}).unwrap();
    let s = &report.summary;
    assert!((s.joints_cm.unwrap() - 3.0).abs() < 1e-3 && s.joints_root_aligned_cm.unwrap() < 1e-3, "{s:?}");
    assert!(s.unaligned_chamfer_cm.unwrap() > 1.0 && s.chamfer_cm.unwrap() < 0.02, "{s:?}");
    assert!(s.mask_iou.unwrap() < 0.95, "{s:?}");
    // The avatar is off its place, but not when its surface is laid onto the truth's.
    let [views, aligned] = [&s.novel_views, &s.aligned_novel_views].map(|m| m.as_ref().unwrap().psnr_db);
    assert!(aligned > views + 0.3, "{aligned} dB against {views} dB");

    // A camera that cannot be read costs nothing but what it would have told.
    std::fs::write(folder.path().join("camera.json"), "{").unwrap();
    let mut unread = Subject::open(folder.path()).unwrap().without_masks();
    unread.views.clear();
    let report = evaluate(&renderer, &unread, &EvalOptions::default(), |_| {}).unwrap();
    assert!(report.warnings[0].contains("camera.json") && report.warnings.len() == 1, "{:?}", report.warnings);
    let [poses, before] = [&report.summary.scaled_novel_poses, &scaled].map(psnr);
    assert!((poses - before).abs() < 1e-6, "{poses} dB, {before} dB with the camera");
}

#[test]
fn a_clip_is_the_same_for_the_same_seed() {
    let Some(gpu) = crate::fit::gpu("a_clip_is_the_same_for_the_same_seed") else { return };
    let made = |seed: u64| {
        let folder = tempfile::tempdir().unwrap();
        let options = SynthOptions { frames: 1, size_px: 48, truths: 1, seed, ..SynthOptions::default() };
        synthesise(&gpu, &Body::test_body(), &options, folder.path(), |_, _| {}).unwrap();
        ["frame_0000.png", "keypoints.json", "truth/poses.npz", "novel/pose_00.png"]
            .map(|name| std::fs::read(folder.path().join(name)).unwrap())
    };
    let first = made(3);
    assert!(first == made(3));
    assert!(first != made(4));
}

#[test]
fn absurd_options_are_refused() {
    let Some(gpu) = crate::fit::gpu("absurd_options_are_refused") else { return };
    let folder = tempfile::tempdir().unwrap();
    for options in [SynthOptions { frames: 0, ..options() }, SynthOptions { size_px: 97, ..options() }] {
        assert!(synthesise(&gpu, &Body::test_body(), &options, folder.path(), |_, _| {}).is_err());
    }
}

#[test]
fn keypoints_without_noise_are_the_projected_joints() {
    let Some(gpu) = crate::fit::gpu("keypoints_without_noise_are_the_projected_joints") else { return };
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { keypoint_noise_px: 0.0, ..options() };
    synthesise(&gpu, &Body::test_body(), &options, folder.path(), |_, _| {}).unwrap();
    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(folder.path().join(name)).unwrap()).unwrap()
    };
    let (keypoints, joints, camera) = (json("keypoints.json"), json("truth/joints3d.json"), json("camera.json"));
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let (mut seen, mut hidden) = (0, 0);
    for t in 0..options.frames {
        // COCO's elbows, wrists, knees and ankles, and SMPL's.
        for (coco, smpl) in [(7, 18), (8, 19), (9, 20), (10, 21), (13, 4), (14, 5), (15, 7), (16, 8)] {
            let (k, j) = (&keypoints["frames"][t][coco], &joints["frames"][t][smpl]);
            match number(&k[2]) {
                0.0 => assert_eq!((number(&k[0]), number(&k[1])), (0.0, 0.0)),
                confidence => {
                    seen += (confidence > 0.5) as u32;
                    hidden += (confidence == 0.3) as u32;
                    let project = |f: &str, c: &str, axis: usize| {
                        number(&camera[f]) * number(&j[axis]) / number(&j[2]) + number(&camera[c])
                    };
                    assert!((number(&k[0]) - project("fx", "cx", 0)).abs() < 1e-3, "frame {t}, keypoint {coco}");
                    assert!((number(&k[1]) - project("fy", "cy", 1)).abs() < 1e-3, "frame {t}, keypoint {coco}");
                }
            }
        }
    }
    // From the side one arm or leg hides the other; from the front nothing does.
    assert!(seen > hidden && hidden > 0, "{seen} seen, {hidden} hidden");
}
