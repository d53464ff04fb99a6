use super::{SilhouetteIou, cpu};
use crate::gpu::Gpu;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, golden, gpu, noise};
use crate::ops::{LossSlot, Target, pack_pixel};

/// The device's loss and gradient, which is added to ones.
fn on_gpu(gpu: &Gpu, alpha: &[f64], target: Target<'_>, lambda: f32) -> (f32, Vec<f32>) {
    let n = alpha.len();
    let op = SilhouetteIou::new(gpu);
    let alpha = gpu.upload("alpha", &f32s(alpha));
    let (losses, grad) = (gpu.zeros("losses", 2), gpu.upload("grad_alpha", &vec![1.0f32; n]));
    let mut recorder = gpu.recorder("silhouette_iou/test");
    op.forward(&mut recorder, n, &alpha, target, LossSlot::new(&losses, 1));
    op.backward(&mut recorder, n, target, lambda, &grad);
    recorder.submit().unwrap();
    (gpu.read(&losses).unwrap()[1], gpu.read(&grad).unwrap().iter().map(|g| g - 1.0).collect())
}

#[test]
fn matches_golden() {
    let npz = golden("losses.npz");
    let data = |key: &str| npz.get(key).unwrap().data.clone();
    let (alpha, mask, want) = (data("silhouette"), data("mask"), data("grad_silhouette"));
    let mut grad = vec![0.0; alpha.len()];
    cpu::backward(&alpha, &mask, 1.0, &mut grad);
    assert_close("silhouette_loss", &[cpu::forward(&alpha, &mask)], &data("silhouette_loss"), 1e-12);
    assert_close("grad_silhouette", &grad, &want, 1e-12);

    let Some(gpu) = gpu("silhouette_iou::matches_golden") else { return };
    let mask = gpu.upload("mask", &f32s(&mask));
    // λ scales the small gradients up to where the ones that they are added to do not round them away.
    let (loss, grad) = on_gpu(&gpu, &alpha, Target::Values(&mask), 100.0);
    assert_close("silhouette_loss", &[loss], &data("silhouette_loss"), VALUE);
    assert_close("grad_silhouette", &grad.iter().map(|g| g / 100.0).collect::<Vec<_>>(), &want, GRADIENT);
}

#[test]
fn gradient_of_soft_masks() {
    let unit = |seed| noise(20, seed).iter().map(|x| x.abs()).collect::<Vec<f64>>();
    let (alpha, mask) = (unit(1), unit(2));
    let mut grad = vec![0.0; 20];
    cpu::backward(&alpha, &mask, 1.0, &mut grad);
    assert_gradient("alpha", &alpha, &grad, |alpha| cpu::forward(alpha, &mask));
}

#[test]
fn a_packed_mask_of_more_pixels_than_lanes_matches_cpu() {
    let Some(gpu) = gpu("silhouette_iou::a_packed_mask_of_more_pixels_than_lanes_matches_cpu") else { return };
    let n = 40_001;
    let bytes: Vec<u8> = noise(n, 4).iter().map(|x| ((x + 1.0) * 127.9) as u8).collect();
    let packed: Vec<u32> = [7; 3].into_iter().chain(bytes.iter().map(|&m| pack_pixel([1, 2, 3], m))).collect();
    let pixels = gpu.upload("pixels", &packed);
    let alpha: Vec<f64> = noise(n, 5).iter().map(|x| x.abs()).collect();
    let mask: Vec<f64> = bytes.iter().map(|&m| f64::from(m) / 255.0).collect();
    let lambda = n as f32;
    let (loss, grad) = on_gpu(&gpu, &alpha, Target::Packed { pixels: &pixels, offset: 3, background: None }, lambda);
    let mut want = vec![0.0; n];
    cpu::backward(&alpha, &mask, f64::from(lambda), &mut want);
    assert_close("loss", &[loss], &[cpu::forward(&alpha, &mask)], 1e-5);
    assert_close("grad_alpha", &grad, &want, 1e-5);
}

#[test]
fn two_empty_images_agree() {
    let Some(gpu) = gpu("silhouette_iou::two_empty_images_agree") else { return };
    let mask = gpu.zeros::<f32>("mask", 9);
    let (loss, grad) = on_gpu(&gpu, &[0.0; 9], Target::Values(&mask), 1.0);
    assert!(loss == 0.0 && grad == [0.0; 9] && cpu::forward(&[0.0; 9], &[0.0; 9]) == 0.0);
}
