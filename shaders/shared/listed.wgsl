// The list's inverse: whether pixel i is in it, and where. A block is 32 pixels; its mask has a bit for each listed one.
const BLOCK: u32 = 32u;

fn is_listed(mask: u32, i: u32) -> bool {
    return ((mask >> (i % BLOCK)) & 1u) != 0u;
}

// The place of pixel i in the list, given its block's mask and first place.
fn place_of(mask: u32, first: u32, i: u32) -> u32 {
    return first + countOneBits(mask & ((1u << (i % BLOCK)) - 1u));
}
