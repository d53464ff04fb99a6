//! Host side of `shaders/rgb_l1/`.

use std::sync::Arc;

use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::interpolate::Sampling;
use crate::ops::reduce::Sum;
use crate::ops::{LossSlot, PixelList, Target};

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Params {
    n_pixels: u32,
    offset: u32,
    background: [f32; 3],
    composite: f32,
    lambda: f32,
    seed: u32,
    threshold: u32,
    one_stands_for: f32,
}

/// The pixels that count.
#[derive(Clone, Copy)]
pub enum Pixels<'a> {
    All,
    /// With their weights.
    Listed(&'a PixelList),
    /// Of those the ones that the sampling keeps, each as much as the pixels that it stands for: an estimate of the loss of
    /// all listed ones.
    Sampled(&'a PixelList, Sampling),
}

/// The loss of images of up to `max_pixels`.
pub struct RgbL1 {
    // [packed][weighted]
    forward: [[Arc<Kernel>; 2]; 2],
    backward: [[Arc<Kernel>; 2]; 2],
    // [packed]
    whole: [Arc<Kernel>; 2],
    // [packed][weighted]
    listed: [[Arc<Kernel>; 2]; 2],
    sum: Sum,
    values: Buffer<f32>,
}

impl RgbL1 {
    /// Numbers that `image` and `grad_image` hold where [`RgbL1::forward_backward`] takes [`Pixels::All`]: four pixels at a time.
    pub fn room(n_pixels: usize) -> usize {
        3 * n_pixels.next_multiple_of(4)
    }

    pub fn new(gpu: &Gpu, max_pixels: usize) -> Self {
        let packed = [false, true].map(|packed| [("PACKED", packed.to_string())]);
        let weighted = packed
            .each_ref()
            .map(|[packed]| [false, true].map(|weighted| [packed.clone(), ("WEIGHTED", weighted.to_string())]));
        let forward = weighted.each_ref().map(|row| row.each_ref().map(|c| kernel!(gpu, "rgb_l1/forward", c)));
        let backward = weighted.each_ref().map(|row| row.each_ref().map(|c| kernel!(gpu, "rgb_l1/backward", c)));
        let whole = packed.each_ref().map(|c| kernel!(gpu, "rgb_l1/whole", c));
        let listed = weighted.each_ref().map(|row| row.each_ref().map(|c| kernel!(gpu, "rgb_l1/listed", c)));
        Self {
            forward,
            backward,
            whole,
            listed,
            sum: Sum::new(gpu),
            values: gpu.zeros("rgb_l1/values", max_pixels.next_multiple_of(4)),
        }
    }

    /// Records the loss of the first `n_pixels` of `image`.
    ///
    /// # Panics
    /// When a buffer is too short, or the image larger than this loss was made for.
    pub fn forward(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        image: &Buffer<f32>,
        target: Target<'_>,
        weights: Option<&Buffer<f32>>,
        loss: LossSlot<'_>,
    ) {
        assert!(n_pixels <= self.values.len(), "rgb_l1: {n_pixels} pixels");
        self.record(recorder, &self.forward, n_pixels, image, target, weights, 1.0, &self.values);
        self.sum.add(recorder, &self.values, n_pixels, loss);
    }

    /// Records `grad_image += λ ∂L/∂image`.
    ///
    /// # Panics
    /// When a buffer is too short.
    #[expect(clippy::too_many_arguments, reason = "the contract's buffers, in its order")]
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        image: &Buffer<f32>,
        target: Target<'_>,
        weights: Option<&Buffer<f32>>,
        lambda: f32,
        grad_image: &Buffer<f32>,
    ) {
        assert!(grad_image.len() >= n_pixels * 3, "{}: length", grad_image.label());
        self.record(recorder, &self.backward, n_pixels, image, target, weights, lambda, grad_image);
    }

    /// Records the loss of `pixels` and `grad_image = λ ∂L/∂image` in one pass; what `grad_image`
    /// held is lost.
    ///
    /// # Panics
    /// As `forward` and `backward`.
    #[expect(clippy::too_many_arguments, reason = "the contract's buffers, in its order")]
    pub fn forward_backward(
        &self,
        recorder: &mut Recorder<'_>,
        n_pixels: usize,
        image: &Buffer<f32>,
        target: Target<'_>,
        pixels: Pixels<'_>,
        loss: LossSlot<'_>,
        lambda: f32,
        grad_image: &Buffer<f32>,
    ) {
        assert!(n_pixels <= self.values.len(), "rgb_l1: {n_pixels} pixels");
        assert!(grad_image.len() >= n_pixels * 3, "{}: length", grad_image.label());
        let (list, sampling) = match pixels {
            Pixels::All => (None, Sampling::ALL),
            Pixels::Listed(list) => (Some(list), Sampling::ALL),
            Pixels::Sampled(list, sampling) => (Some(list), sampling),
        };
        let n_rows = list.map_or(n_pixels, PixelList::len);
        if list.is_some() {
            recorder.clear(grad_image);
        }
        if n_rows == 0 {
            return;
        }
        assert!(image.len() >= n_pixels * 3, "{}: length", image.label());
        let (seen, values, params) =
            (target.buffer(n_pixels, 3), &self.values, params(n_rows, target, lambda, sampling));
        let packed = usize::from(target.is_packed());
        match list {
            Some(PixelList { index, weight, .. }) => {
                let kernel = &self.listed[packed][usize::from(weight.is_some())];
                // Without weights the kernel reads nothing there.
                let weight = weight.as_ref().unwrap_or(image);
                let buffers: [&dyn AnyBuffer; 6] = [image, seen, index, weight, values, grad_image];
                recorder.dispatch(kernel, &params, &buffers, linear_groups(n_rows, 64));
            }
            None => {
                for buffer in [image, grad_image] {
                    assert!(buffer.len() >= Self::room(n_pixels), "{}: room for the last four pixels", buffer.label());
                }
                let groups = linear_groups(n_rows.div_ceil(4), 64);
                recorder.dispatch(&self.whole[packed], &params, &[image, seen, values, grad_image], groups);
            }
        }
        self.sum.add(recorder, &self.values, n_rows, loss);
    }

    #[expect(clippy::too_many_arguments, reason = "what both passes share")]
    fn record(
        &self,
        recorder: &mut Recorder<'_>,
        kernels: &[[Arc<Kernel>; 2]; 2],
        n_pixels: usize,
        image: &Buffer<f32>,
        target: Target<'_>,
        weights: Option<&Buffer<f32>>,
        lambda: f32,
        out: &Buffer<f32>,
    ) {
        assert!(image.len() >= n_pixels * 3, "{}: length", image.label());
        assert!(weights.is_none_or(|w| w.len() >= n_pixels), "rgb_l1: length of weights");
        let kernel = &kernels[usize::from(target.is_packed())][usize::from(weights.is_some())];
        // Without weights the kernel reads nothing there.
        let buffers: [&dyn AnyBuffer; 4] = [image, target.buffer(n_pixels, 3), weights.unwrap_or(image), out];
        recorder.dispatch(
            kernel,
            &params(n_pixels, target, lambda, Sampling::ALL),
            &buffers,
            linear_groups(n_pixels, 64),
        );
    }
}

fn params(n_rows: usize, target: Target<'_>, lambda: f32, sampling: Sampling) -> Params {
    Params {
        n_pixels: n_rows as u32,
        offset: target.offset(),
        background: target.background().unwrap_or_default(),
        composite: if target.background().is_some() { 1.0 } else { 0.0 },
        lambda,
        seed: sampling.seed,
        threshold: sampling.threshold(),
        one_stands_for: 1.0 / sampling.rate as f32,
    }
}
