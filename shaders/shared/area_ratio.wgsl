// r + 1/r and its derivative, continued as a straight line below `r_min`; src/ops/face_area/mod.rs.
fn ratio_cost(r: f32, r_min: f32) -> f32 {
    let clamped = max(r, r_min);
    return clamped + 1.0 / clamped + ratio_slope(r, r_min) * (r - clamped);
}

fn ratio_slope(r: f32, r_min: f32) -> f32 {
    let clamped = max(r, r_min);
    return 1.0 - 1.0 / (clamped * clamped);
}
