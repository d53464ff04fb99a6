//! Recording dispatches into one submission.

use std::sync::Arc;

use bytemuck::Pod;
use wgpu::util::DeviceExt;

use super::buffer::Buffer;
use super::device::{Gpu, GpuError};
use super::kernel::Kernel;
use super::rehearsal::{Point, strikes};

/// A buffer of any element type, for binding lists.
pub trait AnyBuffer {
    fn raw(&self) -> &wgpu::Buffer;
}

impl<T> AnyBuffer for Buffer<T> {
    fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }
}

/// Workgroups for `n` invocations of `workgroup_size`, spread over x and y (`shared/linear_index` reads them back).
pub fn linear_groups(n: usize, workgroup_size: u32) -> [u32; 3] {
    let groups = n.div_ceil(workgroup_size as usize).max(1) as u32;
    let x = groups.min(32_768);
    [x, groups.div_ceil(x), 1]
}

/// How many workgroups run.
enum Groups {
    Counted([u32; 3]),
    /// Read on the device from this byte on.
    Stored(wgpu::Buffer, u64),
}

enum Command {
    Dispatch { kernel: Arc<Kernel>, group: wgpu::BindGroup, groups: Groups },
    Clear(wgpu::Buffer),
    Copy { from: wgpu::Buffer, to: wgpu::Buffer, bytes: u64 },
}

/// Work in the order in which it was recorded; nothing runs before [`Recorder::submit`].
pub struct Recorder<'g> {
    gpu: &'g Gpu,
    label: String,
    commands: Vec<Command>,
}

impl Gpu {
    pub fn recorder(&self, label: &str) -> Recorder<'_> {
        Recorder { gpu: self, label: label.to_owned(), commands: Vec::new() }
    }
}

impl<'g> Recorder<'g> {
    pub fn gpu(&self) -> &'g Gpu {
        self.gpu
    }

    /// Records `groups` workgroups of `kernel` with `params` as uniform binding 0 and `buffers` as bindings 1…
    pub fn dispatch<P: Pod>(&mut self, kernel: &Arc<Kernel>, params: &P, buffers: &[&dyn AnyBuffer], groups: [u32; 3]) {
        if !groups.contains(&0) {
            self.push(kernel, params, buffers, Groups::Counted(groups));
        }
    }

    /// As [`dispatch`](Self::dispatch), with the workgroups that a kernel before wrote: `groups[at .. at + 3]` along
    /// x, y and z, each at most 65,535.
    ///
    /// # Panics
    /// When `groups` is too short.
    pub fn dispatch_indirect<P: Pod>(
        &mut self,
        kernel: &Arc<Kernel>,
        params: &P,
        buffers: &[&dyn AnyBuffer],
        groups: &Buffer<u32>,
        at: usize,
    ) {
        assert!(at + 3 <= groups.len(), "{}: no three numbers at {at}", groups.label());
        self.push(kernel, params, buffers, Groups::Stored(groups.raw.clone(), 4 * at as u64));
    }

    fn push<P: Pod>(&mut self, kernel: &Arc<Kernel>, params: &P, buffers: &[&dyn AnyBuffer], groups: Groups) {
        let device = &self.gpu.device;
        let uniform = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(&kernel.label),
            contents: bytemuck::bytes_of(params),
            usage: wgpu::BufferUsages::UNIFORM,
        });
        let mut entries = vec![wgpu::BindGroupEntry { binding: 0, resource: uniform.as_entire_binding() }];
        for (i, buffer) in buffers.iter().enumerate() {
            let resource = buffer.raw().as_entire_binding();
            entries.push(wgpu::BindGroupEntry { binding: i as u32 + 1, resource });
        }
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(&kernel.label),
            layout: &kernel.pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        self.commands.push(Command::Dispatch { kernel: kernel.clone(), group, groups });
    }

    /// Fills a buffer with zeros.
    pub fn clear<T>(&mut self, buffer: &Buffer<T>) {
        self.commands.push(Command::Clear(buffer.raw.clone()));
    }

    /// Copies all of `from` to the start of `to`.
    ///
    /// # Panics
    /// When `to` is shorter.
    pub fn copy<T>(&mut self, from: &Buffer<T>, to: &Buffer<T>) {
        assert!(from.len() <= to.len(), "{} does not fit {}", from.label(), to.label());
        let bytes = from.raw.size().min(to.raw.size());
        self.commands.push(Command::Copy { from: from.raw.clone(), to: to.raw.clone(), bytes });
    }

    /// Hands everything to the device, in order. Does not wait.
    pub fn submit(self) -> Result<(), GpuError> {
        if strikes(Point::Lost) {
            self.gpu.lose();
        }
        if self.gpu.profiling() {
            for command in &self.commands {
                let label = match command {
                    Command::Dispatch { kernel, .. } => kernel.label.as_str(),
                    Command::Clear(_) => "gpu/clear",
                    Command::Copy { .. } => "gpu/copy",
                };
                self.gpu.timings.measure(label, || {
                    self.encode(std::slice::from_ref(command));
                    self.gpu.wait()
                })?;
            }
        } else {
            self.encode(&self.commands);
        }
        self.gpu.check()
    }

    fn encode(&self, commands: &[Command]) {
        let device = &self.gpu.device;
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(&self.label) });
        let mut rest = commands;
        while let Some(first) = rest.first() {
            match first {
                Command::Clear(buffer) => encoder.clear_buffer(buffer, 0, None),
                Command::Copy { from, to, bytes } => encoder.copy_buffer_to_buffer(from, 0, to, 0, *bytes),
                Command::Dispatch { .. } => {
                    let end = rest.iter().position(|c| !matches!(c, Command::Dispatch { .. })).unwrap_or(rest.len());
                    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                        label: Some(&self.label),
                        timestamp_writes: None,
                    });
                    for command in &rest[..end] {
                        if let Command::Dispatch { kernel, group, groups } = command {
                            pass.set_pipeline(&kernel.pipeline);
                            pass.set_bind_group(0, group, &[]);
                            match groups {
                                Groups::Counted([x, y, z]) => pass.dispatch_workgroups(*x, *y, *z),
                                Groups::Stored(buffer, offset) => pass.dispatch_workgroups_indirect(buffer, *offset),
                            }
                        }
                    }
                    drop(pass);
                    rest = &rest[end..];
                    continue;
                }
            }
            rest = &rest[1..];
        }
        self.gpu.queue.submit([encoder.finish()]);
    }
}
