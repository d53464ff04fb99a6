// Sums that do not depend on the order of what is added: whole multiples of 2^-50 in 64 bits, as words (low, high). What
// `#exact_sum` makes adds to them; see src/ops/exact_sum.rs.

const EXACT_HIGH: f32 = 262144.0; // the high word counts 2^-18
const EXACT_LOW: f32 = 4294967296.0; // 2^32
// The largest value that is added at once.
const EXACT_MOST: f32 = 4096.0;

fn exact_negated(words: vec2<u32>) -> vec2<u32> {
    return vec2<u32>(~words.x + 1u, ~words.y + select(0u, 1u, words.x == 0u));
}

// Exact but for what lies below 2^-50, which is cut off.
fn exact_words(value: f32) -> vec2<u32> {
    let scaled = min(abs(value), EXACT_MOST) * EXACT_HIGH;
    let high = floor(scaled);
    let words = vec2<u32>(u32((scaled - high) * EXACT_LOW), u32(high));
    return select(words, exact_negated(words), value < 0.0);
}

fn exact_value(words: vec2<u32>) -> f32 {
    // Of the magnitude: a small negative sum has a full high word, beside which the low one would lose its digits.
    let negative = (words.y & 0x80000000u) != 0u;
    let size = select(words, exact_negated(words), negative);
    let value = f32(size.y) / EXACT_HIGH + f32(size.x) / (EXACT_HIGH * EXACT_LOW);
    return select(value, -value, negative);
}
