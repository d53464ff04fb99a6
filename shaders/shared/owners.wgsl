// Who owns four pixels. The importing file binds `params: OwnersParams` and `owners: array<vec4<u32>>`.

// Whether an owner is the low word of a 64-bit number; see hard_rasterize/nearest.
#const WIDE: bool = false

struct OwnersParams {
    n_faces: u32,
    n_pixels: u32,
}

// n_faces - index, zero where there is none.
fn owners_at(k: u32) -> vec4<u32> {
    if WIDE {
        return vec4<u32>(owners[2u * k].xz, owners[2u * k + 1u].xz);
    }
    return owners[k];
}

fn faces_of(owner: vec4<u32>) -> vec4<i32> {
    return select(vec4<i32>(-1), vec4<i32>(params.n_faces - owner), owner > vec4<u32>(0u));
}
