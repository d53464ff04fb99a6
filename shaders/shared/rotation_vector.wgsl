// Rotation vectors and unit quaternions (xyz, w); src/ops/bone_turns/quaternion.rs is the twin.
fn quaternion(vector: vec3<f32>) -> vec4<f32> {
    let t2 = dot(vector, vector);
    let half = 0.5 * sqrt(t2);
    if t2 < 1e-4 {
        return vec4<f32>((0.5 - t2 / 48.0) * vector, cos(half));
    }
    return vec4<f32>(sin(half) / (2.0 * half) * vector, cos(half));
}

// The rotation vector of q, of the two within a whole turn that whose quaternion is on the side of `near`.
fn rotation_vector(q: vec4<f32>, near: vec4<f32>) -> vec3<f32> {
    let on_side = select(q, -q, dot(q, near) < 0.0);
    let sine = length(on_side.xyz);
    if sine < 1e-6 {
        return 2.0 * on_side.xyz;
    }
    return 2.0 * atan2(sine, on_side.w) / sine * on_side.xyz;
}

fn inverse_of(q: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(-q.xyz, q.w);
}

// a after b
fn product_of(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}

fn rotated(q: vec4<f32>, x: vec3<f32>) -> vec3<f32> {
    let twice = 2.0 * cross(q.xyz, x);
    return x + q.w * twice + cross(q.xyz, twice);
}

// The gradient by w of the rotation of w, from that by turns from the right.
fn by_vector(w: vec3<f32>, torque: vec3<f32>) -> vec3<f32> {
    let t2 = dot(w, w);
    var a = 0.5 - t2 / 24.0 * (1.0 - t2 / 30.0);
    var b = 1.0 / 6.0 - t2 / 120.0 * (1.0 - t2 / 42.0);
    if t2 >= 1e-2 {
        let t = sqrt(t2);
        a = (1.0 - cos(t)) / t2;
        b = (t - sin(t)) / (t2 * t);
    }
    return combined(w, torque, a, b);
}

// The gradient by turns from the right, from that by w.
fn by_turn(w: vec3<f32>, gradient: vec3<f32>) -> vec3<f32> {
    let t2 = dot(w, w);
    var b = 1.0 / 12.0 + t2 / 720.0 * (1.0 + t2 / 42.0);
    if t2 >= 1e-2 {
        let half = 0.5 * sqrt(t2);
        b = (1.0 - half / tan(half)) / t2;
    }
    return combined(w, gradient, -0.5, b);
}

// x + a w × x + b w × (w × x)
fn combined(w: vec3<f32>, x: vec3<f32>, a: f32, b: f32) -> vec3<f32> {
    let once = cross(w, x);
    return x + a * once + b * cross(w, once);
}
