// keypoints = the mean of their sources; one invocation a keypoint. Source 2i is vertex i, source 2i + 1 is joint i.
struct Params {
    n_keypoints: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>; // [K + 1]
@group(0) @binding(2) var<storage, read> sources: array<u32>;
@group(0) @binding(3) var<storage, read> vertices: array<f32>; // [V, 3]
@group(0) @binding(4) var<storage, read> joints: array<f32>; // [24, 3]
@group(0) @binding(5) var<storage, read_write> keypoints: array<f32>; // [K, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let k = id.x;
    if k >= params.n_keypoints {
        return;
    }
    var sum = vec3<f32>();
    for (var at = starts[k]; at < starts[k + 1u]; at++) {
        let i = 3u * (sources[at] / 2u);
        if sources[at] % 2u == 0u {
            sum += vec3<f32>(vertices[i], vertices[i + 1u], vertices[i + 2u]);
        } else {
            sum += vec3<f32>(joints[i], joints[i + 1u], joints[i + 2u]);
        }
    }
    let mean = sum / f32(max(starts[k + 1u] - starts[k], 1u));
    keypoints[3u * k] = mean.x;
    keypoints[3u * k + 1u] = mean.y;
    keypoints[3u * k + 2u] = mean.z;
}
