// A pixel's weight in the colour loss. The importing file binds `weights: array<f32>`.
#const WEIGHTED: bool = false

fn weight_at(i: u32) -> f32 {
    if WEIGHTED {
        return weights[i];
    }
    return 1.0;
}
