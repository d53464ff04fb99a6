// grads += the gradient of the penalty on accelerations of a rotation; one invocation a frame; see
// src/ops/angular_acceleration/mod.rs.
#import shared/linear_index
#import shared/rodrigues

struct Params {
    n_frames: u32,
    stride: u32,
    factor: f32,
    least_trace: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>; // [N, K]
@group(0) @binding(2) var<storage, read> expected: array<f32>; // [N, 3]
@group(0) @binding(3) var<storage, read> spacing: array<f32>; // [N, 2]: beta, alpha
@group(0) @binding(4) var<storage, read_write> grads: array<f32>; // [N, K]

fn vector(frame: u32) -> vec3<f32> {
    let at = frame * params.stride;
    return vec3<f32>(values[at], values[at + 1u], values[at + 2u]);
}

// s from a frame to the next, and whether that is motion.
struct Turn {
    s: vec3<f32>,
    known: bool,
}

fn turn(frame: u32) -> Turn {
    if frame + 1u >= params.n_frames {
        return Turn(vec3<f32>(0.0), false);
    }
    let q = transpose(rodrigues(vector(frame))) * rodrigues(vector(frame + 1u));
    // mat3x3 is indexed [column][row].
    let s = 0.5 * vec3<f32>(q[1][2] - q[2][1], q[2][0] - q[0][2], q[0][1] - q[1][0]);
    return Turn(s, q[0][0] + q[1][1] + q[2][2] >= params.least_trace);
}

// alpha s of a frame less beta s of the frame before, beyond the expected one; zero at the clip's ends and beside a gap.
fn acceleration(frame: u32) -> vec3<f32> {
    if frame == 0u || frame + 1u >= params.n_frames {
        return vec3<f32>(0.0);
    }
    let before = turn(frame - 1u);
    let after = turn(frame);
    let at = 3u * frame;
    let usual = vec3<f32>(expected[at], expected[at + 1u], expected[at + 2u]);
    let beyond = spacing[2u * frame + 1u] * after.s - spacing[2u * frame] * before.s - usual;
    return select(vec3<f32>(0.0), beyond, before.known && after.known);
}

// The gradient by Q of the turn from a frame to the next.
fn by_turn(frame: u32) -> mat3x3<f32> {
    let by_step = spacing[2u * frame + 1u] * acceleration(frame) - spacing[2u * frame + 2u] * acceleration(frame + 1u);
    let g = 0.5 * params.factor * by_step;
    return mat3x3<f32>(vec3<f32>(0.0, g.z, -g.y), vec3<f32>(-g.z, 0.0, g.x), vec3<f32>(g.y, -g.x, 0.0));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let frame = linear_index(id, groups, 64u);
    if frame >= params.n_frames {
        return;
    }
    var by_rotation = mat3x3<f32>();
    if frame + 1u < params.n_frames {
        by_rotation += rodrigues(vector(frame + 1u)) * transpose(by_turn(frame));
    }
    if frame > 0u {
        by_rotation += rodrigues(vector(frame - 1u)) * by_turn(frame - 1u);
    }
    let grad = rodrigues_backward(vector(frame), by_rotation);
    let at = frame * params.stride;
    grads[at] += grad.x;
    grads[at + 1u] += grad.y;
    grads[at + 2u] += grad.z;
}
