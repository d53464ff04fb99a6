// Workgroups along x at most, as `linear_groups` of the host has it.
const ROW: u32 = 32768u;

// How `n` workgroups are spread over x and y; `shared/linear_index` reads them back.
fn linear_groups(n: u32) -> array<u32, 3> {
    return array(min(n, ROW), (n + ROW - 1u) / ROW, 1u);
}
