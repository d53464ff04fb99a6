// Pass 4, one tile with a list an invocation: its faces from first to last, so that `forward` sums them in the same order in
// every run. They arrive nearly in order, and lists are short: a Shell sort, whose last round looks at each face once.
#import shared/soft_face

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> starts: array<u32>;
@group(0) @binding(2) var<storage, read> busy: array<u32>;
@group(0) @binding(3) var<storage, read_write> entries: array<u32>;

// Faces that lie `gap` apart.
fn order_by(first: u32, end: u32, gap: u32) {
    for (var i = first + gap; i < end; i++) {
        let face = entries[i];
        var at = i;
        while at >= first + gap {
            let before = entries[at - gap];
            if before < face {
                break;
            }
            entries[at] = before;
            at -= gap;
        }
        if at != i {
            entries[at] = face;
        }
    }
}

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let place = dealt_item(group, groups, lane);
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
    let n = end - first;
    // Ciura's gaps (2001), those that leave enough faces to each other.
    if n >= 1024u {
        order_by(first, end, 132u);
    }
    if n >= 512u {
        order_by(first, end, 57u);
    }
    if n >= 256u {
        order_by(first, end, 23u);
    }
    if n >= 128u {
        order_by(first, end, 10u);
    }
    if n >= 64u {
        order_by(first, end, 4u);
    }
    order_by(first, end, 1u);
}
