// lamps[f] = the lamp's part of the shade of face normal f, times the mean of what the face's corners see of the lamp.
#import shared/lamp
#import shared/linear_index

struct Params {
    lamp: Lamp,
    n: u32,
    first_visible: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> faces: array<u32>; // [F, 3]
@group(0) @binding(2) var<storage, read> normals: array<f32>; // [F, 3]
@group(0) @binding(3) var<storage, read> visible: array<f32>; // [N, V]
@group(0) @binding(4) var<storage, read_write> lamps: array<f32>; // [F]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n {
        return;
    }
    var seen = 0.0;
    for (var c = 0u; c < 3u; c++) {
        seen += visible[params.first_visible + faces[3u * i + c]];
    }
    lamps[i] = seen / 3.0 * lamp_at(params.lamp, vec3(normals[3u * i], normals[3u * i + 1u], normals[3u * i + 2u]));
}
