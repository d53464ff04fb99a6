//! A made avatar for tests: the test body, turning, with a random texture; what its files are made of and read by.

pub(super) mod glb;

use super::{AvatarModel, Texture, UvLayout, bake};
use crate::body::joints::{LEFT_ELBOW, LEFT_KNEE, LEFT_SHOULDER, RIGHT_SHOULDER};
use crate::body::{Body, N_POSE};
use crate::camera::Camera;
use crate::ops::texture_field::{TextureFieldConfig, TextureFieldParams};

/// A camera that sees the test body whole at 3 m.
pub(crate) fn camera(side: u32) -> Camera {
    let side_px = f64::from(side);
    Camera::pinhole(side, side, [1.4 * side_px, 1.4 * side_px, 0.5 * side_px, 0.5 * side_px])
}

/// Five frames (every second of the video) of a turn before the camera, with bent arms and a shape of its own.
pub(crate) fn turning_avatar() -> AvatarModel {
    let body = Body::test_body();
    let texture_config =
        TextureFieldConfig { n_levels: 4, log2_hashmap_size: 10, hidden_width: 16, ..Default::default() };
    let mut texture = TextureFieldParams::random(&texture_config, 5);
    texture.table.iter_mut().for_each(|x| *x *= 1e4);
    let n = 5;
    let poses = (0..n).map(|i| {
        let mut pose = [0.0; N_POSE];
        // Half a turn about x (camera space runs down) after the turn about the body's own y.
        let turn = glam::Quat::from_rotation_x(std::f32::consts::PI) * glam::Quat::from_rotation_y(1.3 * i as f32);
        pose[..3].copy_from_slice(&turn.to_scaled_axis().to_array());
        pose[3 * LEFT_SHOULDER + 2] = -1.0 + 0.1 * i as f32;
        pose[3 * RIGHT_SHOULDER + 2] = 1.0;
        pose[3 * LEFT_ELBOW + 1] = -0.2 * i as f32;
        pose[3 * LEFT_KNEE] = 0.3 * i as f32;
        pose
    });
    AvatarModel {
        betas: vec![0.4, -0.3, 0.2],
        offsets: body.v_template.iter().map(|v| [0.01 * v[0], 0.0, 0.02]).collect(),
        texcoords: body.v_template.iter().map(|v| v.map(|x| 0.5 + 0.5 * x)).collect(),
        texture_config,
        texture,
        light: crate::ops::light::Light::EVEN,
        face_colours: vec![[0.5, 0.25, 0.75]; body.n_faces()],
        poses: poses.collect(),
        transl: (0..n).map(|i| [0.02 * i as f32, 0.1, 3.0]).collect(),
        pelvis_moved: [0.01, -0.02, 0.03],
        frames: (0..n).map(|i| 2 * i).collect(),
        fps: 30.0,
        camera: camera(128),
        body,
    }
}

/// What is made with a small texture, baked by the vertices' positions; needs no device.
pub(super) fn textured<R>(model: &AvatarModel, make: impl FnOnce(&UvLayout, &Texture<'_>) -> R) -> R {
    let layout = UvLayout::of_body(&model.body);
    let image =
        bake::<std::convert::Infallible>(&layout, 64, |points| Ok(vec![[0.8, 0.5, 0.2]; points.len()])).unwrap();
    let mut png = std::io::Cursor::new(Vec::new());
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    make(&layout, &Texture { bytes: png.get_ref(), mime: "image/png" })
}
