// Pass 5 where many cores run side by side, one tile with a list a workgroup: its colours and alpha. The invocations share the
// list's faces; what each has of the pixels is merged in their order.
#import shared/soft_face
#import shared/soft_tile

#const LANES: u32 = 32u

// (most, weight, clear, red) and (green, blue) of each pixel and invocation.
var<workgroup> shares: array<vec4<f32>, TILE_PIXELS * LANES>;
var<workgroup> shares_gb: array<vec2<f32>, TILE_PIXELS * LANES>;

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
    var own: array<Share, TILE_PIXELS>;
#for J in 0..TILE
    #for I in 0..TILE
    own[$Ju * TILE + $Iu] = NO_SHARE;
    #end
#end
    let sharers = min(take_faces(&own, tile, lane, LANES), LANES);
#for J in 0..TILE
    #for I in 0..TILE
    {
        let share = own[$Ju * TILE + $Iu];
        let at = ($Ju * TILE + $Iu) * LANES + lane;
        shares[at] = vec4<f32>(share.most, share.weight, share.clear, share.colour.x);
        shares_gb[at] = share.colour.yz;
    }
    #end
#end
    workgroupBarrier();
    for (var i = lane; i < TILE_PIXELS; i += LANES) {
        var s = background_share();
        for (var j = 0u; j < sharers; j++) {
            let a = shares[i * LANES + j];
            s = merge(s, Share(a.x, a.y, a.z, vec3<f32>(a.w, shares_gb[i * LANES + j])));
        }
        write_pixel(tile, i, s);
    }
}
