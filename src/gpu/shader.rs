//! WGSL with four directives, each alone on its line:
//!
//! - `#import shared/NAME` pastes `shaders/shared/NAME.wgsl`, once.
//! - `#const NAME: TYPE = DEFAULT` becomes `const NAME: TYPE = VALUE;` where the host may give another value; array
//!   sizes can then depend on it, and no constant is stated twice.
//! - `#exact_sum BUFFER` makes `fn BUFFER_add(i: u32, value: f32)` for a storage binding declared as `array<exact_sum>`
//!   (`src/ops/exact_sum.rs`): one 64-bit atomic addition where the device has them, else two of 32 bits, with the same
//!   sums. It needs `#import shared/exact_sum`.
//! - `#for NAME in FIRST..END` repeats the lines up to its `#end` with `$NAME` replaced by each number; bounds are
//!   numbers or `#const` names, and repetitions nest. Drivers do not unroll long loops by themselves, and a software
//!   driver reads memory quickly at constant addresses alone.

use std::collections::{HashMap, HashSet};
use std::fmt::Write;

/// The import-only sources.
const SHARED: &[(&str, &str)] = &[
    ("shared/adam_step", include_str!("../../shaders/shared/adam_step.wgsl")),
    ("shared/area_ratio", include_str!("../../shaders/shared/area_ratio.wgsl")),
    ("shared/exact_sum", include_str!("../../shaders/shared/exact_sum.wgsl")),
    ("shared/hard_triangle", include_str!("../../shaders/shared/hard_triangle.wgsl")),
    ("shared/hash_grid", include_str!("../../shaders/shared/hash_grid.wgsl")),
    ("shared/linear_groups", include_str!("../../shaders/shared/linear_groups.wgsl")),
    ("shared/linear_index", include_str!("../../shaders/shared/linear_index.wgsl")),
    ("shared/listed", include_str!("../../shaders/shared/listed.wgsl")),
    ("shared/owned_pixels", include_str!("../../shaders/shared/owned_pixels.wgsl")),
    ("shared/owners", include_str!("../../shaders/shared/owners.wgsl")),
    ("shared/pinhole", include_str!("../../shaders/shared/pinhole.wgsl")),
    ("shared/rgb_difference", include_str!("../../shaders/shared/rgb_difference.wgsl")),
    ("shared/rgb_params", include_str!("../../shaders/shared/rgb_params.wgsl")),
    ("shared/rgb_weight", include_str!("../../shaders/shared/rgb_weight.wgsl")),
    ("shared/rodrigues", include_str!("../../shaders/shared/rodrigues.wgsl")),
    ("shared/sample", include_str!("../../shaders/shared/sample.wgsl")),
    ("shared/shade_parts", include_str!("../../shaders/shared/shade_parts.wgsl")),
    ("shared/silhouette", include_str!("../../shaders/shared/silhouette.wgsl")),
    ("shared/soft_face", include_str!("../../shaders/shared/soft_face.wgsl")),
    ("shared/soft_gradient", include_str!("../../shaders/shared/soft_gradient.wgsl")),
    ("shared/soft_tile", include_str!("../../shaders/shared/soft_tile.wgsl")),
    ("shared/target_pixel", include_str!("../../shaders/shared/target_pixel.wgsl")),
    ("shared/texel_cell", include_str!("../../shaders/shared/texel_cell.wgsl")),
    ("shared/unit_or_zero", include_str!("../../shaders/shared/unit_or_zero.wgsl")),
    ("shared/workgroup_sum", include_str!("../../shaders/shared/workgroup_sum.wgsl")),
];

/// What a source expands to on a device.
#[derive(Clone, Copy, Debug)]
pub struct Expansion<'a> {
    /// Whether the device adds to 64-bit numbers atomically.
    pub wide_sums: bool,
    /// Values for `#const` lines, as WGSL literals.
    pub constants: &'a [(&'a str, String)],
}

/// Expands the directives of `source`.
///
/// # Panics
/// On an unknown import, a malformed directive or a constant that the source does not declare: all are errors of the
/// program, found by the test that expands every shader.
pub fn expand(label: &str, source: &str, how: Expansion<'_>) -> String {
    let mut out = String::with_capacity(source.len() * 2);
    let mut seen = HashSet::new();
    let mut used = HashMap::new();
    if source.contains("#exact_sum") {
        let word = if how.wide_sums { "u64" } else { "u32" };
        writeln!(out, "alias exact_sum = atomic<{word}>;").unwrap();
    }
    paste(label, source, how, &mut seen, &mut used, &mut out);
    for (name, _) in how.constants {
        assert!(used.contains_key(*name), "{label}: no #const {name}");
    }
    unroll(label, &out, &used)
}

fn paste<'a>(
    label: &str,
    source: &'a str,
    how: Expansion<'_>,
    seen: &mut HashSet<String>,
    used: &mut HashMap<&'a str, String>,
    out: &mut String,
) {
    for line in source.lines() {
        if let Some(name) = line.strip_prefix("#import ") {
            let name = name.trim();
            if seen.insert(name.to_owned()) {
                let text = SHARED.iter().find(|(n, _)| *n == name);
                let (_, text) = text.unwrap_or_else(|| panic!("{label}: unknown import {name}"));
                paste(name, text, how, seen, used, out);
            }
        } else if let Some(rest) = line.strip_prefix("#const ") {
            let (declared, default) = rest.split_once('=').unwrap_or_else(|| panic!("{label}: {line}"));
            let (name, kind) = declared.split_once(':').unwrap_or_else(|| panic!("{label}: {line}"));
            let given = how.constants.iter().find(|(n, _)| *n == name.trim());
            let value = given.map_or(default.trim(), |(_, value)| value);
            used.insert(name.trim(), value.to_owned());
            writeln!(out, "const {}: {} = {value};", name.trim(), kind.trim()).unwrap();
        } else if let Some(buffer) = line.strip_prefix("#exact_sum ") {
            exact_add(buffer.trim(), how.wide_sums, out);
        } else {
            out.push_str(line);
            out.push('\n');
        }
    }
}

/// Repeats the lines between `#for` and `#end`.
fn unroll(label: &str, text: &str, constants: &HashMap<&str, String>) -> String {
    let mut out = String::with_capacity(text.len() * 2);
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let Some(head) = line.trim_start().strip_prefix("#for ") else {
            out.push_str(line);
            out.push('\n');
            continue;
        };
        let malformed = || -> ! { panic!("{label}: {line}") };
        let (name, range) = head.split_once(" in ").unwrap_or_else(|| malformed());
        let (first, end) = range.split_once("..").unwrap_or_else(|| malformed());
        let bound = |text: &str| -> u32 {
            let value = constants.get(text.trim()).map_or(text.trim(), String::as_str);
            value.trim_end_matches('u').parse().unwrap_or_else(|_| malformed())
        };
        let mut body = String::new();
        let mut depth = 1;
        for line in lines.by_ref() {
            depth += line.trim_start().starts_with("#for ") as i32 - (line.trim() == "#end") as i32;
            if depth == 0 {
                break;
            }
            body.push_str(line);
            body.push('\n');
        }
        assert!(depth == 0, "{label}: no #end for {line}");
        for i in bound(first)..bound(end) {
            let round = body.replace(&format!("${}", name.trim()), &i.to_string());
            out.push_str(&unroll(label, &round, constants));
        }
    }
    out
}

/// In two words the low ones' carries are counted one by one, so that the sum is whole whatever the order.
fn exact_add(buffer: &str, wide: bool, out: &mut String) {
    let body = if wide {
        format!("    atomicAdd(&{buffer}[i], (u64(words.y) << 32u) | u64(words.x));\n")
    } else {
        format!(
            "    let before = atomicAdd(&{buffer}[2u * i], words.x);
    let high = words.y + select(0u, 1u, before + words.x < before);
    if high != 0u {{
        atomicAdd(&{buffer}[2u * i + 1u], high);
    }}
"
        )
    };
    write!(out, "fn {buffer}_add(i: u32, value: f32) {{\n    let words = exact_words(value);\n{body}}}\n").unwrap();
}

/// A number that a shared source states, for tests that the host's is the same: nothing checks what shaders index by it.
#[cfg(test)]
pub(crate) fn shared_constant(source: &str, name: &str) -> usize {
    let (_, text) = SHARED.iter().find(|(shared, _)| *shared == source).unwrap();
    let (_, rest) = text.split_once(&format!("const {name}: u32 = ")).unwrap();
    rest.split_once("u;").unwrap().0.parse().unwrap()
}

#[cfg(test)]
mod tests {
    use super::super::adapters::NEEDS;
    use super::*;

    fn shaders() -> Vec<(String, String)> {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders");
        let mut found = Vec::new();
        for folder in std::fs::read_dir(&root).unwrap().map(|f| f.unwrap().path()).filter(|f| f.is_dir()) {
            if folder.ends_with("shared") {
                continue;
            }
            for file in std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().path()) {
                let label = file.strip_prefix(&root).unwrap().with_extension("").display().to_string();
                found.push((label, std::fs::read_to_string(&file).unwrap()));
            }
        }
        found.sort();
        found
    }

    /// Every shader is valid WGSL with its default constants, with and without 64-bit atomics; no device is needed.
    #[test]
    fn naga_accepts_every_shader() {
        let all = shaders();
        assert!(!all.is_empty());
        let mut failures = String::new();
        for (label, source) in &all {
            for wide_sums in [true, false] {
                let text = expand(label, source, Expansion { wide_sums, constants: &[] });
                let mut validator =
                    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::all());
                let result = naga::front::wgsl::parse_str(&text)
                    .map_err(|e| e.emit_to_string(&text))
                    .and_then(|module| validator.validate(&module).map_err(|e| e.emit_to_string(&text)));
                if let Err(error) = result {
                    writeln!(failures, "{label} (64-bit atomics {wide_sums}):\n{error}").unwrap();
                }
                let entries = text.matches("@compute").count();
                if entries != 1 {
                    writeln!(failures, "{label}: {entries} entry points, expected 1").unwrap();
                }
            }
        }
        assert!(failures.is_empty(), "{failures}");
    }

    /// The host and shaders both spread workgroups over x and y, and one reads back what the other spread.
    #[test]
    fn rows_of_workgroups_are_as_long_here_as_there() {
        assert_eq!(shared_constant("shared/linear_groups", "ROW"), crate::gpu::recorder::ROW as usize);
    }

    /// Adapters that open have what every kernel needs, and none is refused for more than that.
    #[test]
    fn shaders_need_what_adapters_are_asked_for() {
        use naga::AddressSpace::{Storage, WorkGroup};
        let mut most: HashMap<&str, (u64, String)> = HashMap::new();
        for (label, source) in shaders() {
            let text = expand(&label, &source, Expansion { wide_sums: true, constants: &[] });
            let module = naga::front::wgsl::parse_str(&text).unwrap();
            let mut layouter = naga::proc::Layouter::default();
            layouter.update(module.to_ctx()).unwrap();
            let variables = || module.global_variables.iter().map(|(_, variable)| variable);
            let storage = variables().filter(|variable| matches!(variable.space, Storage { .. })).count();
            let shared = variables().filter(|variable| variable.space == WorkGroup);
            let bytes: u64 = shared.map(|variable| u64::from(layouter[variable.ty].size.next_multiple_of(16))).sum();
            let size = module.entry_points[0].workgroup_size.map(u64::from);
            for (limit, need) in [
                ("max_storage_buffers_per_shader_stage", storage as u64),
                ("max_compute_invocations_per_workgroup", size.iter().product()),
                ("max_compute_workgroup_size_x", size[0]),
                ("max_compute_workgroup_storage_size", bytes),
            ] {
                let most = most.entry(limit).or_default();
                if need > most.0 {
                    *most = (need, label.clone());
                }
            }
        }
        for (limit, (need, label)) in most {
            let (_, _, asked) = NEEDS.iter().find(|(name, ..)| *name == limit).unwrap();
            // The weights of a texture may take all of a workgroup's memory; those of the default do not.
            let fits = if limit == "max_compute_workgroup_storage_size" { need <= *asked } else { need == *asked };
            assert!(fits, "{label}: {limit} of {need}, asked for {asked}");
        }
    }

    #[test]
    fn a_constant_takes_the_host_value() {
        let text = expand("t", "#const N: u32 = 4u\n", Expansion { wide_sums: true, constants: &[("N", "8u".into())] });
        assert_eq!(text, "const N: u32 = 8u;\n");
    }

    #[test]
    fn repetitions_nest_and_take_constants() {
        let text = "#const N: u32 = 2u\n#for I in 0..N\na$I\n  #for J in 1..3\nb$I$J\n  #end\n#end\nc\n";
        let text = expand("t", text, Expansion { wide_sums: true, constants: &[] });
        assert_eq!(text, "const N: u32 = 2u;\na0\nb01\nb02\na1\nb11\nb12\nc\n");
    }

    #[test]
    #[should_panic(expected = "no #const M")]
    fn an_undeclared_constant_is_refused() {
        expand("t", "#const N: u32 = 4u\n", Expansion { wide_sums: true, constants: &[("M", "8u".into())] });
    }
}
