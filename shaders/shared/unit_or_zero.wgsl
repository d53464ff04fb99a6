// n / |n|, or zero for the normal of a face without area (`DEGENERATE` in src/ops/face_normals/mod.rs).
fn unit_or_zero(n: vec3<f32>) -> vec3<f32> {
    let squared = dot(n, n);
    return select(vec3<f32>(), n * inverseSqrt(max(squared, 1e-24)), squared > 1e-24);
}
