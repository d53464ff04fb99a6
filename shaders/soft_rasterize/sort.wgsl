// Pass 4, one tile a workgroup: its faces from front to back, equal depths by index. Each entry counts those before it.
#import shared/soft_face

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> starts: array<u32>;
@group(0) @binding(2) var<storage, read> entries: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read_write> sorted: array<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let tile = group.x + group.y * groups.x;
    if tile >= params.n_tiles {
        return;
    }
    let start = starts[tile];
    let end = starts[tile + 1u];
    if end > params.capacity {
        return;
    }
    for (var i = start + lane; i < end; i += 64u) {
        let own = entries[i];
        var rank = start;
        for (var j = start; j < end; j++) {
            let other = entries[j];
            let before = other.x < own.x || (other.x == own.x && other.y < own.y);
            rank += select(0u, 1u, before);
        }
        sorted[rank] = own.y;
    }
}
