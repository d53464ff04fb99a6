// Where a coordinate lies between the texels of a row or column.
struct TexelCell {
    lower: u32,
    part: f32,
    // Derivative of the position by the coordinate; zero where it is held at the border.
    slope: f32,
}

fn texel_cell(x: f32, side: u32) -> TexelCell {
    let last = f32(side - 1u);
    let position = x * f32(side) - 0.5;
    let held = clamp(position, 0.0, last);
    let lower = min(u32(floor(held)), max(side, 2u) - 2u);
    return TexelCell(lower, held - f32(lower), select(0.0, f32(side), position >= 0.0 && position <= last));
}

// The four texels of a cell, row after row.
fn texel_corners(i: u32, j: u32, side: u32) -> vec4<u32> {
    let right = min(i + 1u, side - 1u);
    let below = min(j + 1u, side - 1u);
    return vec4<u32>(j * side + i, j * side + right, below * side + i, below * side + right);
}

fn texel_weights(a: f32, b: f32) -> vec4<f32> {
    return vec4<f32>((1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b);
}
