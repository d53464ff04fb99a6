// Pass 4 where many cores run side by side, one tile with a list a workgroup: its faces from first to last, as `order` leaves
// them. Each goes to the place that the number of smaller ones tells; no face is twice in a list.
//
// Sixteen faces a round: llvmpipe ends an invocation after 65,535 rounds of all its loops together, which lists of some eight
// thousand faces come to.
#import shared/soft_face

const LANES: u32 = 64u;

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> starts: array<u32>;
@group(0) @binding(2) var<storage, read> busy: array<u32>;
@group(0) @binding(3) var<storage, read> entries: array<u32>;
@group(0) @binding(4) var<storage, read_write> ordered: array<u32>;

@compute @workgroup_size(LANES)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let place = group.x + group.y * groups.x;
    if place >= busy[0] {
        return;
    }
    let tile = busy[1u + place];
    let first = starts[tile];
    let end = starts[tile + 1u];
    // `forward` takes all faces then.
    if end > params.capacity {
        return;
    }
    for (var i = first + lane; i < end; i += LANES) {
        let face = entries[i];
        var smaller = 0u;
        for (var k = first; k < end; k += 16u) {
#for J in 0..16
            smaller += u32(k + $Ju < end && entries[min(k + $Ju, end - 1u)] < face);
#end
        }
        ordered[first + smaller] = face;
    }
}
