//! What a stage keeps from step to step on the device, to and from the host: parameters, moments of optimisers, losses. With it a
//! fit that was interrupted goes on as if it had not been.

use std::collections::BTreeMap;

use super::FitError;
use super::groups::{Group, SmoothCoordinates, Spread, VertexGroup};
use crate::gpu::{Buffer, Gpu};
use crate::npz::NpzError;
use crate::ops::adam::{Adam, UniformAdam};

/// Numbers by name.
pub type Arrays = BTreeMap<String, Vec<f32>>;

/// Goes through all that a stage keeps, and reads it or puts it back: one list for both ways, so that none forgets a part.
pub enum Checkpointer<'a> {
    Save(&'a Gpu, &'a mut Arrays),
    Restore(&'a Gpu, &'a Arrays),
}

impl Checkpointer<'_> {
    /// A buffer's values. Waits.
    ///
    /// # Errors
    /// [`FitError::Checkpoint`] where the name is missing or has another number of values.
    pub fn buffer(&mut self, name: &str, buffer: &Buffer<f32>) -> Result<(), FitError> {
        match self {
            Self::Save(gpu, arrays) => {
                arrays.insert(name.to_owned(), gpu.read(buffer)?);
            }
            Self::Restore(gpu, arrays) => gpu.write(buffer, 0, found(arrays, name, buffer.len())?),
        }
        Ok(())
    }

    /// Numbers of the host; errors as [`Checkpointer::buffer`].
    pub fn numbers(&mut self, name: &str, numbers: &mut [f32]) -> Result<(), FitError> {
        match self {
            Self::Save(_, arrays) => {
                arrays.insert(name.to_owned(), numbers.to_vec());
            }
            Self::Restore(_, arrays) => numbers.copy_from_slice(found(arrays, name, numbers.len())?),
        }
        Ok(())
    }

    /// Counts below 2²⁴, which a float holds; errors as [`Checkpointer::buffer`].
    pub fn counts(&mut self, name: &str, counts: &mut [u32]) -> Result<(), FitError> {
        let mut numbers: Vec<f32> = counts.iter().map(|&n| n as f32).collect();
        self.numbers(name, &mut numbers)?;
        counts.iter_mut().zip(numbers).for_each(|(count, n)| *count = n as u32);
        Ok(())
    }
}

fn found<'a>(arrays: &'a Arrays, name: &str, len: usize) -> Result<&'a [f32], FitError> {
    let array = arrays.get(name).ok_or_else(|| NpzError::Missing(name.to_owned()))?;
    if array.len() != len {
        let reason = format!("{} values, expected {len}", array.len());
        return Err(NpzError::Array { array: name.to_owned(), reason }.into());
    }
    Ok(array)
}

/// What is kept under names that begin with `name`.
pub trait Checkpointed {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError>;
}

impl Checkpointed for Adam {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        checkpointer.buffer(&format!("{name}.exp_avg"), &self.exp_avg)?;
        checkpointer.buffer(&format!("{name}.exp_avg_sq"), &self.exp_avg_sq)
    }
}

impl Checkpointed for UniformAdam {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        checkpointer.buffer(&format!("{name}.exp_avg"), &self.exp_avg)?;
        checkpointer.buffer(&format!("{name}.exp_avg_sq"), &self.exp_avg_sq)
    }
}

impl Checkpointed for Group {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        checkpointer.buffer(&format!("{name}.values"), &self.values)?;
        checkpointer.counts(&format!("{name}.steps"), &mut self.steps)?;
        self.adam.checkpoint(checkpointer, name)
    }
}

impl Checkpointed for VertexGroup {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        checkpointer.buffer(&format!("{name}.values"), &self.values)?;
        checkpointer.counts(&format!("{name}.steps"), std::slice::from_mut(&mut self.steps))?;
        self.adam.checkpoint(checkpointer, name)
    }
}

impl<P: Spread> Checkpointed for SmoothCoordinates<P> {
    /// Where they start is known from the stage's or the phase's start.
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        checkpointer.buffer(&format!("{name}.u"), &self.u)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::adam::AdamConfig;
    use crate::ops::testing::gpu;

    #[test]
    fn a_group_that_is_put_back_steps_on_as_it_would_have() {
        let Some(gpu) = gpu("fit::checkpointed::a_group_that_is_put_back_steps_on_as_it_would_have") else { return };
        let new = || Group::per_frame(&gpu, "test", &[0.5; 6], 3, AdamConfig::default());
        let step = |group: &mut Group, frame: usize, gradient: f32| {
            gpu.write(&group.grads, 0, &[gradient; 6]);
            let mut recorder = gpu.recorder("fit/checkpointed/test");
            group.step(&mut recorder, &[frame], 0.1);
            recorder.submit().unwrap();
        };
        let (mut whole, mut arrays) = (new(), Arrays::new());
        step(&mut whole, 0, 1.0);
        step(&mut whole, 0, -0.3);
        whole.checkpoint(&mut Checkpointer::Save(&gpu, &mut arrays), "poses").unwrap();
        let mut again = new();
        again.checkpoint(&mut Checkpointer::Restore(&gpu, &arrays), "poses").unwrap();
        for group in [&mut whole, &mut again] {
            step(group, 0, 0.7);
            step(group, 1, 0.2);
        }
        assert_eq!(again.read(&gpu).unwrap(), whole.read(&gpu).unwrap());

        arrays.insert("poses.exp_avg".into(), vec![0.0; 5]);
        let error = again.checkpoint(&mut Checkpointer::Restore(&gpu, &arrays), "poses").unwrap_err().to_string();
        assert!(error.contains("poses.exp_avg") && error.contains("5 values, expected 6"), "{error}");
        arrays.remove("poses.steps");
        let error = again.checkpoint(&mut Checkpointer::Restore(&gpu, &arrays), "poses").unwrap_err().to_string();
        assert!(error.contains("poses.steps"), "{error}");
    }
}
