// lamps[i] = the lamp's part of the shade of normals[i].
#import shared/lamp
#import shared/linear_index

struct Params {
    lamp: Lamp,
    n: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> normals: array<f32>; // [R, 3]
@group(0) @binding(2) var<storage, read_write> lamps: array<f32>; // [R]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n {
        return;
    }
    lamps[i] = lamp_at(params.lamp, vec3(normals[3u * i], normals[3u * i + 1u], normals[3u * i + 2u]));
}
