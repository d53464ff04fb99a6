//! Typed storage buffers. New buffers are always filled: with data or with zeros.

use std::borrow::Cow;
use std::marker::PhantomData;
use std::sync::Arc;

use bytemuck::Pod;
use wgpu::util::DeviceExt;

use super::device::{Gpu, GpuError, Memory};
use super::rehearsal::{Point, strikes};

/// `len` values of `T` on the device, tightly packed.
pub struct Buffer<T> {
    pub(super) raw: wgpu::Buffer,
    label: String,
    len: usize,
    /// Its own among the device's buffers.
    pub(super) number: u64,
    memory: Arc<Memory>,
    kind: PhantomData<T>,
}

impl<T> Buffer<T> {
    pub fn len(&self) -> usize {
        self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub fn label(&self) -> &str {
        &self.label
    }
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        self.memory.drop_buffer(self.raw.size());
    }
}

/// Buffers end with whole `vec4`s, zeros at first, so that kernels may take four values at a time.
const VECTOR: usize = 16;

const USAGE: wgpu::BufferUsages = wgpu::BufferUsages::STORAGE
    .union(wgpu::BufferUsages::INDIRECT)
    .union(wgpu::BufferUsages::COPY_DST)
    .union(wgpu::BufferUsages::COPY_SRC);

impl Gpu {
    /// A buffer that holds `data`. An empty slice gives one zero element, because bindings cannot be empty.
    pub fn upload<T: Pod>(&self, label: &str, data: &[T]) -> Buffer<T> {
        if data.is_empty() {
            return self.zeros(label, 0);
        }
        let mut contents = Cow::Borrowed(bytemuck::cast_slice(data));
        if contents.len() % VECTOR != 0 {
            let padded = contents.len().next_multiple_of(VECTOR);
            contents.to_mut().resize(padded, 0);
        }
        let raw = self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(label),
            contents: &contents,
            usage: USAGE,
        });
        self.track(label, raw, data.len())
    }

    /// A buffer of `len` zeros.
    pub fn zeros<T: Pod>(&self, label: &str, len: usize) -> Buffer<T> {
        let size = (len.max(1) * size_of::<T>()).next_multiple_of(VECTOR) as u64;
        let raw = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage: USAGE,
            mapped_at_creation: false,
        });
        self.track(label, raw, len)
    }

    fn track<T>(&self, label: &str, raw: wgpu::Buffer, len: usize) -> Buffer<T> {
        let point = if self.is_apart() { Point::Picture } else { Point::Memory };
        // What comes after a fault is lost with it.
        if self.check().is_ok() && strikes(point) {
            self.run_out_of_memory(label);
        }
        self.memory.add(raw.size());
        let (number, memory) = (self.memory.number(), self.memory.clone());
        Buffer { raw, label: label.to_owned(), len, number, memory, kind: PhantomData }
    }

    /// Overwrites `buffer` from element `offset` on. Ordered before the next submission.
    ///
    /// # Panics
    /// When the data reaches past the buffer's end.
    pub fn write<T: Pod>(&self, buffer: &Buffer<T>, offset: usize, data: &[T]) {
        assert!(offset + data.len() <= buffer.len, "{}: write past the end", buffer.label);
        self.queue.write_buffer(&buffer.raw, (offset * size_of::<T>()) as u64, bytemuck::cast_slice(data));
    }

    /// Copies the whole buffer back; waits for all submitted work.
    pub fn read<T: Pod>(&self, buffer: &Buffer<T>) -> Result<Vec<T>, GpuError> {
        self.read_front(buffer, buffer.len)
    }

    /// Copies the first `len` values back; waits for all submitted work.
    ///
    /// # Panics
    /// When there are fewer.
    pub fn read_front<T: Pod>(&self, buffer: &Buffer<T>, len: usize) -> Result<Vec<T>, GpuError> {
        assert!(len <= buffer.len, "{}: {len} values of {}", buffer.label, buffer.len);
        if len == 0 {
            return Ok(Vec::new());
        }
        // Copies are whole words.
        let size = ((len * size_of::<T>()) as u64).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT).min(buffer.raw.size());
        let bytes = self.read_bytes(&buffer.raw, size, &buffer.label)?;
        Ok(bytemuck::pod_collect_to_vec(&bytes[..len * size_of::<T>()]))
    }

    /// The first `size` bytes of a buffer, whole words; waits.
    pub(super) fn read_bytes(&self, buffer: &wgpu::Buffer, size: u64, label: &str) -> Result<Vec<u8>, GpuError> {
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("gpu/read"),
            size,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder =
            self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("gpu/read") });
        encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, size);
        self.queue.submit([encoder.finish()]);
        let (send, receive) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |result| {
            let _ = send.send(result);
        });
        self.wait()?;
        receive
            .recv()
            .map_err(|e| GpuError::Lost(e.to_string()))?
            .map_err(|e| GpuError::Failed(format!("{label}: {e}")))?;
        let view = staging.get_mapped_range(..).map_err(|e| GpuError::Failed(format!("{label}: {e}")))?;
        Ok(view.to_vec())
    }
}
