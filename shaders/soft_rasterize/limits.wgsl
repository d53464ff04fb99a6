// One tile an invocation: the depth beyond which no face has a share in the tile's colours. Where a pixel shows a surface,
// that has a score of at least its nearness + ln(1/2): the pixel's centre is inside its face.
#import shared/linear_index
#import shared/soft_face

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> zbuf: array<f32>;
@group(0) @binding(2) var<storage, read_write> limits: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let tile = linear_index(id, groups, 64u);
    if tile >= params.n_tiles {
        return;
    }
    let x0 = (tile % params.tiles_x) * TILE;
    let y0 = (tile / params.tiles_x) * TILE;
    let x1 = min(x0 + TILE, params.width);
    let y1 = min(y0 + TILE, params.height);
    var farthest = 0.0;
    for (var y = y0; y < y1; y++) {
        for (var x = x0; x < x1; x++) {
            let z = zbuf[y * params.width + x];
            farthest = max(farthest, select(3e38, z, z > params.near && z < params.far));
        }
    }
    // A hair more than ln 2 for what is rounded.
    limits[tile] = farthest + (NEGLIGIBLE + 0.7) * (params.far - params.near) * params.gamma;
}
