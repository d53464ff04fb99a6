//! The multipart body, streamed to the disk part by part: memory holds one chunk, whatever the size.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use serde_json::Value;
use sha2::{Digest, Sha256};
use uuid::Uuid;

use super::form::{Form, FormPart};
use crate::capture::{CaptureInputs, MOST_BYTES};
use crate::fingerprint::hex;
use crate::http::access::Caller;
use crate::http::app::{App, Limits};
use crate::http::error::ApiError;
use crate::http::pace::Lateness;
use crate::http::uploads::{self, Turn};
use crate::jobs::{JobOptions, Part};
use crate::json::{self, JsonError};
use crate::storage::{ResumableUpload, Store, Upload};

/// The parts of an upload.
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "describes the form for the API's document; the parts themselves never meet in memory")]
pub(super) struct UploadForm {
    /// The clip: MP4, MOV, Matroska, WebM, AVI and other single files that FFmpeg reads, whatever their codec (no playlists), or
    /// a zip of images in the order of their names. At most 3,600 frames, 8,192 pixels a side and 4096² in all.
    /// HDR (HLG or PQ) is brought to sRGB.
    #[schema(value_type = String, format = Binary)]
    video: Vec<u8>,
    /// Who is the person: a video or a zip of PNG or JPEG, one for each frame; 128 and above is foreground, below 32 is not; masks
    /// that are mostly between, or that have most of the picture's border, are refused. Where there is transparency, it is the mask. Of
    /// images that are maps of labels, in colours or small numbers (0 and 1, say), whatever is not black is the person. `ffmpeg -i video -fps_mode passthrough frames/%05d.png` takes a video apart frame by frame.
    /// Frames without anybody are left out, if they are no more than half.
    #[schema(value_type = String, format = Binary)]
    masks: Vec<u8>,
    /// 2D keypoints in the video's pixels: `{"format": "coco17", "frames": [[[x, y, confidence] × 17] × N]}`, or a zip of
    /// OpenPose's JSON files, one for each frame. Confidence 0 or the place (0, 0) = not seen; a frame where nobody was found is `[]`. Other formats:
    /// `coco18` and `body25` (OpenPose), `mediapipe33`, `halpe26`, `wholebody133`. Send points in their own format: where MediaPipe
    /// sees joints is known.
    #[schema(value_type = String, format = Binary)]
    keypoints: Vec<u8>,
    /// `{width, height, fx, fy, cx, cy}` in pixels, pixel centres at half integers, with optional distortion
    /// `k1 k2 p1 p2 k3`. Without it the focal length is estimated.
    #[schema(value_type = Option<String>, format = Binary)]
    camera: Option<Vec<u8>>,
    /// Known poses (npz): `poses [N,72]`, `trans [N,3]` or `pelvis [N,3]`, optional `betas`. They are held as firmly as the
    /// keypoints bear them out, and rough ones are replaced (`poses_contradicted`).
    #[schema(value_type = Option<String>, format = Binary)]
    poses: Option<Vec<u8>>,
    /// JSON.
    options: Option<JobOptions>,
    /// JSON: parts that were uploaded before, by `/v1/uploads`, as part → id.
    #[schema(value_type = Option<Object>)]
    uploads: Option<BTreeMap<String, Uuid>>,
}

/// A job of files that were uploaded before, by `/v1/uploads`.
#[derive(Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct JobOfUploads {
    /// Part (`video`, `masks`, `keypoints`, `camera`, `poses`) → id of a finished upload. The job uses them up.
    uploads: BTreeMap<String, Uuid>,
    /// The camera itself, instead of an upload of it.
    #[schema(value_type = Option<Object>)]
    camera: Option<Value>,
    #[schema(value_type = Option<JobOptions>)]
    options: Option<Value>,
}

/// A part and the most it may hold. The large ones share the limit of the whole upload.
struct Kind {
    name: &'static str,
    required: bool,
    limit_bytes: u64,
}

const KINDS: [Kind; 5] = [
    Kind { name: "video", required: true, limit_bytes: u64::MAX },
    Kind { name: "masks", required: true, limit_bytes: u64::MAX },
    Kind { name: "keypoints", required: true, limit_bytes: MOST_BYTES.keypoints },
    Kind { name: "camera", required: false, limit_bytes: MOST_BYTES.camera },
    Kind { name: "poses", required: false, limit_bytes: MOST_BYTES.poses },
];
const OPTIONS: &str = "options";
const UPLOADS: &str = "uploads";
const OPTIONS_LIMIT_BYTES: u64 = 64 << 10;
const EXPECTED_PARTS: &str = "video, masks and keypoints; if wished camera, poses and options; each once";

/// An upload on the disk.
pub(in crate::http) struct Received {
    pub upload: Upload,
    pub inputs: BTreeMap<String, Part>,
    pub options: JobOptions,
    /// Parts that are uploads of their own, until they are adopted.
    references: BTreeMap<String, Uuid>,
    /// SHA-256 of each part, where it was asked for.
    hashes: BTreeMap<String, String>,
}

impl Received {
    /// SHA-256 over the parts' names and contents and the options, lower-case hex.
    pub fn fingerprint(&self) -> String {
        let said = serde_json::json!({ "parts": self.hashes, "uploads": self.references, "options": self.options });
        hex(&Sha256::digest(said.to_string()))
    }

    pub fn files(&self) -> CaptureInputs {
        CaptureInputs::in_folder(self.upload.folder(), |part| self.inputs.contains_key(part))
    }
}

/// How long the rest of a refused body is read, so that clients which read only when they have sent all see why.
const DISCARD: Duration = Duration::from_secs(5);

/// With `hash`, the parts are hashed on their way.
pub(in crate::http) async fn receive(
    mut form: Form,
    store: &Store,
    limits: &Limits,
    hash: bool,
    lateness: &Lateness,
) -> Result<Received, ApiError> {
    let received = receive_parts(&mut form, store, limits, hash).await;
    if lateness.is_late() {
        return Err(ApiError::TooSlow);
    }
    if received.is_err() {
        // Whoever sends for longer finds the connection closed.
        let _ = tokio::time::timeout(DISCARD, form.discard()).await;
    }
    received
}

async fn receive_parts(form: &mut Form, store: &Store, limits: &Limits, hash: bool) -> Result<Received, ApiError> {
    let mut hashes = BTreeMap::new();
    let upload = store.begin_upload()?;
    let mut inputs = BTreeMap::new();
    let mut options = None;
    let mut references: Option<BTreeMap<String, Uuid>> = None;
    let mut budget = Budget { whole: limits.upload_bytes, left: limits.upload_bytes };
    while let Some(part) = form.next_part().await? {
        let name = part.name().to_string();
        if inputs.contains_key(&name)
            || (name == OPTIONS && options.is_some())
            || (name == UPLOADS && references.is_some())
        {
            return Err(wrong_part(format!("the part {name:?} came twice"), &name));
        }
        if name == OPTIONS {
            let json = read_small(part, OPTIONS, &mut budget).await?;
            options = Some(JobOptions::parse(&json).map_err(ApiError::Options)?);
            continue;
        }
        if name == UPLOADS {
            let json = read_small(part, UPLOADS, &mut budget).await?;
            references = Some(parse_json(&json, UPLOADS)?);
            continue;
        }
        let Some(kind) = KINDS.iter().find(|kind| kind.name == name) else {
            return Err(wrong_part(format!("there is no part {name:?}"), &name));
        };
        let mut hasher = hash.then(Sha256::new);
        let bytes = write_part(part, &upload, kind, &mut budget, hasher.as_mut()).await?;
        if let Some(hasher) = hasher {
            hashes.insert(name.clone(), hex(&hasher.finalize()));
        }
        inputs.insert(name, Part { bytes });
    }
    let references = references.unwrap_or_default();
    let received = Received { upload, inputs, options: options.unwrap_or_default(), references, hashes };
    received.check_parts()?;
    Ok(received)
}

/// The JSON form of a request: all parts but a camera were uploaded before.
pub(super) async fn receive_json(json: &[u8], store: &Store) -> Result<Received, ApiError> {
    let asked: JobOfUploads = parse_json(json, "")?;
    let options = asked.options.map(|options| JobOptions::parse(options.to_string().as_bytes()));
    let options = options.transpose().map_err(ApiError::Options)?;
    let upload = store.begin_upload()?;
    let (mut inputs, mut hashes) = (BTreeMap::new(), BTreeMap::new());
    if let Some(camera) = asked.camera {
        let text = camera.to_string();
        let mut part = upload.part("camera").await?;
        part.write(text.as_bytes()).await?;
        inputs.insert("camera".into(), Part { bytes: part.finish().await? });
        hashes.insert("camera".into(), hex(&Sha256::digest(text)));
    }
    let received = Received { upload, inputs, options: options.unwrap_or_default(), references: asked.uploads, hashes };
    received.check_parts()?;
    Ok(received)
}

/// An object that is a part of its own, or the body where `part` is empty.
fn parse_json<T: serde::de::DeserializeOwned>(json: &[u8], part: &str) -> Result<T, ApiError> {
    json::object(json).map_err(|error| {
        let expected = error.expected.or_else(|| Some("parts and the ids of their uploads".into()));
        ApiError::json(JsonError { expected, ..error }, part)
    })
}

impl Received {
    /// Each part once, and all that are needed.
    fn check_parts(&self) -> Result<(), ApiError> {
        for name in self.references.keys() {
            if !KINDS.iter().any(|kind| kind.name == name) {
                return Err(wrong_part(format!("there is no part {name:?}"), name));
            }
            if self.inputs.contains_key(name) {
                return Err(wrong_part(format!("the part {name:?} came twice"), name));
            }
        }
        let is_there = |name: &str| self.inputs.contains_key(name) || self.references.contains_key(name);
        match KINDS.iter().find(|kind| kind.required && !is_there(kind.name)) {
            Some(missing) => Err(wrong_part(format!("the part {:?} is missing", missing.name), missing.name)),
            None => Ok(()),
        }
    }

    pub fn bytes(&self) -> u64 {
        self.inputs.values().map(|part| part.bytes).sum()
    }

    /// Takes the finished uploads that the request named as its parts. They stay until the job is
    /// accepted, so that a refused request can be mended.
    pub async fn adopt(&mut self, app: &App, caller: &Caller, limits: &Limits) -> Result<Used, ApiError> {
        let references = std::mem::take(&mut self.references);
        let wrong = |part: &str, detail: String, expected: &str| {
            let expected = expected.to_string();
            ApiError::Input { detail, part: format!("{UPLOADS}.{part}"), frame: None, expected }
        };
        // In the order of their ids, so that no two requests wait for each other.
        let by_id: BTreeMap<Uuid, &String> = references.iter().map(|(part, &id)| (id, part)).collect();
        let mut used = Used(BTreeMap::new());
        for (id, part) in by_id {
            let taken = match uploads::take(app, caller, &id.to_string()).await {
                Err(ApiError::Unknown { .. }) => {
                    return Err(wrong(part, format!("there is no upload {id}"), "the id of a finished upload"));
                }
                other => other?,
            };
            used.0.insert(id, taken);
        }
        let mut total = self.bytes();
        for (part, id) in references {
            let (found, _) = &used.0[&id];
            let bytes = found.about.bytes;
            if !found.is_whole() {
                let detail = format!("of the upload {id}, {} of {bytes} bytes have come", found.offset);
                return Err(wrong(&part, detail, "a finished upload"));
            }
            let kind_limit = KINDS.iter().find(|kind| kind.name == part).map_or(0, |kind| kind.limit_bytes);
            total = total.saturating_add(bytes);
            for (size, limit_bytes) in [(bytes, kind_limit), (total, limits.upload_bytes)] {
                if size > limit_bytes {
                    let detail = format!("the upload for {part:?} is too large");
                    return Err(ApiError::TooLarge { detail, part: Some(part), limit_bytes });
                }
            }
            self.upload.adopt(&part, id)?;
            self.inputs.insert(part, Part { bytes });
        }
        Ok(used)
    }
}

/// Uploads that a request makes its parts, and its right to them: until the job is accepted or refused, no other takes them.
pub(in crate::http) struct Used(BTreeMap<Uuid, (ResumableUpload, Turn)>);

impl Used {
    /// The bytes of those that are this key's.
    pub fn bytes_of(&self, owner: Option<Uuid>) -> u64 {
        self.0.values().filter(|(upload, _)| upload.about.owner == owner).map(|(upload, _)| upload.about.bytes).sum()
    }

    /// The files are the job's now.
    pub async fn remove(self, store: &Arc<Store>) {
        let store = store.clone();
        let removed =
            tokio::task::spawn_blocking(move || self.0.keys().try_for_each(|&id| store.remove_resumable(id).map(drop)));
        match removed.await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "a used upload stays until it expires"),
            Err(error) => tracing::error!(%error, "removing used uploads panicked"),
        }
    }
}

/// What an upload may still bring.
struct Budget {
    whole: u64,
    left: u64,
}

impl Budget {
    /// Takes a chunk of a part that would then have `bytes`; an error names the limit that is in the way.
    fn take(&mut self, chunk: &[u8], part: &str, bytes: u64, limit_bytes: u64) -> Result<(), ApiError> {
        let too_large =
            |detail: String, limit_bytes| ApiError::TooLarge { detail, part: Some(part.into()), limit_bytes };
        if bytes > limit_bytes {
            return Err(too_large(format!("the part {part:?} is too large"), limit_bytes));
        }
        let left = self.left.checked_sub(chunk.len() as u64);
        self.left = left.ok_or_else(|| too_large("the upload is too large".into(), self.whole))?;
        Ok(())
    }
}

async fn write_part(
    mut part: FormPart<'_>,
    upload: &Upload,
    kind: &Kind,
    budget: &mut Budget,
    mut hasher: Option<&mut Sha256>,
) -> Result<u64, ApiError> {
    let mut file = upload.part(kind.name).await?;
    while let Some(chunk) = part.chunk().await? {
        budget.take(&chunk, kind.name, file.bytes() + chunk.len() as u64, kind.limit_bytes)?;
        if let Some(hasher) = &mut hasher {
            hasher.update(&chunk);
        }
        file.write(&chunk).await?;
    }
    Ok(file.finish().await?)
}

async fn read_small(mut part: FormPart<'_>, name: &str, budget: &mut Budget) -> Result<Vec<u8>, ApiError> {
    let mut content = Vec::new();
    while let Some(chunk) = part.chunk().await? {
        budget.take(&chunk, name, (content.len() + chunk.len()) as u64, OPTIONS_LIMIT_BYTES)?;
        content.extend_from_slice(&chunk);
    }
    Ok(content)
}

fn wrong_part(detail: String, part: &str) -> ApiError {
    ApiError::Malformed { detail, part: Some(part.into()), expected: Some(EXPECTED_PARTS.into()) }
}
