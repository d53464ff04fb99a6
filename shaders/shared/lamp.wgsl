// The lamp's part of the shade of a surface with normal `n`, of any length; see src/ops/light/mod.rs.

struct Lamp {
    direction: vec3<f32>,
    wrap: f32,
}

fn lamp_at(lamp: Lamp, n: vec3<f32>) -> f32 {
    let length_n = length(n);
    var cosine = -1.0;
    if length_n > 0.0 {
        cosine = dot(n, lamp.direction) / length_n;
    }
    return max((cosine + lamp.wrap) / (1.0 + lamp.wrap), 0.0);
}
