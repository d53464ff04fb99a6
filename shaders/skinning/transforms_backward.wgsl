// grad_transforms[j] = Σ_v w_vj grad_vertices[v] (v_posed[v], 1)ᵀ over the vertices that joint j moves; one workgroup a
// joint, in a fixed order.
struct Params {
    n_joints: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> joint_starts: array<u32>; // [24 + 1]
@group(0) @binding(2) var<storage, read> joint_vertices: array<u32>;
@group(0) @binding(3) var<storage, read> joint_weights: array<f32>;
@group(0) @binding(4) var<storage, read> v_posed: array<f32>;
@group(0) @binding(5) var<storage, read> grad_vertices: array<f32>;
@group(0) @binding(6) var<storage, read_write> grad_transforms: array<f32>; // [24, 3, 4]

var<workgroup> lanes: array<f32, 3072>; // 12 numbers × 256 lanes
var<workgroup> rows: array<f32, 192>; // 12 numbers × 16 rows of lanes

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let j = group.x;
    var x_sum = vec4<f32>();
    var y_sum = vec4<f32>();
    var z_sum = vec4<f32>();
    if j < params.n_joints {
        for (var at = joint_starts[j] + lane; at < joint_starts[j + 1u]; at += 256u) {
            let v = 3u * joint_vertices[at];
            let x = joint_weights[at] * vec4<f32>(v_posed[v], v_posed[v + 1u], v_posed[v + 2u], 1.0);
            x_sum += grad_vertices[v] * x;
            y_sum += grad_vertices[v + 1u] * x;
            z_sum += grad_vertices[v + 2u] * x;
        }
    }
    // All twelve sums share the barriers.
    for (var column = 0u; column < 4u; column++) {
        lanes[column * 256u + lane] = x_sum[column];
        lanes[(4u + column) * 256u + lane] = y_sum[column];
        lanes[(8u + column) * 256u + lane] = z_sum[column];
    }
    workgroupBarrier();
    if lane < 192u {
        var row = 0.0;
        for (var i = 0u; i < 16u; i++) {
            row += lanes[lane * 16u + i];
        }
        rows[lane] = row;
    }
    workgroupBarrier();
    if lane < 12u && j < params.n_joints {
        var total = 0.0;
        for (var i = 0u; i < 16u; i++) {
            total += rows[lane * 16u + i];
        }
        grad_transforms[12u * j + lane] = total;
    }
}
