// The rotation of an axis-angle vector, R = cos t · I + a [θ]× + b θθᵀ with t = |θ|, a = sin t / t, b = (1 − cos t) / t²,
// and its derivative. All four factors are even in t, so both hold at θ = 0; src/ops/skinning/rodrigues.rs derives them.
struct RodriguesFactors {
    a: f32,
    b: f32,
    da: f32, // (da/dt) / t
    db: f32, // (db/dt) / t
}

fn rodrigues_factors(t2: f32) -> RodriguesFactors {
    if t2 < 1e-2 {
        return RodriguesFactors(
            1.0 - t2 / 6.0 * (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0)),
            0.5 - t2 / 24.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0)),
            -1.0 / 3.0 + t2 / 30.0 * (1.0 - t2 / 28.0),
            -1.0 / 12.0 + t2 / 180.0 * (1.0 - t2 / 37.333333),
        );
    }
    let t = sqrt(t2);
    let a = sin(t) / t;
    let half = sin(0.5 * t) / t;
    let b = 2.0 * half * half;
    return RodriguesFactors(a, b, (cos(t) - a) / t2, (a - 2.0 * b) / t2);
}

fn rodrigues(theta: vec3<f32>) -> mat3x3<f32> {
    let t2 = dot(theta, theta);
    let f = rodrigues_factors(t2);
    let c = 1.0 - f.b * t2;
    let k = f.a * theta;
    return mat3x3<f32>(
        f.b * theta.x * theta + vec3<f32>(c, k.z, -k.y),
        f.b * theta.y * theta + vec3<f32>(-k.z, c, k.x),
        f.b * theta.z * theta + vec3<f32>(k.y, -k.x, c),
    );
}

// The gradient by θ from the gradient `g` by R.
fn rodrigues_backward(theta: vec3<f32>, g: mat3x3<f32>) -> vec3<f32> {
    let f = rodrigues_factors(dot(theta, theta));
    // mat3x3 is indexed [column][row].
    let axial = vec3<f32>(g[1][2] - g[2][1], g[2][0] - g[0][2], g[0][1] - g[1][0]);
    let g_theta = g * theta;
    let radial = -f.a * (g[0][0] + g[1][1] + g[2][2]) + f.da * dot(axial, theta) + f.db * dot(theta, g_theta);
    return f.a * axial + f.b * (g_theta + theta * g) + radial * theta;
}
