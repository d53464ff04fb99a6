//! Which adapter is opened, and what kernels need of it.

use super::device::{DeviceSelect, GpuError};

/// Bytes of memory that a workgroup has, at least: every desktop device has them.
pub const WORKGROUP_BYTES: usize = 32 * 1024;

/// A limit by wgpu's name, how to read it, and the least that kernels and the sizes of a fit take.
type Need = (&'static str, fn(&wgpu::Limits) -> u64, u64);

/// `shader.rs` holds those of shaders to what the shaders declare.
pub(super) const NEEDS: [Need; 7] = [
    ("max_storage_buffers_per_shader_stage", |l| l.max_storage_buffers_per_shader_stage.into(), 10),
    ("max_compute_invocations_per_workgroup", |l| l.max_compute_invocations_per_workgroup.into(), 256),
    ("max_compute_workgroup_size_x", |l| l.max_compute_workgroup_size_x.into(), 256),
    ("max_compute_workgroup_storage_size", |l| l.max_compute_workgroup_storage_size.into(), WORKGROUP_BYTES as u64),
    ("max_compute_workgroups_per_dimension", |l| l.max_compute_workgroups_per_dimension.into(), 65_535),
    ("max_storage_buffer_binding_size", |l| l.max_storage_buffer_binding_size, 128 << 20),
    ("max_buffer_size", |l| l.max_buffer_size, 128 << 20),
];

/// The first limit that is too low for the kernels.
pub(super) fn lack(limits: &wgpu::Limits) -> Option<String> {
    let short = NEEDS.iter().find(|(_, of, least)| of(limits) < *least);
    short.map(|(name, of, least)| format!("its {name} is {}, and kernels need {least}", of(limits)))
}

/// An adapter that somebody asked for: the `nth` whose name contains the text, without regard to case.
#[derive(Debug, PartialEq)]
struct Wanted {
    name: String,
    nth: usize,
}

impl Wanted {
    /// `NAME` or, for one of several alike, `NAME#2`.
    fn parse(text: &str) -> Wanted {
        let numbered = text.rsplit_once('#').and_then(|(name, nth)| Some((name, nth.parse().ok()?)));
        let (name, nth) = numbered.filter(|&(_, nth)| nth > 0).unwrap_or((text, 1));
        Wanted { name: name.to_lowercase(), nth }
    }

    fn fits(&self, name: &str) -> bool {
        name.to_lowercase().contains(&self.name)
    }
}

/// What of the adapters, each with its type and name, is tried in this order: all of them, the fastest first, or the one that was
/// asked for alone.
pub(super) fn candidates<A>(
    mut adapters: Vec<A>,
    select: &DeviceSelect,
    of: impl Fn(&A) -> (wgpu::DeviceType, String),
) -> Result<Vec<A>, GpuError> {
    let text = match select {
        DeviceSelect::Named(name) => Some(name.clone()),
        DeviceSelect::Auto => std::env::var("EFFIGY_DEVICE").ok().filter(|name| !name.is_empty()),
    };
    adapters.sort_by_key(|adapter| match of(adapter).0 {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    });
    let seen: Vec<String> = adapters.iter().map(|adapter| of(adapter).1).collect();
    if let Some(wanted) = text.as_deref().map(Wanted::parse) {
        adapters.retain(|adapter| wanted.fits(&of(adapter).1));
        adapters = adapters.into_iter().skip(wanted.nth - 1).take(1).collect();
    }
    match adapters.is_empty() {
        true => Err(GpuError::NoAdapter(format!("seen: {seen:?}, wanted: {text:?}"))),
        false => Ok(adapters),
    }
}

/// The first that opens, and why those before it did not.
pub(super) fn first_that_opens<A, D>(
    adapters: Vec<A>,
    mut open: impl FnMut(&A) -> Result<D, GpuError>,
) -> Result<(D, Vec<GpuError>), GpuError> {
    let mut skipped = Vec::new();
    for adapter in adapters {
        match open(&adapter) {
            Ok(device) => return Ok((device, skipped)),
            Err(error) => skipped.push(error),
        }
    }
    match skipped.len() {
        1 => Err(skipped.remove(0)),
        _ => Err(GpuError::NoneOpens(skipped.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wgpu::DeviceType::{Cpu, DiscreteGpu, IntegratedGpu};

    fn names(all: &[(wgpu::DeviceType, &str)], select: &DeviceSelect) -> Result<Vec<String>, GpuError> {
        let adapters: Vec<_> = all.iter().map(|&(kind, name)| (kind, name.to_owned())).collect();
        Ok(candidates(adapters, select, Clone::clone)?.into_iter().map(|(_, name)| name).collect())
    }

    #[test]
    fn a_name_chooses_one_adapter_and_a_number_one_of_several_alike() {
        let all =
            [(Cpu, "llvmpipe"), (IntegratedGpu, "Radeon #7"), (DiscreteGpu, "GeForce A"), (DiscreteGpu, "GeForce B")];
        let named = |text: &str| names(&all, &DeviceSelect::Named(text.into()));
        for (text, found) in [
            ("geforce", "GeForce A"),
            ("GeForce#1", "GeForce A"),
            ("geforce#2", "GeForce B"),
            ("#2", "GeForce B"),
            ("lvm", "llvmpipe"),
        ] {
            assert_eq!(named(text).unwrap(), [found], "{text}");
        }
        // No number of an adapter, so part of a name.
        assert_eq!(named("Radeon #").unwrap(), ["Radeon #7"]);
        let error = named("geforce#3").unwrap_err().to_string();
        assert!(error.contains("GeForce B") && error.contains("geforce#3"), "{error}");
    }

    #[test]
    fn without_a_name_all_are_tried_and_the_fastest_first() {
        if std::env::var_os("EFFIGY_DEVICE").is_some() {
            return;
        }
        let all = [(Cpu, "llvmpipe"), (IntegratedGpu, "Iris"), (DiscreteGpu, "GeForce")];
        assert_eq!(names(&all, &DeviceSelect::Auto).unwrap(), ["GeForce", "Iris", "llvmpipe"]);
        assert!(matches!(names(&[], &DeviceSelect::Auto), Err(GpuError::NoAdapter(_))));
    }

    #[test]
    fn an_adapter_that_does_not_open_is_passed_over() {
        let open = |adapter: &&str| match *adapter {
            "good" => Ok(adapter.to_string()),
            _ => Err(GpuError::Open { adapter: (*adapter).into(), reason: "it is taken".into() }),
        };
        let (device, skipped) = first_that_opens(vec!["bad", "good", "worse"], open).unwrap();
        assert_eq!((device.as_str(), skipped.len()), ("good", 1));
        assert!(skipped[0].to_string().contains("bad") && skipped[0].to_string().contains("taken"), "{skipped:?}");
        let error = first_that_opens(vec!["bad", "worse"], open).unwrap_err().to_string();
        assert!(error.contains("bad") && error.contains("worse"), "{error}");
        assert!(matches!(first_that_opens(vec!["bad"], open), Err(GpuError::Open { .. })));
    }

    #[test]
    fn a_limit_that_is_too_low_is_named() {
        let mut limits = wgpu::Limits {
            max_storage_buffers_per_shader_stage: 10,
            max_compute_workgroup_storage_size: WORKGROUP_BYTES as u32,
            ..wgpu::Limits::default()
        };
        assert_eq!(lack(&limits), None);
        limits.max_storage_buffers_per_shader_stage = 8;
        assert_eq!(lack(&limits).unwrap(), "its max_storage_buffers_per_shader_stage is 8, and kernels need 10");
    }
}
