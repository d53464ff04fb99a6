// What the colour loss's kernels are told.
struct RgbParams {
    n_pixels: u32,
    offset: u32,
    red: f32,
    green: f32,
    blue: f32,
    composite: f32,
    lambda: f32,
    seed: u32,
    threshold: u32,
    one_stands_for: f32, // pixels, of which one is in the sample
}
