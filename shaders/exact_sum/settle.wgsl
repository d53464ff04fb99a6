// values += sums, and the sums are zero again; four at a time.
#import shared/linear_index
#import shared/exact_sum

struct Params {
    len4: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> sums: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> values: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.len4 {
        return;
    }
    let low = sums[2u * i];
    let high = sums[2u * i + 1u];
    if any((low | high) != vec4<u32>(0u)) {
        values[i] += vec4<f32>(exact_value(low.xy), exact_value(low.zw), exact_value(high.xy), exact_value(high.zw));
        sums[2u * i] = vec4<u32>(0u);
        sums[2u * i + 1u] = vec4<u32>(0u);
    }
}
