use super::{Pixels, RgbL1, cpu};
use crate::gpu::Gpu;
use crate::ops::interpolate::Sampling;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, golden, gpu, noise};
use crate::ops::{LossSlot, PixelList, Target, pack_pixel};

/// The device's loss and gradient, which is added to ones.
fn on_gpu(gpu: &Gpu, image: &[f64], target: Target<'_>, weights: Option<&[f64]>, lambda: f32) -> (f32, Vec<f32>) {
    let n = image.len() / 3;
    let op = RgbL1::new(gpu, n + 3);
    let image = gpu.upload("image", &f32s(image));
    let weights = weights.map(|w| gpu.upload("weights", &f32s(w)));
    let (losses, grad) = (gpu.zeros("losses", 2), gpu.upload("grad_image", &vec![1.0f32; n * 3]));
    let mut recorder = gpu.recorder("rgb_l1/test");
    op.forward(&mut recorder, n, &image, target, weights.as_ref(), LossSlot::new(&losses, 1));
    op.backward(&mut recorder, n, &image, target, weights.as_ref(), lambda, &grad);
    recorder.submit().unwrap();
    (gpu.read(&losses).unwrap()[1], gpu.read(&grad).unwrap().iter().map(|g| g - 1.0).collect())
}

#[test]
fn matches_golden() {
    let npz = golden("losses.npz");
    let data = |key: &str| npz.get(key).unwrap().data.clone();
    let (image, target, want) = (data("image"), data("target"), data("grad_image"));
    let mut grad = vec![0.0; image.len()];
    cpu::backward(&image, &target, None, 1.0, &mut grad);
    assert_close("rgb_loss", &[cpu::forward(&image, &target, None)], &data("rgb_loss"), 1e-12);
    assert_close("grad_image", &grad, &want, 1e-12);

    let Some(gpu) = gpu("rgb_l1::matches_golden") else { return };
    let target = gpu.upload("target", &f32s(&target));
    let (loss, grad) = on_gpu(&gpu, &image, Target::Values(&target), None, 1.0);
    assert_close("rgb_loss", &[loss], &data("rgb_loss"), VALUE);
    assert_close("grad_image", &grad, &want, GRADIENT);
}

#[test]
fn gradient_with_weights() {
    let (image, target) = (noise(30, 1), noise(30, 2));
    let weights: Vec<f64> = noise(10, 3).iter().map(|w| w.abs()).collect();
    let mut grad = vec![0.0; 30];
    cpu::backward(&image, &target, Some(&weights), 1.0, &mut grad);
    assert_gradient("image", &image, &grad, |image| cpu::forward(image, &target, Some(&weights)));
}

#[test]
fn a_packed_target_is_composited_over_the_background() {
    let Some(gpu) = gpu("rgb_l1::a_packed_target_is_composited_over_the_background") else { return };
    let n = 37;
    let bytes: Vec<u8> = noise(n * 4, 4).iter().map(|x| ((x + 1.0) * 127.9) as u8).collect();
    let pixel = |i: usize| -> [u8; 4] { bytes[i * 4..][..4].try_into().unwrap() };
    let unit = |x: u8| f64::from(x) / 255.0;
    // Another frame lies before this one.
    let packed: Vec<u32> = [0xdead_beef; 5]
        .into_iter()
        .chain((0..n).map(|i| pack_pixel([pixel(i)[0], pixel(i)[1], pixel(i)[2]], pixel(i)[3])))
        .collect();
    let pixels = gpu.upload("pixels", &packed);
    let image: Vec<f64> = noise(n * 3, 5).iter().map(|x| x.abs()).collect();
    let weights: Vec<f64> = noise(n, 6).iter().map(|x| x.abs()).collect();
    for background in [None, Some([0.25f32, 1.0, 0.5])] {
        for weights in [None, Some(&weights[..])] {
            let target: Vec<f64> = (0..n * 3)
                .map(|k| {
                    let ([r, g, b, mask], c) = (pixel(k / 3), k % 3);
                    let colour = unit([r, g, b][c]);
                    background.map_or(colour, |bg| unit(mask) * colour + (1.0 - unit(mask)) * f64::from(bg[c]))
                })
                .collect();
            let seen = Target::Packed { pixels: &pixels, offset: 5, background };
            let (loss, grad) = on_gpu(&gpu, &image, seen, weights, 0.5);
            let mut want = vec![0.0; n * 3];
            cpu::backward(&image, &target, weights, 0.5, &mut want);
            assert_close("loss", &[loss], &[cpu::forward(&image, &target, weights)], 1e-5);
            assert_close("grad_image", &grad, &want, 1e-5);
        }
    }
}

/// The device's loss and gradient in one pass; the gradient overwrites sevens.
fn in_one_pass(gpu: &Gpu, image: &[f64], target: Target<'_>, pixels: Pixels<'_>) -> (f32, Vec<f32>) {
    let n = image.len() / 3;
    let (losses, grad) = (gpu.zeros("losses", 2), gpu.upload("grad_both", &vec![7.0f32; RgbL1::room(n)]));
    let mut padded = f32s(image);
    padded.resize(RgbL1::room(n), 0.0);
    let (op, image) = (RgbL1::new(gpu, n), gpu.upload("image", &padded));
    let mut recorder = gpu.recorder("rgb_l1/test");
    op.forward_backward(&mut recorder, n, &image, target, pixels, LossSlot::new(&losses, 1), 0.5, &grad);
    recorder.submit().unwrap();
    (gpu.read(&losses).unwrap()[1], gpu.read(&grad).unwrap()[..3 * n].to_vec())
}

#[test]
fn one_pass_over_all_or_listed_pixels_is_as_two_with_weights() {
    let Some(gpu) = gpu("rgb_l1::one_pass_over_all_or_listed_pixels_is_as_two_with_weights") else { return };
    let n = 150;
    let (image, values) = (noise(n * 3, 7), f32s(&noise(n * 3, 8)));
    let packed: Vec<u32> = (0..n as u32).map(|i| i.wrapping_mul(0x9e37_79b9)).collect();
    let (packed, values) = (gpu.upload("packed", &packed), gpu.upload("values", &values));
    let of_packed = Target::Packed { pixels: &packed, offset: 0, background: Some([0.2, 0.4, 0.6]) };
    for target in [Target::Values(&values), of_packed] {
        for chosen in [|_: usize| true, |i: usize| i % 3 == 1, |_: usize| false] {
            let weights: Vec<f64> = (0..n).map(|i| f64::from(u8::from(chosen(i)))).collect();
            let (loss, grad) = on_gpu(&gpu, &image, target, Some(&weights), 0.5);
            let pixels = PixelList::new(&gpu, "pixels", (0..n).map(chosen));
            assert_eq!(pixels.len(), (0..n).filter(|&i| chosen(i)).count());
            let (loss_both, grad_both) = in_one_pass(&gpu, &image, target, Pixels::Listed(&pixels));
            assert_close("loss", &[loss_both], &[loss], 1e-5);
            assert_close("grad_image", &grad_both, &grad, 1e-6);
        }
        let (loss, grad) = on_gpu(&gpu, &image, target, None, 0.5);
        let (loss_both, grad_both) = in_one_pass(&gpu, &image, target, Pixels::All);
        assert_close("loss", &[loss_both], &[loss], 1e-5);
        assert_close("grad_image", &grad_both, &grad, 1e-6);
    }
}

#[test]
fn listed_pixels_count_by_their_weights() {
    let Some(gpu) = gpu("rgb_l1::listed_pixels_count_by_their_weights") else { return };
    let n = 90;
    let (image, target) = (noise(n * 3, 9), f32s(&noise(n * 3, 10)));
    let target = gpu.upload("target", &target);
    let weights: Vec<f64> = noise(n, 11).iter().map(|w| w.max(0.0)).collect();
    let (loss, grad) = on_gpu(&gpu, &image, Target::Values(&target), Some(&weights), 0.5);
    let pixels = PixelList::weighted(&gpu, "pixels", &f32s(&weights));
    assert_eq!(pixels.len(), weights.iter().filter(|w| **w > 0.0).count());
    let (loss_both, grad_both) = in_one_pass(&gpu, &image, Target::Values(&target), Pixels::Listed(&pixels));
    assert_close("loss", &[loss_both], &[loss], 1e-5);
    assert_close("grad_image", &grad_both, &grad, 1e-6);
}

/// Pixels that are not in the sample are black in the image, since nobody has shaded them: how dark the target is there must
/// not count.
#[test]
fn a_sample_tells_the_loss_of_all() {
    let Some(gpu) = gpu("rgb_l1::a_sample_tells_the_loss_of_all") else { return };
    let (n, sampling) = (4000, Sampling { rate: 0.4, seed: 5 });
    let kept: Vec<bool> = (0..n as u32).map(|i| sampling.keeps(i)).collect();
    let target: Vec<f64> = noise(n * 3, 12).iter().map(|x| 0.5 + 0.4 * x).collect();
    let off = noise(n * 3, 13);
    let whole: Vec<f64> = target.iter().zip(&off).map(|(t, off)| t + 0.1 * off).collect();
    let shaded: Vec<f64> = whole.iter().enumerate().map(|(k, x)| if kept[k / 3] { *x } else { 0.0 }).collect();
    let weights: Vec<f64> = noise(n, 14).iter().map(|w| w.max(0.0)).collect();
    let pixels = PixelList::weighted(&gpu, "pixels", &f32s(&weights));
    let seen = gpu.upload("target", &f32s(&target));
    let seen = Target::Values(&seen);
    let (all, _) = in_one_pass(&gpu, &whole, seen, Pixels::Listed(&pixels));
    let (told, grad) = in_one_pass(&gpu, &shaded, seen, Pixels::Sampled(&pixels, sampling));
    assert!((told / all - 1.0).abs() < 0.05, "{told} for {all}");
    let counted: Vec<f64> = weights.iter().zip(&kept).map(|(w, kept)| if *kept { w / 0.4 } else { 0.0 }).collect();
    let mut want = vec![0.0; n * 3];
    cpu::backward(&shaded, &target, Some(&counted), 0.5, &mut want);
    assert_close("loss", &[told], &[cpu::forward(&shaded, &target, Some(&counted))], 1e-5);
    assert_close("grad_image", &grad, &want, 1e-5);
}
