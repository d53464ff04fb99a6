//! The fences, built before the fork and raised after it.

use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use landlock::{
    ABI, Access, AccessFs, AccessNet, CompatLevel, Compatible, PathBeneath, PathFd, Ruleset, RulesetAttr,
    RulesetCreatedAttr, Scope, path_beneath_rules,
};

use super::{Confinement, calls};

/// What is asked of a kernel that has it all; an older one gives what it has.
const NEWEST: ABI = ABI::V6;

/// Where systems keep libraries, and what the loader reads to find them.
const LIBRARIES: [&str; 10] = [
    "/lib",
    "/lib32",
    "/lib64",
    "/usr/lib",
    "/usr/lib32",
    "/usr/lib64",
    "/usr/local/lib",
    "/nix/store",
    "/gnu/store",
    "/etc/ld.so.cache",
];
/// Devices that libraries open when they start.
const DEVICES: [&str; 3] = ["/dev/null", "/dev/zero", "/dev/urandom"];

pub(super) fn available() -> Confinement {
    // SAFETY: asks for the version of an interface and passes no memory.
    let files = unsafe { libc::syscall(libc::SYS_landlock_create_ruleset, std::ptr::null::<u8>(), 0, 1) } > 0;
    // SAFETY: asks whether an action is known; the pointer is to a live number.
    let filtered = unsafe {
        let action = libc::SECCOMP_RET_ERRNO;
        const GET_ACTION_AVAIL: libc::c_uint = 2;
        libc::syscall(libc::SYS_seccomp, GET_ACTION_AVAIL, 0, &raw const action) == 0
    };
    Confinement { files, calls: filtered && calls::arch().is_some() }
}

pub(super) fn raise(
    wanted: Confinement,
    command: &mut Command,
    program: &Path,
    input: Option<&Path>,
) -> io::Result<()> {
    let ruleset = if wanted.files { ruleset(program, input)? } else { None };
    let filters = if wanted.calls { calls::filters()? } else { Vec::new() };
    if ruleset.is_none() && filters.is_empty() {
        return Ok(());
    }
    // SAFETY: between fork and exec only `prctl`, `landlock_restrict_self` and `seccomp` are called, on what was made
    // ready before; nothing is allocated.
    unsafe {
        command.pre_exec(move || {
            if libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0 {
                return Err(io::Error::last_os_error());
            }
            if let Some(ruleset) = &ruleset
                && libc::syscall(libc::SYS_landlock_restrict_self, ruleset.as_raw_fd(), 0) != 0
            {
                return Err(io::Error::last_os_error());
            }
            for filter in &filters {
                let program = libc::sock_fprog {
                    len: filter.len() as libc::c_ushort,
                    // The kernel reads it only.
                    filter: filter.as_ptr().cast_mut(),
                };
                if libc::prctl(libc::PR_SET_SECCOMP, libc::SECCOMP_MODE_FILTER, &raw const program) != 0 {
                    return Err(io::Error::last_os_error());
                }
            }
            Ok(())
        });
    }
    Ok(())
}

fn ruleset(program: &Path, input: Option<&Path>) -> io::Result<Option<OwnedFd>> {
    let program = program.canonicalize()?;
    let read = AccessFs::ReadFile | AccessFs::ReadDir;
    // The loader is a library that is executed.
    let libraries = LIBRARIES.iter().map(PathBuf::from).chain(own_libraries(&program));
    let place = |path: &Path| PathFd::new(path).map_err(io::Error::other);
    let (own, input) = (place(&program)?, input.map(place).transpose()?);
    let made = || {
        let rules = Ruleset::default()
            .set_compatibility(CompatLevel::BestEffort)
            .handle_access(AccessFs::from_all(NEWEST))?
            .handle_access(AccessNet::from_all(NEWEST))?
            .scope(Scope::from_all(NEWEST))?
            .create()?
            .add_rules(path_beneath_rules(libraries, read | AccessFs::Execute))?
            .add_rules(path_beneath_rules(DEVICES, AccessFs::ReadFile))?
            .add_rule(PathBeneath::new(own, AccessFs::ReadFile | AccessFs::Execute))?;
        match input {
            Some(input) => Ok(rules.add_rule(PathBeneath::new(input, AccessFs::ReadFile))?),
            None => Ok::<_, landlock::RulesetError>(rules),
        }
    };
    Ok(made().map_err(io::Error::other)?.into())
}

/// Libraries that came with a program outside of the system's folders (`/opt/ffmpeg/lib`), and those of the loader's
/// variable.
fn own_libraries(program: &Path) -> Vec<PathBuf> {
    let prefix = program.parent().and_then(Path::parent).filter(|prefix| *prefix != Path::new("/"));
    let own = prefix.into_iter().flat_map(|prefix| ["lib", "lib64"].map(|folder| prefix.join(folder)));
    let named = std::env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
    own.chain(std::env::split_paths(&named).filter(|folder| folder.is_absolute())).collect()
}
