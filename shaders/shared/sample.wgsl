// A random part of the pixels, the same for the same seed: `Sampling` of the host has the same.

// Two rounds of a PCG output permutation (Jarzynski & Olano 2020): every bit depends on pixel and seed.
fn pcg(value: u32) -> u32 {
    let state = value * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// Whether pixel i is kept: its hash is at most the threshold.
fn is_sampled(i: u32, seed: u32, threshold: u32) -> bool {
    return pcg(pcg(seed) + i) <= threshold;
}
