// Pass 3, one face an invocation: its index into a list of each tile of its box where it is not hidden. What does not fit
// the capacity is left out; `forward` sees that from `starts`. And the face itself to those of its size in `drawn`.
#import shared/linear_index
#import shared/soft_face

// As in `setup`.
#const LIMITED: bool = false

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> boxes: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> cursors: array<atomic<u32>>; // [n_tiles], then of the drawn faces
@group(0) @binding(3) var<storage, read_write> entries: array<u32>;
@group(0) @binding(4) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> limits: array<f32>;
@group(0) @binding(6) var<storage, read_write> drawn: array<u32>; // how many faces, then which

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let first = (boxes[f] & vec2<u32>(0xffffu)) / TILE;
    let end = ((boxes[f] >> vec2<u32>(16u)) + TILE) / TILE;
    if (boxes[f].x & 0xffffu) > (boxes[f].x >> 16u) {
        return;
    }
    drawn[1u + atomicAdd(&cursors[params.n_tiles + size_class(box_pixels(boxes[f]))], 1u)] = f;
    let z_min = records[4u * f + 1u].w;
    for (var ty = first.y; ty < end.y; ty++) {
        for (var tx = first.x; tx < end.x; tx++) {
            let tile = ty * params.tiles_x + tx;
            if !LIMITED || z_min <= limits[tile] {
                let at = atomicAdd(&cursors[tile], 1u);
                if at < params.capacity {
                    entries[at] = f;
                }
            }
        }
    }
}
