// The ambient light's and the lamp's part of the shade of a surface with normal `n`, of any length, where nothing is in the way;
// see src/ops/light/mod.rs.

struct Light {
    direction: vec3<f32>,
    wrap: f32,
    slope: vec3<f32>,
}

fn shade_parts(light: Light, n: vec3<f32>) -> vec2<f32> {
    let length_n = length(n);
    if length_n == 0.0 {
        return vec2(1.0, 0.0);
    }
    let parts = vec2(1.0 + dot(n, light.slope) / length_n, (dot(n, light.direction) / length_n + light.wrap) / (1.0 + light.wrap));
    return max(parts, vec2(0.0));
}
