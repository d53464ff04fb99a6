// What the camera saw at a pixel. `seen` holds one u32 a pixel (bytes r, g, b, mask) when PACKED, else floats.
// The importing file binds `seen: array<u32>`.

#const PACKED: bool = true

// Composited over the background where `composite` is 1: the masked ground truth.
fn target_rgb(i: u32, background: vec3<f32>, composite: f32) -> vec3<f32> {
    if PACKED {
        let bytes = unpack4x8unorm(seen[i]);
        return mix(bytes.xyz, mix(background, bytes.xyz, bytes.w), composite);
    }
    return bitcast<vec3<f32>>(vec3<u32>(seen[3u * i], seen[3u * i + 1u], seen[3u * i + 2u]));
}

fn target_mask(i: u32) -> f32 {
    if PACKED {
        return unpack4x8unorm(seen[i]).w;
    }
    return bitcast<f32>(seen[i]);
}
