//! The captured motion as `motion.npz`, in the form that tools for SMPL bodies read.

use std::io::{Seek, Write};

use super::AvatarModel;
use crate::npz::{NpzError, NpzWriter};

/// Writes `poses [N, 72]`, `trans [N, 3]` (SMPL's `transl`), `betas [B]`, `frames [N]` (indices in the video) and
/// `mocap_framerate` (of the kept frames: the video's rate over their mean distance). Returns the writer.
pub fn write_motion<W: Write + Seek>(model: &AvatarModel, out: W) -> Result<W, NpzError> {
    let n = model.poses.len();
    let mut npz = NpzWriter::new(out);
    npz.add("poses", &[n, 72], model.poses.as_flattened())?;
    npz.add("trans", &[n, 3], model.transl.as_flattened())?;
    npz.add("betas", &[model.betas.len()], &model.betas)?;
    npz.add("frames", &[n], &model.frames.iter().map(|&f| f as i64).collect::<Vec<_>>())?;
    npz.add("mocap_framerate", &[], &[kept_frame_rate(model)])?;
    npz.finish()
}

/// Kept frames a second.
fn kept_frame_rate(model: &AvatarModel) -> f64 {
    match model.frames[..] {
        [first, .., last] if last > first => model.fps * (model.frames.len() - 1) as f64 / (last - first) as f64,
        _ => model.fps,
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::npz::Npz;

    #[test]
    fn every_array_has_its_name_and_shape() {
        let model = crate::avatar::testing::turning_avatar();
        let npz = Npz::read(write_motion(&model, Cursor::new(Vec::new())).unwrap(), 1 << 20).unwrap();
        let n = model.poses.len();
        assert_eq!(npz.shaped("poses", &[n, 72]).unwrap().f32(), model.poses.as_flattened());
        assert_eq!(npz.shaped("trans", &[n, 3]).unwrap().f32(), model.transl.as_flattened());
        assert_eq!(npz.shaped("betas", &[3]).unwrap().f32(), model.betas);
        assert_eq!(npz.shaped("frames", &[n]).unwrap().data[1], model.frames[1] as f64);
        // Every second frame of a 30 Hz video was kept.
        assert_eq!(npz.scalar("mocap_framerate").unwrap(), 15.0);
    }
}
