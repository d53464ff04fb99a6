//! Host side of `shaders/texture_field/`.

use std::sync::Arc;

use super::layout::Layout;
use super::{FEATURES, MAX_LEVELS, TextureFieldConfig, TextureFieldError, TextureFieldParams};
use crate::gpu::{AnyBuffer, Buffer, Gpu, GpuError, Kernel, Recorder};
use crate::ops::exact_sum::ExactSum;

/// Lanes of a workgroup that takes a pixel a lane.
const LANES: usize = 256;
/// Lanes of a workgroup that adds up partial sums.
const REDUCE_LANES: usize = 64;
/// Workgroups along an axis, at most.
const MAX_GROUPS: usize = 65_535;

/// How the gradients' work is divided.
#[derive(Clone, Copy)]
struct Shares {
    /// Pixels that one partial sum of the weights' gradient covers.
    chunk: usize,
    /// Vectors of inputs and of outputs of one of its tiles, at most: the larger a tile, the less is read for each product.
    tile: [usize; 2],
    /// Tiles a workgroup.
    tiles: usize,
    /// Invocations that add up the partial sums of one weight.
    sharers: usize,
    /// Listed pixels that one invocation follows through a level: the more, the fewer atomic additions.
    run: usize,
}

impl Shares {
    const FEW_CORES: Self = Self { chunk: 256, tile: [2, 4], tiles: 8, sharers: 1, run: 32 };
    const MANY_CORES: Self = Self { chunk: 64, tile: [1, 1], tiles: 32, sharers: 16, run: 8 };

    fn of(gpu: &Gpu) -> Self {
        if gpu.info().wide { Self::MANY_CORES } else { Self::FEW_CORES }
    }

    /// The most pixels for which workgroups can be counted.
    fn max_capacity(&self) -> usize {
        MAX_GROUPS * LANES.min(self.chunk)
    }

    /// Of a layer: those that divide its inputs and outputs, vectors of four.
    fn tile(&self, (inputs4, outputs4): (usize, usize)) -> [usize; 2] {
        let side = |width4: usize, most: usize| (1..=most).rev().find(|&n| width4.is_multiple_of(n)).unwrap_or(1);
        [side(inputs4, self.tile[0]), side(outputs4, self.tile[1])]
    }
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct LevelUniform {
    scale: f32,
    resolution: u32,
    offset: u32,
    entries: u32,
    hashed: u32,
    pad: [u32; 3],
}

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct EncodeParams {
    n_max: u32,
    n_levels: u32,
    pad: [u32; 2],
    levels: [LevelUniform; MAX_LEVELS],
}

/// Places in the workgroups: a pixel an invocation, a run of pixels in a level, a chunk of the weights of a layer.
const BY_PIXEL: usize = 0;
const BY_RUN: usize = 3;
const BY_CHUNK: [usize; 3] = [6, 9, 12];

/// `(n_max, weights4, offset4, padding)`; each kernel reads as many as it declares.
type Params = [u32; 4];

struct Kernels {
    groups: Arc<Kernel>,
    encode_forward: Arc<Kernel>,
    mlp_forward: Arc<Kernel>,
    mlp_backward: Arc<Kernel>,
    table_gradient: Arc<Kernel>,
    coords_gradient: Arc<Kernel>,
    weight_gradient: [Arc<Kernel>; 3],
    weight_reduce: Arc<Kernel>,
}

/// What the last forward and backward passes left for each other.
struct Activations {
    /// Workgroups that the listed pixels take, three numbers each: at [`BY_PIXEL`], [`BY_RUN`], [`BY_CHUNK`].
    groups: Buffer<u32>,
    encoded: Buffer<f32>,
    hidden0: Buffer<f32>,
    hidden1: Buffer<f32>,
    delta0: Buffer<f32>,
    delta1: Buffer<f32>,
    delta2: Buffer<f32>,
    grad_encoded: Buffer<f32>,
    partial: Buffer<f32>,
}

/// A field with its gradients on the device, for up to `capacity` coordinates a pass.
pub struct TextureField {
    config: TextureFieldConfig,
    layout: Layout,
    capacity: usize,
    shares: Shares,
    encode_params: EncodeParams,
    kernels: Kernels,
    learns: bool,
    activations: Activations,
    /// `[entries, 2]`
    pub table: Buffer<f32>,
    /// All layers, in the device's order.
    pub weights: Buffer<f32>,
    pub grad_table: Buffer<f32>,
    table_sums: ExactSum,
    pub grad_weights: Buffer<f32>,
    /// `[capacity, 3]`, the last forward pass's result.
    pub rgb: Buffer<f32>,
}

impl TextureField {
    /// Uploads `params`; errors when they do not fit `config`.
    ///
    /// # Panics
    /// When the capacity is above 4 million.
    pub fn new(
        gpu: &Gpu,
        config: TextureFieldConfig,
        params: &TextureFieldParams,
        capacity: usize,
    ) -> Result<Self, TextureFieldError> {
        Self::with(gpu, config, params, capacity, true)
    }

    /// As [`new`](Self::new), for forward passes alone: gradients have no room and take none.
    pub fn to_show(
        gpu: &Gpu,
        config: TextureFieldConfig,
        params: &TextureFieldParams,
        capacity: usize,
    ) -> Result<Self, TextureFieldError> {
        Self::with(gpu, config, params, capacity, false)
    }

    fn with(
        gpu: &Gpu,
        config: TextureFieldConfig,
        params: &TextureFieldParams,
        capacity: usize,
        learns: bool,
    ) -> Result<Self, TextureFieldError> {
        params.validate(&config)?;
        let layout = Layout::new(&config);
        let shares = Shares::of(gpu);
        assert!(capacity <= shares.max_capacity(), "texture_field: capacity {capacity}");
        let (encoded, hidden) = (4 * layout.encoded4 * capacity, 4 * layout.hidden4 * capacity);
        let scratch = |name: &str, len: usize| gpu.zeros::<f32>(&format!("texture_field/{name}"), len);
        let gradient = |name: &str, len: usize| scratch(name, if learns { len } else { 0 });
        Ok(Self {
            config,
            layout,
            capacity,
            shares,
            encode_params: encode_params(&config),
            kernels: kernels(gpu, &layout, &shares),
            learns,
            activations: Activations {
                groups: gpu.zeros("texture_field/groups", 15),
                encoded: scratch("encoded", encoded),
                hidden0: scratch("hidden0", hidden),
                hidden1: scratch("hidden1", hidden),
                delta0: gradient("delta0", hidden),
                delta1: gradient("delta1", hidden),
                delta2: gradient("delta2", 4 * capacity),
                grad_encoded: gradient("grad_encoded", encoded),
                partial: gradient("partial", capacity.div_ceil(shares.chunk) * 4 * layout.weights4()),
            },
            table: gpu.upload("texture_field/table", &params.table),
            weights: gpu.upload("texture_field/weights", &layout.pack(params)),
            grad_table: gradient("grad_table", params.table.len()),
            table_sums: ExactSum::new(gpu, "texture_field/table_sums", if learns { params.table.len() } else { 0 }),
            grad_weights: gradient("grad_weights", 4 * layout.weights4()),
            rgb: scratch("rgb", 3 * capacity),
        })
    }

    pub fn config(&self) -> &TextureFieldConfig {
        &self.config
    }

    /// The most coordinates of a pass.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Records `rgb` of the first `min(count, n_max)` coordinates.
    ///
    /// # Panics
    /// When `n_max` is above the capacity or above the coordinates.
    pub fn forward(&self, recorder: &mut Recorder<'_>, coords: &Buffer<f32>, count: &Buffer<u32>, n_max: usize) {
        assert!(n_max <= self.capacity && 3 * n_max <= coords.len(), "texture_field: {n_max} coordinates");
        let a = &self.activations;
        let params: Params = [n_max as u32, 0, 0, 0];
        let [t0, t1, t2] = [0, 1, 2].map(|layer| {
            let (inputs4, outputs4) = self.layer4(layer);
            let [tile_i, tile_o] = self.shares.tile((inputs4, outputs4));
            (inputs4 / tile_i * (outputs4 / tile_o)).div_ceil(self.shares.tiles) as u32
        });
        let shares: [u32; 8] = [n_max as u32, self.config.n_levels as u32, t0, t1, t2, 0, 0, 0];
        recorder.dispatch(&self.kernels.groups, &shares, &[count, &a.groups], [1, 1, 1]);
        let encode = EncodeParams { n_max: n_max as u32, ..self.encode_params };
        let buffers: [&dyn AnyBuffer; 4] = [count, coords, &self.table, &a.encoded];
        recorder.dispatch_indirect(&self.kernels.encode_forward, &encode, &buffers, &a.groups, BY_PIXEL);
        let buffers: [&dyn AnyBuffer; 6] = [count, &self.weights, &a.encoded, &a.hidden0, &a.hidden1, &self.rgb];
        recorder.dispatch_indirect(&self.kernels.mlp_forward, &params, &buffers, &a.groups, BY_PIXEL);
    }

    /// Records the backward pass of the last [`forward`](Self::forward), with the same arguments: adds to `grad_weights` and
    /// `grad_coords [P, 3]` what `grad_rgb [P, 3]` says, and to `grad_table` when [`settle`](Self::settle) follows.
    ///
    /// # Panics
    /// As `forward`, when a gradient is shorter than `n_max`, and in a field [to show](Self::to_show).
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        coords: &Buffer<f32>,
        count: &Buffer<u32>,
        n_max: usize,
        grad_rgb: &Buffer<f32>,
        grad_coords: &Buffer<f32>,
    ) {
        assert!(self.learns, "texture_field: it has no gradients");
        let shortest = [self.capacity, coords.len() / 3, grad_rgb.len() / 3, grad_coords.len() / 3];
        assert!(shortest.iter().all(|&len| n_max <= len), "texture_field: {n_max} coordinates of {shortest:?}");
        let a = &self.activations;
        let weights4 = self.layout.weights4();
        let params = |offset4: usize| -> Params { [n_max as u32, weights4 as u32, offset4 as u32, 0] };
        let buffers: [&dyn AnyBuffer; 10] = [
            count,
            &self.weights,
            &a.hidden0,
            &a.hidden1,
            &self.rgb,
            grad_rgb,
            &a.delta0,
            &a.delta1,
            &a.delta2,
            &a.grad_encoded,
        ];
        recorder.dispatch_indirect(&self.kernels.mlp_backward, &params(0), &buffers, &a.groups, BY_PIXEL);
        let layers = [(&a.encoded, &a.delta0), (&a.hidden0, &a.delta1), (&a.hidden1, &a.delta2)];
        for (layer, (inputs, deltas)) in layers.into_iter().enumerate() {
            let buffers: [&dyn AnyBuffer; 4] = [count, inputs, deltas, &a.partial];
            let offset4 = self.layout.offsets4()[layer];
            let kernel = &self.kernels.weight_gradient[layer];
            recorder.dispatch_indirect(kernel, &params(offset4), &buffers, &a.groups, BY_CHUNK[layer]);
        }
        let buffers: [&dyn AnyBuffer; 3] = [count, &a.partial, &self.grad_weights];
        let groups = weights4.div_ceil(REDUCE_LANES / self.shares.sharers) as u32;
        recorder.dispatch(&self.kernels.weight_reduce, &params(0), &buffers, [groups, 1, 1]);
        let encode = EncodeParams { n_max: n_max as u32, ..self.encode_params };
        let buffers: [&dyn AnyBuffer; 4] = [count, coords, &a.grad_encoded, &self.table_sums.sums];
        recorder.dispatch_indirect(&self.kernels.table_gradient, &encode, &buffers, &a.groups, BY_RUN);
        let buffers: [&dyn AnyBuffer; 5] = [count, coords, &self.table, &a.grad_encoded, grad_coords];
        recorder.dispatch_indirect(&self.kernels.coords_gradient, &encode, &buffers, &a.groups, BY_PIXEL);
    }

    /// Records that `grad_table` takes in what backward passes found since it last did.
    pub fn settle(&self, recorder: &mut Recorder<'_>) {
        self.table_sums.settle(recorder, &self.grad_table);
    }

    /// Records zeros into `grad_table` and `grad_weights`.
    pub fn clear_gradients(&self, recorder: &mut Recorder<'_>) {
        recorder.clear(&self.grad_table);
        recorder.clear(&self.grad_weights);
    }

    /// The parameters as they are now.
    pub fn params(&self, gpu: &Gpu) -> Result<TextureFieldParams, GpuError> {
        self.unpack(gpu.read(&self.table)?, &gpu.read(&self.weights)?)
    }

    /// The gradients as they are now.
    pub fn gradients(&self, gpu: &Gpu) -> Result<TextureFieldParams, GpuError> {
        self.unpack(gpu.read(&self.grad_table)?, &gpu.read(&self.grad_weights)?)
    }

    /// `rgb [N, 3]` of any number of `coords [N, 3]`, in passes of the capacity. Waits.
    pub fn eval_points(&self, gpu: &Gpu, coords: &[f32]) -> Result<Vec<f32>, GpuError> {
        let mut rgb = Vec::with_capacity(coords.len());
        let buffer = gpu.zeros::<f32>("texture_field/eval_coords", 3 * self.capacity);
        for coords in coords.chunks(3 * self.capacity) {
            let n = coords.len() / 3;
            gpu.write(&buffer, 0, coords);
            let count = gpu.upload("texture_field/eval_count", &[n as u32]);
            let mut recorder = gpu.recorder("texture_field/eval_points");
            self.forward(&mut recorder, &buffer, &count, n);
            recorder.submit()?;
            rgb.extend(&gpu.read(&self.rgb)?[..coords.len()]);
        }
        Ok(rgb)
    }

    fn unpack(&self, table: Vec<f32>, weights: &[f32]) -> Result<TextureFieldParams, GpuError> {
        let [w0, w1, w2] = self.layout.unpack(weights);
        Ok(TextureFieldParams { table, w0, w1, w2 })
    }

    /// Inputs and outputs of a layer, in vectors of four.
    fn layer4(&self, layer: usize) -> (usize, usize) {
        layer4(&self.layout, layer)
    }
}

fn layer4(layout: &Layout, layer: usize) -> (usize, usize) {
    [(layout.encoded4, layout.hidden4), (layout.hidden4, layout.hidden4), (layout.hidden4, 1)][layer]
}

fn encode_params(config: &TextureFieldConfig) -> EncodeParams {
    let mut params: EncodeParams = bytemuck::Zeroable::zeroed();
    params.n_levels = config.n_levels as u32;
    for (uniform, level) in params.levels.iter_mut().zip(config.levels()) {
        *uniform = LevelUniform {
            scale: level.scale_of::<f32>(),
            resolution: level.resolution,
            offset: level.offset,
            entries: level.entries,
            hashed: level.hashed as u32,
            pad: [0; 3],
        };
    }
    debug_assert_eq!(config.n_features_per_level, FEATURES);
    params
}

fn kernels(gpu: &Gpu, layout: &Layout, shares: &Shares) -> Kernels {
    let lanes = ("LANES", format!("{LANES}u"));
    let encoded4 = ("ENCODED4", format!("{}u", layout.encoded4));
    let hidden4 = ("HIDDEN4", format!("{}u", layout.hidden4));
    let run = ("RUN", format!("{}u", shares.run));
    let chunk = ("CHUNK", format!("{}u", shares.chunk));
    let sharers = ("SHARERS", format!("{}u", shares.sharers));
    let reduce_lanes = ("LANES", format!("{REDUCE_LANES}u"));
    let weight_gradient = |layer: usize| {
        let (inputs4, outputs4) = layer4(layout, layer);
        let [tile_i, tile_o] = shares.tile((inputs4, outputs4));
        let constants = [
            ("INPUTS4", format!("{inputs4}u")),
            ("OUTPUTS4", format!("{outputs4}u")),
            ("TILE_I", format!("{tile_i}u")),
            ("TILE_O", format!("{tile_o}u")),
            chunk.clone(),
            ("LANES", format!("{}u", shares.tiles)),
        ];
        kernel!(gpu, "texture_field/weight_gradient", &constants)
    };
    let encoding = [lanes.clone(), encoded4.clone()];
    let widths = [lanes.clone(), encoded4.clone(), hidden4];
    Kernels {
        groups: kernel!(gpu, "texture_field/groups", &[lanes.clone(), chunk.clone(), run.clone()]),
        encode_forward: kernel!(gpu, "texture_field/encode_forward", &encoding),
        mlp_forward: kernel!(gpu, "texture_field/mlp_forward", &widths),
        mlp_backward: kernel!(gpu, "texture_field/mlp_backward", &widths),
        table_gradient: kernel!(gpu, "texture_field/table_gradient", &[encoded4.clone(), run]),
        coords_gradient: kernel!(gpu, "texture_field/coords_gradient", &encoding),
        weight_gradient: [0, 1, 2].map(weight_gradient),
        weight_reduce: kernel!(gpu, "texture_field/weight_reduce", &[chunk, sharers, reduce_lanes]),
    }
}
