//! `sum = a + b` of two arrays of one length.

use std::sync::Arc;

use crate::gpu::{Buffer, Gpu, Kernel, Recorder, linear_groups};

/// The kernel.
pub struct Add(Arc<Kernel>);

impl Add {
    pub fn new(gpu: &Gpu) -> Self {
        Self(kernel!(gpu, "add/sum"))
    }

    /// Records `sum = a + b`.
    ///
    /// # Panics
    /// When a length differs.
    pub fn record(&self, recorder: &mut Recorder<'_>, a: &Buffer<f32>, b: &Buffer<f32>, sum: &Buffer<f32>) {
        assert!(a.len() == sum.len() && b.len() == sum.len(), "{}: length", sum.label());
        let params = [sum.len() as u32, 0, 0, 0];
        recorder.dispatch(&self.0, &params, &[a, b, sum], linear_groups(sum.len(), 64));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn both_arrays_are_added() {
        let Some(gpu) = gpu("add::both_arrays_are_added") else { return };
        let a: Vec<f32> = (0..100).map(|k| k as f32).collect();
        let [a, b] = [&a, &vec![0.5; 100]].map(|x| gpu.upload("x", x));
        let sum = gpu.zeros::<f32>("sum", 100);
        let mut recorder = gpu.recorder("add/test");
        Add::new(&gpu).record(&mut recorder, &a, &b, &sum);
        recorder.submit().unwrap();
        let want: Vec<f32> = (0..100).map(|k| k as f32 + 0.5).collect();
        assert_eq!(gpu.read(&sum).unwrap(), want);
    }
}
