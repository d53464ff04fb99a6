// Pass 5, one tile with a list an invocation: its colours and alpha. Tiles with lists of one length stand side by side in
// `busy`, so that a vector of them ends together.
#import shared/soft_face
#import shared/soft_tile

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
    var shares: array<Share, TILE_PIXELS>;
#for J in 0..TILE
    #for I in 0..TILE
    shares[$Ju * TILE + $Iu] = NO_SHARE;
    #end
#end
    take_faces(&shares, tile, 0u, 1u);
#for J in 0..TILE
    #for I in 0..TILE
    write_pixel(tile, $Ju * TILE + $Iu, merge(background_share(), shares[$Ju * TILE + $Iu]));
    #end
#end
}
