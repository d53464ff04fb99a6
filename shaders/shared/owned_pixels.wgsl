// The pixels that a face owns, one after the other.
// The importing file imports shared/hard_triangle and binds `pix_to_face: array<i32>`.

// The face's first pixel from `cursor` on, and moves the cursor past it; (-1, -1) when there is no more. The search is
// cheap, and ends for all lanes of a subgroup before what is done with the pixel begins.
fn next_owned(f: u32, box: PixelBox, cursor: ptr<function, vec2<i32>>) -> vec2<i32> {
    var at = vec2<i32>(-1);
    while (*cursor).y <= box.y1 && at.x < 0 {
        let owned = pix_to_face[u32((*cursor).y) * params.width + u32((*cursor).x)] == i32(f);
        at = select(vec2<i32>(-1), *cursor, owned);
        *cursor = next_in(box, *cursor);
    }
    return at;
}
