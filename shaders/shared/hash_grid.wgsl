// Multiresolution hash encoding (Müller et al. 2022, sections 3 and 4); the formulas are in src/ops/texture_field/mod.rs.

const MAX_LEVELS: u32 = 32u;

struct Level {
    scale: f32,      // cells over the unit interval
    resolution: u32, // grid points along an axis
    offset: u32,     // the level's first entry in the table
    entries: u32,
    hashed: u32, // 1 where resolution³ > entries; entries are then a power of two
    pad0: u32,
    pad1: u32,
    pad2: u32,
}

// The cell of a position in a level: the first corner and the place inside, in [0, 1].
struct Cell {
    corner: vec3<u32>,
    place: vec3<f32>,
}

fn cell_of(x: vec3<f32>, level: Level) -> Cell {
    let position = clamp(x, vec3<f32>(0.0), vec3<f32>(1.0)) * level.scale + 0.5;
    let corner = floor(position);
    // The minimum holds for any finite x already; it keeps the index of a NaN inside the table.
    return Cell(min(vec3<u32>(corner), vec3<u32>(level.resolution - 1u)), position - corner);
}

// The table entries of a cell's corners; bit 0 of the corner's number is x, bit 1 y, bit 2 z.
fn corner_entries(corner: vec3<u32>, level: Level) -> array<u32, 8> {
    let hashed = level.hashed != 0u;
    let step = select(vec2<u32>(level.resolution, level.resolution * level.resolution), vec2<u32>(2654435761u, 805459861u), hashed);
    let x = vec2<u32>(corner.x, corner.x + 1u);
    let y = vec2<u32>(corner.y * step.x, (corner.y + 1u) * step.x);
    let z = vec2<u32>(corner.z * step.y, (corner.z + 1u) * step.y);
    var entries: array<u32, 8>;
#for K in 0..8
    {
        let a = x[$Ku & 1u];
        let b = y[($Ku >> 1u) & 1u];
        let c = z[$Ku >> 2u];
        // A dense index is below 2·entries, so that one subtraction is the modulo.
        let dense = a + b + c;
        let wrapped = select(dense, dense - level.entries, dense >= level.entries);
        entries[$K] = level.offset + select(wrapped, (a ^ b ^ c) & (level.entries - 1u), hashed);
    }
#end
    return entries;
}
