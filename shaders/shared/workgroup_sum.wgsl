// The sum of `value` over the 256 lanes of a workgroup, always in the same order; every lane gets it. All lanes must
// call it, in uniform control flow.
var<workgroup> sum_lanes: array<f32, 256>;
var<workgroup> sum_rows: array<f32, 16>;

fn workgroup_sum(lane: u32, value: f32) -> f32 {
    workgroupBarrier();
    sum_lanes[lane] = value;
    workgroupBarrier();
    if lane < 16u {
        var row = 0.0;
        for (var i = 0u; i < 16u; i++) {
            row += sum_lanes[lane * 16u + i];
        }
        sum_rows[lane] = row;
    }
    workgroupBarrier();
    var total = 0.0;
    for (var i = 0u; i < 16u; i++) {
        total += sum_rows[i];
    }
    return total;
}
