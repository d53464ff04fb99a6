// One pixel an invocation: weight times the sum over the channels of |image - target|.
#import shared/linear_index
#import shared/rgb_difference
#import shared/rgb_weight

@group(0) @binding(0) var<uniform> params: RgbParams;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_pixels {
        return;
    }
    let off = abs(difference_at(i));
    values[i] = weight_at(i) * (off.x + off.y + off.z);
}
