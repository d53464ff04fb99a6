//! The captured motion as `motion.npz`, in the form that tools for SMPL bodies read.

use std::io::{Seek, Write};

use super::AvatarModel;
use crate::body::N_POSE;
use crate::npz::{NpzError, NpzWriter};

/// Writes `poses [N, 72]`, `trans [N, 3]` (SMPL's `transl`, of the model that the avatar's body was made of), `pelvis [N, 3]` (where the
/// avatar's pelvis joint is), `betas [B]`, `frames [N]` (indices in the video), `times [N]`
/// (seconds from the first of them, as in the glTF) and `mocap_framerate` (of the kept frames: the video's rate over their mean
/// distance). Returns the writer.
pub fn write_motion<W: Write + Seek>(model: &AvatarModel, out: W) -> Result<W, NpzError> {
    let n = model.poses.len();
    let mut npz = NpzWriter::new(out);
    npz.add("poses", &[n, N_POSE], model.poses.as_flattened())?;
    let frames = || model.poses.iter().zip(&model.transl).map(|(pose, transl)| (pose, glam::Vec3::from(*transl)));
    let trans = frames().map(|(pose, transl)| (transl - model.pelvis_shift(pose)).to_array());
    npz.add("trans", &[n, 3], trans.collect::<Vec<_>>().as_flattened())?;
    let joint = glam::Vec3::from(model.body.shaped_joints(&model.betas)[0]);
    let pelvis = frames().map(|(_, transl)| (joint + transl).to_array());
    npz.add("pelvis", &[n, 3], pelvis.collect::<Vec<_>>().as_flattened())?;
    npz.add("betas", &[model.betas.len()], &model.betas)?;
    npz.add("frames", &[n], &model.frames.iter().map(|&f| f as i64).collect::<Vec<_>>())?;
    npz.add("times", &[n], &model.times())?;
    npz.add("mocap_framerate", &[], &[kept_frame_rate(model)])?;
    npz.finish()
}

/// Kept frames a second, but for gaps where nobody was there: the mean step without those of more than twice the usual one.
fn kept_frame_rate(model: &AvatarModel) -> f64 {
    let mut steps: Vec<u32> = model.frames.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    steps.sort_unstable();
    let Some(&usual) = steps.get(steps.len() / 2).filter(|&&step| step > 0) else { return model.fps };
    steps.retain(|&step| step <= 2 * usual);
    model.fps * steps.len() as f64 / f64::from(steps.iter().sum::<u32>())
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::npz::Npz;
    use crate::ops::skinning::cpu::forward;

    #[test]
    fn every_array_has_its_name_and_shape() {
        let model = crate::avatar::testing::turning_avatar();
        let npz = Npz::read(write_motion(&model, Cursor::new(Vec::new())).unwrap(), 1 << 20).unwrap();
        let n = model.poses.len();
        assert_eq!(npz.shaped("poses", &[n, N_POSE]).unwrap().f32(), model.poses.as_flattened());
        // The body that the avatar's was made of, with its own pelvis, lies where the avatar's does.
        let mut body = model.body.clone();
        (0..3).for_each(|k| body.j_template[0][k] -= model.pelvis_moved[k]);
        let (trans, pelvis) =
            (npz.shaped("trans", &[n, 3]).unwrap().f32(), npz.shaped("pelvis", &[n, 3]).unwrap().f32());
        for k in 0..n {
            let ours = model.posed(&model.poses[k], model.transl[k]);
            let place = trans.as_chunks().0[k];
            let theirs = forward(&body, &model.betas, Some(&model.offsets), &model.poses[k], place);
            let distance = |a: &[f32; 3], b: &[f32; 3]| glam::Vec3::from(*a).distance(glam::Vec3::from(*b));
            let off = ours.vertices.iter().zip(&theirs.vertices).map(|(a, b)| distance(a, b)).fold(0.0, f32::max);
            assert!(off < 1e-5, "frame {k}: {off} m");
            assert!(distance(&pelvis.as_chunks().0[k], &ours.joints[0]) < 1e-5);
        }
        assert_eq!(npz.shaped("betas", &[3]).unwrap().f32(), model.betas);
        assert_eq!(npz.shaped("frames", &[n]).unwrap().data[1], model.frames[1] as f64);
        let times: Vec<f32> = model.frames.iter().map(|&f| (f - model.frames[0]) as f32 / 30.0).collect();
        assert_eq!(npz.shaped("times", &[n]).unwrap().f32(), times);
        // Every second frame of a 30 Hz video was kept.
        assert_eq!(npz.scalar("mocap_framerate").unwrap(), 15.0);
    }

    #[test]
    fn a_gap_does_not_slow_the_rest() {
        let mut model = crate::avatar::testing::turning_avatar();
        model.frames.iter_mut().skip(2).for_each(|frame| *frame += 100);
        assert_eq!(kept_frame_rate(&model), 15.0);
        model.frames = vec![0, 1, 3, 4, 6];
        assert_eq!(
            kept_frame_rate(&model),
            model.fps * 4.0 / 6.0,
            "frames that are spread evenly lie one or two apart"
        );
        model.frames = vec![7];
        assert_eq!(kept_frame_rate(&model), model.fps);
    }
}
