// v_posed = v_deformed + posedirs · (R − I) of joints 1…23; one invocation a coordinate.
#import shared/linear_index

struct Params {
    len: u32, // 3V
    n_features: u32, // 23 · 9
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> v_deformed: array<f32>;
@group(0) @binding(2) var<storage, read> posedirs: array<f32>; // [23 · 9, 3V]
@group(0) @binding(3) var<storage, read> rotations: array<f32>; // [24, 3, 3]
@group(0) @binding(4) var<storage, read_write> v_posed: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.len {
        return;
    }
    var value = v_deformed[i];
    for (var k = 0u; k < params.n_features; k++) {
        // Every fourth entry of a 3×3 matrix lies on its diagonal.
        let identity = select(0.0, 1.0, (k % 9u) % 4u == 0u);
        value += posedirs[k * params.len + i] * (rotations[9u + k] - identity);
    }
    v_posed[i] = value;
}
