//! `POST /v1/jobs`, with good and bad clips.

use super::*;

#[tokio::test]
async fn a_clip_becomes_a_queued_job() {
    let bench = Bench::new().await;
    let form = Form::clip().with("options", r#"{"preset": "draft", "max_frames": 3}"#);
    let reply = bench.upload(&form).await;
    let job = reply.json();
    assert_eq!(reply.status, 202, "{job}");
    let id = job["id"].as_str().unwrap();
    assert_eq!(reply.header("location"), format!("/v1/jobs/{id}"));
    assert_eq!((&job["state"], &job["queue_position"], &job["attempt"]), (&json!("queued"), &json!(1), &json!(0)));
    let warnings = ["video: images tell no frame rate: 30 a second assumed"];
    let clip = json!({ "frames": 4, "width": 32, "height": 48, "fps": job["clip"]["fps"], "warnings": warnings });
    assert_eq!(job["clip"], clip);
    assert_eq!((&job["options"]["preset"], &job["options"]["max_frames"]), (&json!("draft"), &json!(3)));
    for key in ["stage", "eta_secs", "started_at", "finished_at", "avatar", "error"] {
        assert!(job.get(key).is_some_and(Value::is_null), "{key}");
    }
    assert_eq!(bench.get(reply.header("location")).await.json(), job);
    let inputs = bench.store.inputs(id.parse().unwrap());
    for (part, content) in &Form::clip().0 {
        assert_eq!(&std::fs::read(inputs.join(part)).unwrap(), content, "{part}");
    }
}

#[tokio::test]
async fn a_video_file_is_taken() {
    let bench = Bench::new().await;
    let reply = bench.upload(&Form::clip().with("video", mp4())).await;
    assert_eq!(reply.status, 202, "{}", reply.json());
}

/// The boxes as FFmpeg encodes them.
fn mp4() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    for i in 0..FRAMES {
        std::fs::write(folder.path().join(format!("{i}.png")), picture(i, 3)).unwrap();
    }
    let out = folder.path().join("clip.mp4");
    let made = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-framerate", "25", "-i"])
        .arg(folder.path().join("%d.png"))
        .args(["-c:v", "mpeg4", "-q:v", "2"])
        .arg(&out)
        .status()
        .expect("the tests need FFmpeg");
    assert!(made.success());
    std::fs::read(out).unwrap()
}

/// Each refusal: the form, its status, the part and the frame that it must name.
async fn refused(cases: Vec<(&str, Form, u16, &str, Option<u32>)>) {
    let bench = Bench::new().await;
    for (what, form, status, part, frame) in cases {
        let problem = bench.upload(&form).await.problem(status);
        assert_eq!(problem["part"], part, "{what}: {problem}");
        assert_eq!(problem.get("frame"), frame.map(Value::from).as_ref(), "{what}: {problem}");
        assert!(problem["expected"].as_str().is_some_and(|text| !text.is_empty()), "{what}: {problem}");
        bench.assert_empty();
    }
    assert_eq!(bench.get("/v1/jobs").await.json()["jobs"], json!([]));
    // The server goes on.
    assert_eq!(bench.upload(&Form::clip()).await.status, 202);
}

#[tokio::test]
async fn bad_forms_are_refused() {
    let twice = |part: &str| {
        let mut form = Form::clip().with("options", "{}");
        let again = form.0.iter().find(|(name, _)| name == part).unwrap().clone();
        form.0.push(again);
        form
    };
    refused(vec![
        ("no video", Form::clip().without("video"), 400, "video", None),
        ("no masks", Form::clip().without("masks"), 400, "masks", None),
        ("no keypoints", Form::clip().without("keypoints"), 400, "keypoints", None),
        ("nothing", Form(Vec::new()), 400, "video", None),
        ("an unknown part", Form::clip().with("mask", "x"), 400, "mask", None),
        ("a part that is a path", Form::clip().with("../../video", "x"), 400, "../../video", None),
        ("masks twice", twice("masks"), 400, "masks", None),
        ("options twice", twice("options"), 400, "options", None),
        ("an unknown preset", Form::clip().with("options", r#"{"preset": "best"}"#), 400, "options.preset", None),
        ("an unknown option", Form::clip().with("options", r#"{"speed": 1}"#), 400, "options.speed", None),
        ("options as text", Form::clip().with("options", "draft"), 400, "options", None),
        ("an unknown body", Form::clip().with("options", r#"{"body": "alien"}"#), 422, "options.body", None),
    ])
    .await;
}

#[tokio::test]
async fn bad_videos_are_refused() {
    let whole = mp4();
    refused(vec![
        ("no video at all", Form::clip().with("video", "this is no video"), 422, "video", None),
        ("an empty file", Form::clip().with("video", ""), 422, "video", None),
        ("a truncated file", Form::clip().with("video", &whole[..whole.len() / 2]), 422, "video", None),
        ("a zip without pictures", Form::clip().with("video", zip_of([])), 422, "video", None),
    ])
    .await;
}

#[tokio::test]
async fn bad_masks_are_refused() {
    let black = || png(&vec![0; (WIDTH * HEIGHT) as usize], WIDTH, HEIGHT);
    let masks = |count: usize| (0..count).map(|i| picture(i, 1));
    let most_black = masks(1).chain([black(), black(), black()]);
    let climbing = [("../../../evil.png".to_string(), picture(0, 1))].into_iter();
    let climbing = named_zip(climbing.chain((1..FRAMES).map(|i| (format!("{i}.png"), picture(i, 1)))));
    let bomb = named_zip((0..FRAMES).map(|i| (format!("{i}.png"), vec![0; 8 << 20])));
    refused(vec![
        ("too few", Form::clip().with("masks", zip_of(masks(3))), 422, "masks", None),
        ("too many", Form::clip().with("masks", zip_of(masks(5))), 422, "masks", None),
        ("all black", Form::clip().with("masks", zip_of((0..FRAMES).map(|_| black()))), 422, "masks", None),
        ("most black", Form::clip().with("masks", zip_of(most_black)), 422, "masks", Some(1)),
        ("a climbing name", Form::clip().with("masks", climbing), 422, "masks", None),
        ("an absurd expansion", Form::clip().with("masks", bomb), 422, "masks", None),
        ("no masks but text", Form::clip().with("masks", "masks"), 422, "masks", None),
    ])
    .await;
}

#[tokio::test]
async fn masks_of_another_size_are_refused() {
    let bench = Bench::new().await;
    let small = zip_of((0..FRAMES).map(|_| png(&vec![255; 24 * 24], 24, 24)));
    let problem = bench.upload(&Form::clip().with("masks", small)).await.problem(422);
    assert_eq!(problem["part"], "masks", "{problem}");
    bench.assert_empty();
}

#[tokio::test]
async fn bad_keypoints_are_refused() {
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut json = keypoints(FRAMES);
        change(&mut json);
        Form::clip().with("keypoints", json.to_string())
    };
    let nan = keypoints(FRAMES).to_string().replacen("0.9", "NaN", 18);
    refused(vec![
        ("too few frames", changed(&|k| drop(k["frames"].as_array_mut().unwrap().pop())), 422, "keypoints", None),
        ("too few points", changed(&|k| drop(k["frames"][2].as_array_mut().unwrap().pop())), 422, "keypoints", Some(2)),
        ("a string", changed(&|k| k["frames"][1][3][0] = json!("12")), 422, "keypoints", Some(1)),
        ("NaN", Form::clip().with("keypoints", nan), 422, "keypoints", Some(0)),
        ("an unknown format", changed(&|k| k["format"] = json!("coco99")), 422, "keypoints", None),
        ("no JSON", Form::clip().with("keypoints", "{"), 422, "keypoints", None),
    ])
    .await;
}

#[tokio::test]
async fn bad_cameras_and_poses_are_refused() {
    let camera =
        |fx: f64| json!({ "width": WIDTH, "height": HEIGHT, "fx": fx, "fy": 60, "cx": 16, "cy": 24 }).to_string();
    refused(vec![
        ("a focal length of zero", Form::clip().with("camera", camera(0.0)), 422, "camera", None),
        ("no JSON", Form::clip().with("camera", "f=60"), 422, "camera", None),
        ("no archive", Form::clip().with("poses", "poses"), 422, "poses", None),
    ])
    .await;
    let bench = Bench::new().await;
    assert_eq!(bench.upload(&Form::clip().with("camera", camera(60.0))).await.status, 202);
}

#[tokio::test]
async fn what_is_no_form_is_refused() {
    let bench = Bench::new().await;
    let text = bench.call(Method::POST, "/v1/jobs", &[("content-type", "text/plain")], "{}").await.problem(415);
    assert!(text["detail"].as_str().unwrap().starts_with("the content type is \"text/plain\""), "{text}");
    bench.call(Method::POST, "/v1/jobs", &[("content-type", "application/json")], "{}").await.problem(400);
    bench.post("/v1/jobs").await.problem(415);
    let mut cut = Form::clip().body();
    cut.truncate(cut.len() / 2);
    bench.call(Method::POST, "/v1/jobs", &[("content-type", Form::TYPE)], cut).await.problem(400);
    bench.assert_empty();
}

#[tokio::test]
async fn too_much_is_refused_with_the_limit() {
    let bench = Bench::with_limits(Limits { upload_bytes: 100_000, ..Limits::default() }).await;
    let large = Form::clip().with("video", vec![0; 200_000]);
    let problem = bench.upload(&large).await.problem(413);
    assert_eq!((&problem["part"], &problem["expected"]), (&json!("video"), &json!("at most 100000 bytes")));
    let length = [("content-type", Form::TYPE), ("content-length", "5000000000")];
    let problem = bench.call(Method::POST, "/v1/jobs", &length, Body::empty()).await.problem(413);
    assert_eq!(problem["expected"], "at most 100000 bytes");
    let options = Form::clip().with("options", vec![b' '; 70_000]);
    assert_eq!(bench.upload(&options).await.problem(413)["part"], "options");
    let bench_of_more = Bench::new().await;
    for part in ["uploads", "camera"] {
        let problem = bench_of_more.upload(&Form::clip().with(part, vec![b' '; 70_000])).await.problem(413);
        assert_eq!((&problem["part"], &problem["expected"]), (&json!(part), &json!("at most 65536 bytes")));
    }
    bench.assert_empty();
    assert_eq!(bench.upload(&Form::clip()).await.status, 202);
}
