//! What requests and answers look like: one example a type. Problems are made by the code that makes them, the rest is held
//! to its schema by a test.

use serde_json::{Value, json};
use utoipa::openapi::path::Operation;
use utoipa::openapi::{Content, RefOr};

use super::bodies;
use crate::http::error::example as problem;

const ID: &str = "0190a1b2-c3d4-7e5f-8a9b-0c1d2e3f4a5b";
const OTHER: &str = "0190a1b2-d000-7abc-9def-0123456789ab";

/// Gives each body of the operation an example.
pub(super) fn complete(operation: &mut Operation) {
    bodies::each(operation, add);
}

fn add(status: &str, kind: &str, content: &mut Content) {
    let named = match &content.schema {
        Some(RefOr::Ref(reference)) => reference.ref_location.rsplit('/').next().and_then(of_type),
        _ => None,
    };
    let example = match kind {
        "application/problem+json" => status.parse().ok().and_then(problem),
        _ => named.or_else(|| of_kind(status, kind)),
    };
    content.example = content.example.take().or(example);
}

/// Of bodies that are no JSON.
fn of_kind(status: &str, kind: &str) -> Option<Value> {
    Some(match kind {
        "text/event-stream" => json!(format!(
            "id: 41\nevent: state\ndata: {{\"state\":\"running\",\"attempt\":1,\"error\":null,\
             \"at\":\"2026-01-31T12:00:01.000Z\"}}\n\nid: 42\nevent: progress\ndata: {{\"stage\":\"geometry\",\"step\":120,\
             \"steps\":900,\"progress\":0.14,\"eta_secs\":310.5,\"losses\":{{\"rgb\":0.031}},\
             \"at\":\"2026-01-31T12:00:40.000Z\"}}\n\nid: 43\nevent: preview\ndata: {{\"stage\":\"geometry\",\"step\":121,\
             \"steps\":900,\"progress\":0.14,\"url\":\"/v1/jobs/{ID}/preview\",\"at\":\"2026-01-31T12:00:41.000Z\"}}\n\n"
        )),
        "text/plain" => json!("ok\n"),
        "application/yaml" => json!("openapi: 3.1.0\ninfo:\n  title: Effigy\n"),
        _ if kind.starts_with("image/") => json!("(bytes of a picture)"),
        _ if bodies::is_bytes(status, kind) => json!("(bytes)"),
        _ => return None,
    })
}

fn clip() -> Value {
    json!({ "frames": 240, "width": 1080, "height": 1920, "fps": 30.0 })
}

fn camera() -> Value {
    json!({ "width": 360, "height": 640, "fx": 520.0, "fy": 520.0, "cx": 180.0, "cy": 320.0 })
}

fn options() -> Value {
    json!({
        "preset": "standard", "max_frames": 120, "max_side_px": null, "body": "default", "seed": 0, "height_m": 1.78,
        "trust_camera": false, "texture_px": 2048, "priority": 0, "deadline_secs": null,
    })
}

fn job() -> Value {
    json!({
        "id": ID, "state": "running", "stage": "geometry", "step": 120, "steps": 900, "progress": 0.14,
        "eta_secs": 310.5, "attempt": 1, "max_attempts": 3, "excused_attempts": 0, "queue_position": null,
        "losses": { "rgb": 0.031, "silhouette": 0.012 }, "options": options(),
        "inputs": { "video": { "bytes": 8123456 }, "masks": { "bytes": 512000 }, "keypoints": { "bytes": 96000 } },
        "clip": clip(), "created_at": "2026-01-31T12:00:00.000Z", "started_at": "2026-01-31T12:00:01.000Z",
        "cancel_requested_at": null, "finished_at": null, "updated_at": "2026-01-31T12:00:40.000Z", "deadline_at": null,
        "expires_at": null, "preview_url": format!("/v1/jobs/{ID}/preview"), "avatar": null, "error": null,
    })
}

fn webhook() -> Value {
    json!({
        "id": OTHER, "url": "https://example.org/effigy", "events": ["job.succeeded", "job.failed"],
        "created_at": "2026-01-31T12:00:00.000Z", "disabled_at": null,
    })
}

fn of_type(name: &str) -> Option<Value> {
    Some(match name {
        "JobView" => job(),
        "JobList" => json!({ "jobs": [job()], "next": null }),
        "UploadForm" => json!({
            "video": "(bytes of walk.mp4)", "masks": "(bytes of masks.zip)", "keypoints": "(bytes of keypoints.json)",
            "options": { "preset": "standard", "height_m": 1.78 },
        }),
        "JobOfUploads" => json!({
            "uploads": { "video": ID, "masks": OTHER, "keypoints": "0190a1b2-d001-7abc-9def-0123456789ab" },
            "camera": camera(), "options": { "preset": "draft" },
        }),
        "AvatarView" => json!({
            "id": ID, "job": ID, "body": "default", "clip": clip(), "frames": 120, "camera": camera(),
            "metrics": { "mask_iou": 0.95, "psnr": 27.4, "frames": 120, "secs": 402.0, "peak_device_bytes": 812000000 },
            "created_at": "2026-01-31T12:07:00.000Z", "expires_at": null,
            "files": { "avatar.glb": format!("/v1/avatars/{ID}/avatar.glb"), "texture.png": format!("/v1/avatars/{ID}/texture.png") },
        }),
        "RenderBody" => json!({ "frame": 0, "camera": camera(), "light": "none", "background": "#ffffff" }),
        "LinksView" => json!({
            "expires_at": "2026-01-31T13:00:00.000Z",
            "links": { "avatar.glb": format!("/v1/avatars/{ID}/avatar.glb?expires=1769864400&signature=mC0x…") },
        }),
        "LinksBody" => json!({ "files": ["avatar.glb"], "expires_in_secs": 3600 }),
        "WebhookBody" => json!({ "url": "https://example.org/effigy", "events": ["job.succeeded", "job.failed"] }),
        "WebhookView" => webhook(),
        "WebhookList" => json!({ "webhooks": [webhook()] }),
        _ => return None,
    })
}
