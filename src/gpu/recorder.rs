//! Recording dispatches into one submission.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::Pod;

use super::bindings::Bindings;
use super::buffer::Buffer;
use super::device::{Gpu, GpuError};
use super::kernel::Kernel;
use super::rehearsal::{Point, strikes};
use super::timing::Stamps;

/// A buffer of any element type, for binding lists.
pub trait AnyBuffer {
    fn raw(&self) -> &wgpu::Buffer;

    /// Its own among the device's buffers.
    fn number(&self) -> u64;
}

impl<T> AnyBuffer for Buffer<T> {
    fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }

    fn number(&self) -> u64 {
        self.number
    }
}

/// Workgroups along x at most: one axis has at most 65,535. `shared/linear_groups` of the shaders has the same.
pub(super) const ROW: u32 = 32_768;

/// Workgroups for `n` invocations of `workgroup_size`, spread over x and y (`shared/linear_index` reads them back).
pub fn linear_groups(n: usize, workgroup_size: u32) -> [u32; 3] {
    let groups = n.div_ceil(workgroup_size as usize).max(1) as u32;
    let x = groups.min(ROW);
    [x, groups.div_ceil(x), 1]
}

/// How many workgroups run.
enum Groups {
    Counted([u32; 3]),
    /// Read on the device from this byte on.
    Stored(wgpu::Buffer, u64),
}

enum Command {
    /// `params` is a place among the recorder's parameters, `buffers` are the bindings from 1 on, each with its number.
    Dispatch {
        kernel: Arc<Kernel>,
        params: Range<usize>,
        buffers: Vec<(u64, wgpu::Buffer)>,
        groups: Groups,
    },
    Clear {
        buffer: wgpu::Buffer,
        bytes: u64,
    },
    /// `from` and `to` with the byte at which each begins.
    Copy {
        from: (wgpu::Buffer, u64),
        to: (wgpu::Buffer, u64),
        bytes: u64,
    },
}

impl Command {
    /// What profiles call it.
    fn label(&self) -> &str {
        match self {
            Command::Dispatch { kernel, .. } => &kernel.label,
            Command::Clear { .. } => "gpu/clear",
            Command::Copy { .. } => "gpu/copy",
        }
    }
}

/// Work in the order in which it was recorded; nothing runs before [`Recorder::submit`].
pub struct Recorder<'g> {
    gpu: &'g Gpu,
    label: String,
    commands: Vec<Command>,
    /// Of all dispatches, each at an offset that a binding may have: a buffer for each costs more than a short kernel.
    params: Vec<u8>,
}

impl Gpu {
    pub fn recorder(&self, label: &str) -> Recorder<'_> {
        Recorder { gpu: self, label: label.to_owned(), commands: Vec::new(), params: Vec::new() }
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
        let first = self.params.len().next_multiple_of(self.gpu.params_alignment);
        self.params.resize(first, 0);
        self.params.extend_from_slice(bytemuck::bytes_of(params));
        let buffers = buffers.iter().map(|buffer| (buffer.number(), buffer.raw().clone())).collect();
        let params = first..self.params.len();
        self.commands.push(Command::Dispatch { kernel: kernel.clone(), params, buffers, groups });
    }

    /// Fills a buffer with zeros.
    pub fn clear<T>(&mut self, buffer: &Buffer<T>) {
        self.commands.push(Command::Clear { buffer: buffer.raw.clone(), bytes: buffer.raw.size() });
    }

    /// Fills the first `len` values with zeros.
    ///
    /// # Panics
    /// When there are fewer, or they are not whole words.
    pub fn clear_front<T>(&mut self, buffer: &Buffer<T>, len: usize) {
        assert!(len <= buffer.len(), "{}: {len} values of {}", buffer.label(), buffer.len());
        let bytes = (len * size_of::<T>()) as u64;
        assert!(bytes.is_multiple_of(4), "{}: {bytes} bytes are not whole words", buffer.label());
        if bytes > 0 {
            self.commands.push(Command::Clear { buffer: buffer.raw.clone(), bytes });
        }
    }

    /// Copies the values `range` of `from` to `to` from place `at` on.
    ///
    /// # Panics
    /// When either is shorter, or the values are not whole words.
    pub fn copy<T>(&mut self, from: &Buffer<T>, range: Range<usize>, to: &Buffer<T>, at: usize) {
        let len = range.len();
        assert!(range.end <= from.len(), "{}: values {range:?} of {}", from.label(), from.len());
        assert!(at + len <= to.len(), "{}: {len} values at {at} of {}", to.label(), to.len());
        let [start, at, bytes] = [range.start, at, len].map(|n| (n * size_of::<T>()) as u64);
        assert!([start, at, bytes].iter().all(|b| b.is_multiple_of(4)), "{}: no whole words", from.label());
        self.commands.push(Command::Copy { from: (from.raw.clone(), start), to: (to.raw.clone(), at), bytes });
    }

    /// Hands everything to the device, in order. Does not wait.
    pub fn submit(self) -> Result<(), GpuError> {
        if strikes(Point::Lost) {
            self.gpu.lose();
        }
        // Until all is submitted: others would overwrite the parameters.
        let mut bindings = self.gpu.memory.bindings(self.gpu, &self.params);
        let groups = self.bind_groups(&mut bindings);
        if self.gpu.profiling() && self.gpu.info().clock {
            for (commands, groups) in self.commands.chunks(Stamps::MOST).zip(groups.chunks(Stamps::MOST)) {
                self.submit_stamped(commands, groups)?;
            }
        } else if self.gpu.profiling() {
            for (command, group) in self.commands.iter().zip(&groups) {
                self.gpu.timings.measure(command.label(), || {
                    self.submit_commands(std::slice::from_ref(command), std::slice::from_ref(group));
                    self.gpu.wait()
                })?;
            }
        } else {
            self.submit_commands(&self.commands, &groups);
        }
        self.gpu.check()
    }

    fn submit_commands(&self, commands: &[Command], groups: &[Option<wgpu::BindGroup>]) {
        let mut encoder = self.encoder();
        self.encode(&mut encoder, commands, groups);
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// Submits the commands with the device's clock read before and after each; waits.
    fn submit_stamped(&self, commands: &[Command], groups: &[Option<wgpu::BindGroup>]) -> Result<(), GpuError> {
        let stamps = Stamps::new(self.gpu, 2 * commands.len());
        let mut encoder = self.encoder();
        for (n, (command, group)) in commands.iter().zip(groups).enumerate() {
            encoder.write_timestamp(&stamps.set, 2 * n as u32);
            self.encode(&mut encoder, std::slice::from_ref(command), std::slice::from_ref(group));
            encoder.write_timestamp(&stamps.set, 2 * n as u32 + 1);
        }
        let secs = stamps.submit(self.gpu, encoder)?;
        for (command, &[begin, end]) in commands.iter().zip(secs.as_chunks().0) {
            self.gpu.timings.add(command.label(), end - begin, 0.0);
        }
        Ok(())
    }

    /// As [`submit`](Self::submit), and waits. Seconds by the device's clock from the first command's start to the last one's
    /// end, where it has a clock.
    pub fn submit_timed(self) -> Result<Option<f64>, GpuError> {
        let gpu = self.gpu;
        if !gpu.info().clock {
            self.submit()?;
            gpu.wait()?;
            return Ok(None);
        }
        let mut bindings = gpu.memory.bindings(gpu, &self.params);
        let groups = self.bind_groups(&mut bindings);
        let stamps = Stamps::new(gpu, 2);
        let mut encoder = self.encoder();
        encoder.write_timestamp(&stamps.set, 0);
        self.encode(&mut encoder, &self.commands, &groups);
        encoder.write_timestamp(&stamps.set, 1);
        let secs = stamps.submit(gpu, encoder)?;
        gpu.check()?;
        Ok(Some(secs[1] - secs[0]))
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(&self.label) })
    }

    /// What each command binds; nothing for those that are no dispatch.
    fn bind_groups(&self, bindings: &mut Bindings) -> Vec<Option<wgpu::BindGroup>> {
        let group = |command: &Command| match command {
            Command::Dispatch { kernel, params, buffers, .. } => {
                Some(bindings.group(&self.gpu.device, kernel, params.len(), buffers))
            }
            _ => None,
        };
        self.commands.iter().map(group).collect()
    }

    fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        commands: &[Command],
        bind_groups: &[Option<wgpu::BindGroup>],
    ) {
        let mut at = 0;
        while let Some(first) = commands.get(at) {
            match first {
                Command::Clear { buffer, bytes } => encoder.clear_buffer(buffer, 0, Some(*bytes)),
                Command::Copy { from, to, bytes } => {
                    encoder.copy_buffer_to_buffer(&from.0, from.1, &to.0, to.1, *bytes);
                }
                Command::Dispatch { .. } => {
                    let other = commands[at..].iter().position(|c| !matches!(c, Command::Dispatch { .. }));
                    let end = other.map_or(commands.len(), |n| at + n);
                    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                        label: Some(&self.label),
                        timestamp_writes: None,
                    });
                    for (command, group) in commands[at..end].iter().zip(&bind_groups[at..end]) {
                        if let Command::Dispatch { kernel, params, groups, .. } = command {
                            pass.set_pipeline(&kernel.pipeline);
                            pass.set_bind_group(0, group.as_ref(), &[params.start as u32]);
                            match groups {
                                Groups::Counted([x, y, z]) => pass.dispatch_workgroups(*x, *y, *z),
                                Groups::Stored(buffer, offset) => pass.dispatch_workgroups_indirect(buffer, *offset),
                            }
                        }
                    }
                    at = end;
                    continue;
                }
            }
            at += 1;
        }
    }
}
