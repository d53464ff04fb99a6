// The colour loss at a pixel. The importing file binds `params: RgbParams`, `image` and `seen: array<u32>`.
#import shared/rgb_params
#import shared/target_pixel

// image - target
fn difference_at(i: u32) -> vec3<f32> {
    let wanted = target_rgb(params.offset + i, vec3<f32>(params.red, params.green, params.blue), params.composite);
    return vec3<f32>(image[3u * i], image[3u * i + 1u], image[3u * i + 2u]) - wanted;
}
