// Pass 2 where the faces are all that is wanted, four pixels an invocation.
#import shared/linear_index
#import shared/owners

@group(0) @binding(0) var<uniform> params: OwnersParams;
@group(0) @binding(1) var<storage, read> owners: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> pix_to_face: array<vec4<i32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if 4u * k >= params.n_pixels {
        return;
    }
    pix_to_face[k] = faces_of(owners_at(k));
}
