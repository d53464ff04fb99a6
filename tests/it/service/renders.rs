//! Renders through a real worker process and its device.

use effigy::avatar::{AvatarModel, ply};
use effigy::body::Body;
use effigy::camera::Camera;
use effigy::ops::texture_field::{TextureFieldConfig, TextureFieldParams};

use super::process::Serve;
use super::*;

/// The test body in frames 0 and 3 of a video of six, with a random texture.
fn model() -> AvatarModel {
    let body = Body::test_body();
    let texture_config =
        TextureFieldConfig { n_levels: 2, log2_hashmap_size: 8, hidden_width: 16, ..TextureFieldConfig::default() };
    let mut upright = [0.0; 72];
    upright[0] = std::f32::consts::PI; // +Y up before a camera whose y runs down
    AvatarModel {
        betas: vec![0.0; body.n_betas],
        offsets: vec![[0.0; 3]; body.n_vertices()],
        texcoords: body.v_template.iter().map(|v| v.map(|x| 0.5 + 0.4 * x)).collect(),
        texture: TextureFieldParams::random(&texture_config, 5),
        texture_config,
        light: effigy::ops::light::Light::EVEN,
        face_colours: vec![[0.5; 3]; body.n_faces()],
        poses: vec![upright; 2],
        transl: vec![[0.0, 0.0, 3.0], [0.5, 0.0, 3.0]],
        pelvis_moved: [0.0, 0.1, 0.0],
        frames: vec![0, 3],
        fps: 30.0,
        camera: Camera::pinhole(64, 64, [90.0, 90.0, 32.0, 32.0]),
        body,
    }
}

/// Publishes the model in a data folder as a worker would; returns the avatar's path.
async fn publish(data: &std::path::Path) -> String {
    let store = Store::open(data).unwrap();
    let env = Env::system();
    let queue = SqliteQueue::open(&store.database(), env.clone(), Policy::default()).await.unwrap();
    let id = env.new_id();
    let clip = Clip { frames: 6, width: 64, height: 64, fps: 30.0, warnings: Vec::new() };
    let options = JobOptions::default();
    let new = NewJob { id, key: None, options, inputs: BTreeMap::new(), clip, remember: None };
    queue.insert(new).await.unwrap();
    let (lease, _) = queue.claim("tests").await.unwrap().unwrap();
    let folder = store.results(id, lease.epoch);
    std::fs::create_dir_all(&folder).unwrap();
    let model = model();
    model.save(&folder.join("model.npz")).unwrap();
    let files = Published::seal(&folder).unwrap();
    let files = files.into_iter().map(|f| AvatarFile { name: f.name, bytes: f.bytes, sha256: f.sha256 });
    let (camera, metrics) = (model.camera.clone(), json!({}));
    let avatar = NewAvatar { body: "test".into(), frames: 2, camera, metrics, files: files.collect() };
    queue.succeed(&lease, avatar).await.unwrap();
    queue.close().await;
    format!("/v1/avatars/{id}")
}

async fn draw(url: &str, body: &Value) -> image::RgbaImage {
    let request = client().post(format!("{url}/renders")).json(body);
    let reply = request.send().await.unwrap();
    let status = reply.status();
    let bytes = reply.bytes().await.unwrap();
    assert_eq!(status, 200, "{}", String::from_utf8_lossy(&bytes));
    image::load_from_memory(&bytes).unwrap().to_rgba8()
}

/// Mean x of the person's pixels.
fn middle(picture: &image::RgbaImage) -> f64 {
    let person: Vec<_> = picture.enumerate_pixels().filter(|(.., p)| p[3] > 127).map(|(x, ..)| f64::from(x)).collect();
    assert!(person.len() > 50, "{} pixels", person.len());
    person.iter().sum::<f64>() / person.len() as f64
}

#[tokio::test]
async fn a_worker_process_draws_pictures_and_meshes() {
    let data = tempfile::tempdir().unwrap();
    let path = publish(data.path()).await;
    let serve = Serve::start(data.path(), &[]);
    let url = format!("{}{path}", serve.url);

    let first = draw(&url, &json!({ "frame": 0 })).await;
    assert_eq!(first.dimensions(), (64, 64), "the capture's size");
    let moved = middle(&draw(&url, &json!({ "frame": 4 })).await) - middle(&first);
    // 90 px of focal length, half a metre aside at 3 m.
    assert!((moved - 15.0).abs() < 1.0, "{moved}");

    let mut pose = vec![0.0; 72];
    pose[0] = std::f64::consts::PI;
    // As `motion.npz` has frame 0: the pelvis that it is turned about lies 0.1 m lower in the body.
    let again = draw(&url, &json!({ "pose": pose, "translation": [0.0, 0.2, 3.0] })).await;
    assert!(again == first, "the motion sent back stands where it stood");
    let camera = json!({ "width": 40, "height": 50, "fx": 60, "fy": 60, "cx": 20, "cy": 25 });
    let body = json!({ "pose": pose, "pelvis": [0, 0, 3], "camera": camera, "background": "#ff0000" });
    let picture = draw(&url, &body).await;
    assert_eq!((picture.dimensions(), picture.get_pixel(0, 0).0), ((40, 50), [255, 0, 0, 255]));
    assert_ne!(picture.get_pixel(20, 25).0, [255, 0, 0, 255]);

    let mesh = client().get(format!("{url}/mesh.ply?frame=2")).send().await.unwrap().bytes().await.unwrap();
    let mesh = ply::read(&mesh[..]).unwrap();
    assert_eq!((mesh.vertices.len(), mesh.colours.len()), (model().body.n_vertices(), mesh.vertices.len()));
    let centre = mesh.vertices.iter().map(|v| f64::from(v[0])).sum::<f64>() / mesh.vertices.len() as f64;
    assert!((centre - 0.5).abs() < 0.1, "in world space, as in the nearest fitted frame: {centre}");
    let beyond = client().get(format!("{url}/mesh.ply?frame=6")).send().await.unwrap();
    assert_eq!(beyond.status(), 422);

    let too_long = json!({ "frame": 0, "betas": vec![0.0; 200] });
    let refused = client().post(format!("{url}/renders")).json(&too_long).send().await.unwrap();
    assert_eq!(refused.status(), 422);
    assert_eq!(std::fs::read_dir(data.path().join("renders")).unwrap().count(), 0);
    assert!(serve.terminate().success());
}
