//! Compute pipelines, compiled once a device and a set of constants.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use super::bindings::layout_entries;
use super::device::Gpu;
use super::rehearsal::{Point, strikes};
use super::shader::{Expansion, expand};

/// A compiled compute shader with one entry point and one bind group: binding 0 is the uniform `params`, bindings 1…
/// are storage buffers in the order given at the dispatch.
pub struct Kernel {
    pub(super) pipeline: wgpu::ComputePipeline,
    pub(super) layout: wgpu::BindGroupLayout,
    pub(super) label: String,
    /// Its own among the device's kernels.
    pub(super) number: u64,
}

impl Gpu {
    /// The kernel of `source`; compiled at the first call, then cached.
    ///
    /// `label` is the path of its file under `shaders/` without the ending (`soft_rasterize/backward`); `constants`
    /// are values for its `#const` lines, as WGSL literals (`"8u"`, `"1.5"`).
    pub fn kernel(&self, label: &str, source: &str, constants: &[(&str, String)]) -> Arc<Kernel> {
        self.kernel_with(label, source, constants, self.info().wide_sums)
    }

    /// [`kernel`](Self::kernel), with or without 64-bit additions.
    pub(crate) fn kernel_with(
        &self,
        label: &str,
        source: &str,
        constants: &[(&str, String)],
        wide_sums: bool,
    ) -> Arc<Kernel> {
        let mut hasher = DefaultHasher::new();
        (label, source, constants, wide_sums).hash(&mut hasher);
        let key = hasher.finish();
        if let Some(kernel) = self.kernels.lock().unwrap().get(&key) {
            return kernel.clone();
        }
        let mut text = expand(label, source, Expansion { wide_sums, constants });
        let entries = layout_entries(label, &text);
        if !self.is_apart() && strikes(Point::Shader) {
            text.push_str("\nthis is no WGSL");
        }
        let desc = wgpu::ShaderModuleDescriptor { label: Some(label), source: wgpu::ShaderSource::Wgsl(text.into()) };
        let module = if std::env::var_os("EFFIGY_GPU_CHECKED").is_some() {
            self.device.create_shader_module(desc)
        } else {
            // SAFETY: the shaders are the project's own; each bounds its indices by `params`, and the parity tests run
            // them with the checks on as well (EFFIGY_GPU_CHECKED). The checks add a counter to every loop.
            unsafe { self.device.create_shader_module_trusted(desc, wgpu::ShaderRuntimeChecks::unchecked()) }
        };
        let layout = self
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries });
        let pipeline_layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(label),
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let pipeline = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(label),
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &[],
                zero_initialize_workgroup_memory: false,
            },
            cache: None,
        });
        let kernel = Arc::new(Kernel { layout, pipeline, label: label.to_owned(), number: self.memory.number() });
        self.kernels.lock().unwrap().insert(key, kernel.clone());
        kernel
    }
}
