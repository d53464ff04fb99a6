// Adds the keypoints' gradients to their sources; one invocation a source, over the keypoints that it is part of. Source
// 2i is vertex i, source 2i + 1 is joint i.
struct Params {
    n_sources: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> sources: array<u32>; // [S], each once
@group(0) @binding(2) var<storage, read> starts: array<u32>; // [S + 1]
@group(0) @binding(3) var<storage, read> keypoints: array<u32>;
@group(0) @binding(4) var<storage, read> keypoint_starts: array<u32>; // [K + 1], of gather
@group(0) @binding(5) var<storage, read> grad_keypoints: array<f32>; // [K, 3]
@group(0) @binding(6) var<storage, read_write> grad_vertices: array<f32>; // [V, 3]
@group(0) @binding(7) var<storage, read_write> grad_joints: array<f32>; // [24, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let s = id.x;
    if s >= params.n_sources {
        return;
    }
    var grad = vec3<f32>();
    for (var at = starts[s]; at < starts[s + 1u]; at++) {
        let k = keypoints[at];
        let g = vec3<f32>(grad_keypoints[3u * k], grad_keypoints[3u * k + 1u], grad_keypoints[3u * k + 2u]);
        grad += g / f32(keypoint_starts[k + 1u] - keypoint_starts[k]);
    }
    let i = 3u * (sources[s] / 2u);
    for (var axis = 0u; axis < 3u; axis++) {
        if sources[s] % 2u == 0u {
            grad_vertices[i + axis] += grad[axis];
        } else {
            grad_joints[i + axis] += grad[axis];
        }
    }
}
