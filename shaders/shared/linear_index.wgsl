// The index of an invocation in a 1D problem that is spread over x and y, because one axis has at most 65,535 workgroups.
fn linear_index(id: vec3<u32>, workgroups: vec3<u32>, workgroup_size: u32) -> u32 {
    return id.x + id.y * workgroups.x * workgroup_size;
}
