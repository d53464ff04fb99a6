//! What dispatches bind, kept from submission to submission: a step of a fit binds the same few hundred sets of buffers again
//! and again, and to make a bind group costs the host more than to encode its dispatch.

use std::collections::HashMap;
use std::num::NonZero;
use std::sync::Arc;

use super::kernel::Kernel;

/// Bytes of the parameters of a submission for which there is room at first.
const LEAST_ROOM: u64 = 1 << 16;

/// Bind groups over one buffer that holds the parameters of all dispatches of a submission.
#[derive(Default)]
pub(super) struct Bindings {
    params: Option<wgpu::Buffer>,
    /// By the kernel, the bytes of its parameters and the buffers that are bound.
    groups: HashMap<Box<[u64]>, wgpu::BindGroup>,
    /// [`super::device::Memory::dropped`] when they were made.
    dropped: u64,
    key: Vec<u64>,
}

impl Bindings {
    /// Makes room for the parameters of a submission, and lets go of what binds buffers that are dropped since.
    pub fn begin(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, params: &[u8], dropped: u64) {
        if self.dropped != dropped {
            self.forget();
            self.dropped = dropped;
        }
        let needed = params.len() as u64;
        if self.params.as_ref().is_none_or(|buffer| buffer.size() < needed) {
            self.forget();
            self.params = Some(device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("gpu/params"),
                size: needed.next_power_of_two().max(LEAST_ROOM),
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }));
        }
        if let Some(buffer) = self.params.as_ref().filter(|_| needed > 0) {
            queue.write_buffer(buffer, 0, params);
        }
    }

    /// Lets go of all bind groups, and of the buffers that only they hold.
    pub fn forget(&mut self) {
        self.groups.clear();
    }

    /// The bind group of `kernel` with parameters of so many bytes, at an offset that the dispatch tells, and these buffers with
    /// their numbers.
    ///
    /// # Panics
    /// Before [`Bindings::begin`].
    pub fn group(
        &mut self,
        device: &wgpu::Device,
        kernel: &Arc<Kernel>,
        params_len: usize,
        buffers: &[(u64, wgpu::Buffer)],
    ) -> wgpu::BindGroup {
        self.key.clear();
        self.key.extend([kernel.number, params_len as u64]);
        self.key.extend(buffers.iter().map(|(number, _)| number));
        if let Some(group) = self.groups.get(self.key.as_slice()) {
            return group.clone();
        }
        let params = wgpu::BufferBinding {
            buffer: self.params.as_ref().expect("a submission has begun"),
            offset: 0,
            size: NonZero::new(params_len as u64),
        };
        let resources = buffers.iter().map(|(_, buffer)| buffer.as_entire_binding());
        let resources = std::iter::once(wgpu::BindingResource::Buffer(params)).chain(resources);
        let entries: Vec<_> =
            (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(&kernel.label),
            layout: &kernel.layout,
            entries: &entries,
        });
        self.groups.insert(self.key.as_slice().into(), group.clone());
        group
    }
}

/// The layout of a shader's bindings, by their declarations: the uniform one at an offset that each dispatch tells.
///
/// # Panics
/// On a declaration in another form than the project's.
pub(super) fn layout_entries(label: &str, text: &str) -> Vec<wgpu::BindGroupLayoutEntry> {
    let declared = text.lines().filter_map(|line| line.trim_start().strip_prefix("@group(0) @binding("));
    let entry = |rest: &str| {
        let (binding, rest) = rest.split_once(") var<").unwrap_or_else(|| panic!("{label}: binding {rest}"));
        let (kind, _) = rest.split_once('>').unwrap_or_else(|| panic!("{label}: binding {rest}"));
        let (ty, has_dynamic_offset) = match kind {
            "uniform" => (wgpu::BufferBindingType::Uniform, true),
            "storage, read" => (wgpu::BufferBindingType::Storage { read_only: true }, false),
            "storage, read_write" => (wgpu::BufferBindingType::Storage { read_only: false }, false),
            _ => panic!("{label}: a binding of {kind}"),
        };
        wgpu::BindGroupLayoutEntry {
            binding: binding.parse().unwrap_or_else(|_| panic!("{label}: binding {binding}")),
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None },
            count: None,
        }
    };
    declared.map(entry).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layout_is_what_the_shader_declares() {
        let text = "struct Params { n: u32 }\n\
            @group(0) @binding(0) var<uniform> params: Params;\n\
            @group(0) @binding(1) var<storage, read> from: array<f32>; // [N]\n\
            @group(0) @binding(2) var<storage, read_write> to: array<atomic<u32>>;\n";
        let kinds: Vec<_> = layout_entries("t", text).into_iter().map(|entry| (entry.binding, entry.ty)).collect();
        let buffer =
            |ty, has_dynamic_offset| wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None };
        let storage = |read_only| buffer(wgpu::BufferBindingType::Storage { read_only }, false);
        let uniform = buffer(wgpu::BufferBindingType::Uniform, true);
        assert_eq!(kinds, [(0, uniform), (1, storage(true)), (2, storage(false))]);
    }
}
