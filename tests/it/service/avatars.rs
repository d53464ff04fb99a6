//! `/v1/avatars`: files, meshes, renders.

use std::future::Future;

use effigy::jobs::render::{PoseSource, What};
use effigy::picture::Background;

use super::*;

const GLB: &[u8] = b"glTF0123456789";

async fn avatar(bench: &Bench) -> String {
    let files: [(&str, &[u8]); 3] = [("avatar.glb", GLB), ("report.json", b"{}"), ("mesh.ply", b"ply\nT-pose")];
    format!("/v1/avatars/{}", bench.publish(&files).await)
}

#[tokio::test]
async fn an_avatar_lists_its_files() {
    let bench = Bench::new().await;
    let path = avatar(&bench).await;
    let avatar = bench.get(&path).await.json();
    let id = path.rsplit('/').next().unwrap();
    assert_eq!((&avatar["id"], &avatar["body"], &avatar["frames"]), (&json!(id), &json!("default"), &json!(5)));
    assert_eq!((&avatar["camera"]["width"], &avatar["metrics"]), (&json!(64), &json!({ "iou": 0.95 })));
    assert_eq!(avatar["files"]["avatar.glb"], format!("{path}/avatar.glb"));
    let job = bench.get(&format!("/v1/jobs/{}", avatar["job"].as_str().unwrap())).await.json();
    assert_eq!((&job["avatar"], &job["state"], &job["progress"]), (&json!(id), &json!("succeeded"), &json!(1.0)));
    for url in avatar["files"].as_object().unwrap().values() {
        assert_eq!(bench.get(url.as_str().unwrap()).await.status, 200);
    }
}

#[tokio::test]
async fn a_file_is_sent_whole_in_ranges_or_not_at_all() {
    let bench = Bench::new().await;
    let path = format!("{}/avatar.glb", avatar(&bench).await);
    let whole = bench.get(&path).await;
    assert_eq!((whole.status.as_u16(), whole.body.as_slice()), (200, GLB));
    assert_eq!(whole.header("content-type"), "model/gltf-binary");
    assert_eq!(whole.header("content-disposition"), "attachment; filename=\"avatar.glb\"");
    assert_eq!((whole.header("content-length"), whole.header("accept-ranges")), ("14", "bytes"));
    let etag = whole.header("etag").to_string();
    assert_eq!(etag.len(), 66, "a strong tag of SHA-256: {etag}");

    let ask = |name: &'static str, value: String| {
        let (bench, path) = (&bench, &path);
        async move { bench.call(Method::GET, path, &[(name, &value)], Body::empty()).await }
    };
    for (range, content, place) in [
        ("bytes=4-7", &GLB[4..8], "bytes 4-7/14"),
        ("bytes=10-", &GLB[10..], "bytes 10-13/14"),
        ("bytes=-3", &GLB[11..], "bytes 11-13/14"),
    ] {
        let part = ask("range", range.into()).await;
        assert_eq!((part.status.as_u16(), part.body.as_slice()), (206, content), "{range}");
        assert_eq!((part.header("content-range"), part.header("etag")), (place, etag.as_str()));
    }
    let beyond = ask("range", "bytes=14-".into()).await;
    beyond.problem(416);
    assert_eq!(beyond.header("content-range"), "bytes */14");
    for range in ["bytes=0-1,4-5", "bytes=x", "lines=1-2"] {
        assert_eq!(ask("range", range.into()).await.status, 200, "{range}");
    }

    for tags in [etag.clone(), format!("\"other\", W/{etag}"), "*".into()] {
        let same = ask("if-none-match", tags).await;
        assert_eq!((same.status.as_u16(), same.body.len(), same.header("etag")), (304, 0, etag.as_str()));
    }
    assert_eq!(ask("if-none-match", "\"other\"".into()).await.status, 200);
    for (tag, status) in [(etag.as_str(), 206), ("\"other\"", 200)] {
        let headers = [("range", "bytes=0-3"), ("if-range", tag)];
        assert_eq!(bench.call(Method::GET, &path, &headers, Body::empty()).await.status, status);
    }
    let head = bench.call(Method::HEAD, &path, &[], Body::empty()).await;
    assert_eq!((head.status.as_u16(), head.body.len(), head.header("content-length")), (200, 0, "14"));
}

#[tokio::test]
async fn a_report_is_shown_and_can_do_nothing() {
    let bench = Bench::new().await;
    let files: [(&str, &[u8]); 2] = [("avatar.glb", GLB), ("report.html", b"<!doctype html><title>report</title>")];
    let path = format!("/v1/avatars/{}/report.html", bench.publish(&files).await);
    let page = bench.get(&path).await;
    assert_eq!(page.header("content-type"), "text/html; charset=utf-8");
    assert!(page.header("content-disposition").starts_with("inline"));
    let policy = page.header("content-security-policy");
    assert!(policy.starts_with("sandbox;") && policy.contains("default-src 'none'"), "{policy}");
    assert_eq!(page.header("x-content-type-options"), "nosniff");
}

#[tokio::test]
async fn a_vrm_is_a_glb_by_its_type() {
    let bench = Bench::new().await;
    let path = format!("/v1/avatars/{}/avatar.vrm", bench.publish(&[("avatar.vrm", GLB)]).await);
    let reply = bench.get(&path).await;
    assert_eq!((reply.header("content-type"), reply.body.as_slice()), ("model/gltf-binary", GLB));
    assert_eq!(reply.header("content-disposition"), "attachment; filename=\"avatar.vrm\"");
}

#[tokio::test]
async fn unknown_files_stay_unknown() {
    let bench = Bench::new().await;
    let path = avatar(&bench).await;
    for name in ["avatar.fbx", "..%2F..%2Feffigy.db", "%2e%2e", "model.npz"] {
        bench.get(&format!("{path}/{name}")).await.problem(404);
    }
    bench.get(&format!("/v1/avatars/{}", Uuid::nil())).await.problem(404);
    bench.get("/v1/avatars/me/avatar.glb").await.problem(404);
}

#[tokio::test]
async fn a_mesh_is_the_t_pose_or_a_frame() {
    let bench = Bench::new().await;
    let path = format!("{}/mesh.ply", avatar(&bench).await);
    assert_eq!(bench.get(&path).await.body, b"ply\nT-pose");
    assert_eq!(bench.get(&format!("{path}?frame=4")).await.body, b"drawn");
    assert_eq!(bench.draws.asked.lock().unwrap()[0].what, What::Mesh { frame: 4 });
    let problem = bench.get(&format!("{path}?frame=5")).await.problem(422);
    assert_eq!((&problem["part"], &problem["expected"]), (&json!("frame"), &json!("0 to 4")));
    for query in ["frame=-1", "frame=x", "pose=1"] {
        bench.get(&format!("{path}?{query}")).await.problem(400);
    }
}

#[tokio::test]
async fn a_render_reaches_the_worker_and_leaves_nothing_behind() {
    let bench = Bench::new().await;
    let path = format!("{}/renders", avatar(&bench).await);
    let camera = json!({ "width": 320, "height": 240, "fx": 300, "fy": 300, "cx": 160, "cy": 120 });
    let body =
        json!({ "pose": vec![0; 72], "pelvis": [0, 0, 3], "camera": camera, "background": "#ffffff", "format": "png" });
    let reply = bench.post_json(&path, &body).await;
    assert_eq!((reply.status.as_u16(), reply.body.as_slice()), (200, b"drawn".as_slice()));
    assert_eq!(reply.header("content-type"), "image/png");
    let asked = bench.draws.asked.lock().unwrap().pop().unwrap();
    assert!(asked.model.ends_with("results/1/model.npz"), "{asked:?}");
    let What::Image(image) = asked.what else { panic!() };
    assert!(matches!(image.pose, PoseSource::Given { .. }));
    assert_eq!((image.camera.width, image.background), (320, Background::Colour([255; 3])));
    assert_eq!(std::fs::read_dir(bench.store.renders()).unwrap().count(), 0);
}

#[tokio::test]
async fn bad_renders_are_refused() {
    let bench = Bench::new().await;
    let path = format!("{}/renders", avatar(&bench).await);
    let sized = |side: u32| json!({ "width": side, "height": 10, "fx": 9, "fy": 9, "cx": 5, "cy": 5 });
    let with = |field: &str, value: Value| {
        let mut camera = sized(10);
        camera[field] = value;
        camera
    };
    for (body, part) in [
        (json!({ "pose": vec![0; 71] }), "pose"),
        (json!({ "frame": 0, "betas": vec![0; 17] }), "betas"),
        (json!({ "frame": 99 }), "frame"),
        (json!({ "frame": 0, "camera": sized(0) }), "camera.width"),
        (json!({ "frame": 0, "camera": sized(100_000) }), "camera.width"),
    ] {
        let problem = bench.post_json(&path, &body).await.problem(422);
        assert_eq!(problem["part"], part, "{problem}");
        assert!(problem["expected"].is_string());
    }
    let nan = format!(r#"{{"pose": [{}NaN]}}"#, "0, ".repeat(71));
    let text = format!(r#"{{"pose": [{}"NaN"]}}"#, "0, ".repeat(71));
    let json_type = [("content-type", "application/json")];
    for body in [nan, text] {
        let problem = bench.call(Method::POST, &path, &json_type, body).await.problem(400);
        assert_eq!(problem["part"], "pose[71]", "{problem}");
    }
    for (body, part) in [
        (json!({ "frame": 0, "light": "sun" }), "light"),
        (json!({ "frame": 0, "format": "gif" }), "format"),
        (json!({ "frame": 0, "colour": "red" }), "colour"),
        (json!({ "frame": 0, "camera": { "width": 10 } }), "camera"),
        (json!({ "frame": 0, "camera": with("rotaton", json!([1, 0, 0, 0, 1, 0, 0, 0, 1])) }), "camera.rotaton"),
        (json!({ "frame": 0, "camera": with("distortion", json!({ "k9": 1 })) }), "camera.distortion"),
        (json!({ "frame": 0, "camera": with("distortion", json!(vec![0; 8])) }), "camera.distortion"),
        (json!({ "frame": 0, "camera": with("k4", json!(0.1)) }), "camera.k4"),
        (json!({ "frame": 0, "camera": with("fx", json!("9")) }), "camera.fx"),
        (json!({ "frame": 0, "camera": [10, 10, 9, 9, 5, 5] }), "camera"),
        (json!({ "frame": 0, "camera": with("rotation", json!([1, 2])) }), "camera.rotation"),
    ] {
        assert_eq!(bench.post_json(&path, &body).await.problem(400)["part"], part);
    }
    bench.call(Method::POST, &path, &[("content-type", "text/plain")], "{}").await.problem(415);
    bench.call(Method::POST, &path, &json_type, vec![b' '; 3 << 20]).await.problem(413);
    bench.post_json(&format!("/v1/avatars/{}/renders", Uuid::nil()), &json!({ "frame": 0 })).await.problem(404);
    assert!(bench.draws.asked.lock().unwrap().is_empty(), "none of them reached the worker");
}

#[tokio::test]
async fn a_busy_or_failing_worker_is_told_apart() {
    let bench = Bench::new().await;
    let path = format!("{}/renders", avatar(&bench).await);
    for (error, status) in [
        (RenderError::Busy, 503),
        (RenderError::Unavailable("it is starting".into()), 503),
        (RenderError::Refused("betas: 20 values".into()), 422),
        (RenderError::Failed("the device was lost at 0x1234".into()), 500),
    ] {
        *bench.draws.answer.lock().unwrap() = Err(error);
        let reply = bench.post_json(&path, &json!({ "frame": 0 })).await;
        let problem = reply.problem(status);
        assert_eq!(reply.headers.contains_key("retry-after"), status == 503);
        assert!(!problem.to_string().contains("0x1234"), "causes stay in the log");
    }
}

#[tokio::test]
async fn an_avatar_that_is_deleted_while_its_picture_waits_is_unknown() {
    let bench = Bench::new().await;
    let failed = || Err(RenderError::Failed("No such file or directory".into()));
    for mesh in [false, true] {
        let path = avatar(&bench).await;
        *bench.draws.answer.lock().unwrap() = failed();
        let job = path.replace("avatars", "jobs");
        let deletion = Request::builder().method(Method::DELETE).uri(job).body(Body::empty()).unwrap();
        let router = bench.router.clone();
        *bench.draws.meanwhile.lock().unwrap() =
            Some(Box::pin(async move { assert_eq!(router.oneshot(deletion).await.unwrap().status(), 204) }));
        let reply = match mesh {
            true => bench.get(&format!("{path}/mesh.ply?frame=1")).await,
            false => bench.post_json(&format!("{path}/renders"), &json!({ "frame": 0 })).await,
        };
        assert_eq!(reply.problem(404)["type"], "urn:effigy:problem:not-found");
    }
}

#[tokio::test]
async fn the_file_of_a_picture_goes_with_its_client() {
    let bench = Bench::new().await;
    let path = format!("{}/renders", avatar(&bench).await);
    let files = || std::fs::read_dir(bench.store.renders()).unwrap().count();
    let body = json!({ "frame": 0 });
    let mut call = Box::pin(bench.post_json(&path, &body));
    // To where the file is drawn and the answer is not made yet.
    std::future::poll_fn(|context| match call.as_mut().poll(context) {
        _ if files() > 0 => std::task::Poll::Ready(()),
        answered => answered.map(|reply| panic!("{} at once", reply.status)),
    })
    .await;
    drop(call);
    assert_eq!(files(), 0);
}
