// Pixels as the silhouette operators see them; src/ops/edge_gradient/mod.rs. The importing file binds
// `params: SilhouetteParams`, `pix_to_face`, `zbuf`, `alpha`, `grad_alpha`, `image` and `grad_image`.

#const HAS_RGB: bool = true

struct SilhouetteParams {
    width: u32,
    height: u32,
    // Metres.
    min_step: f32,
    // Pixels; of nmr alone.
    max_sweep: u32,
}

// (r, g, b, alpha)
fn seen_at(i: u32) -> vec4<f32> {
    if HAS_RGB {
        return vec4<f32>(image[3u * i], image[3u * i + 1u], image[3u * i + 2u], alpha[i]);
    }
    return vec4<f32>(0.0, 0.0, 0.0, alpha[i]);
}

fn grad_at(i: u32) -> vec4<f32> {
    if HAS_RGB {
        return vec4<f32>(grad_image[3u * i], grad_image[3u * i + 1u], grad_image[3u * i + 2u], grad_alpha[i]);
    }
    return vec4<f32>(0.0, 0.0, 0.0, grad_alpha[i]);
}

// Whether the surface of pixel p ends before its neighbour q, and hides what q shows.
fn occludes(p: u32, q: u32) -> bool {
    let fp = pix_to_face[p];
    let fq = pix_to_face[q];
    return fp >= 0 && (fq < 0 || (fp != fq && zbuf[q] - zbuf[p] > params.min_step));
}
