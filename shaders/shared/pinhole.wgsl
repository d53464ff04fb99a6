// The uniform of a pinhole camera over `n_points` points; src/ops/project/mod.rs.
struct Pinhole {
    n_points: u32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    z_min: f32,
    unused0: u32,
    unused1: u32,
    view_from_world: mat3x4<f32>, // the rows of 3×4 as columns
}
