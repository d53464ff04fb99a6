//! The filters of system calls.

use std::collections::BTreeMap;
use std::io;

use seccompiler::SeccompCmpArgLen::Dword;
use seccompiler::SeccompCmpOp::MaskedEq;
use seccompiler::{BpfProgram, SeccompAction, SeccompCondition, SeccompFilter, SeccompRule, TargetArch};

pub(super) fn arch() -> Option<TargetArch> {
    std::env::consts::ARCH.try_into().ok()
}

/// Calls that end with `EPERM`: a decoder reads its input, computes, and writes to its pipe.
const DENIED: &[libc::c_long] = &[
    // Hosts and other processes' ends.
    libc::SYS_socket,
    libc::SYS_socketpair,
    libc::SYS_connect,
    libc::SYS_bind,
    libc::SYS_listen,
    libc::SYS_accept,
    libc::SYS_accept4,
    libc::SYS_sendto,
    libc::SYS_sendmsg,
    libc::SYS_sendmmsg,
    libc::SYS_shmget,
    libc::SYS_shmat,
    libc::SYS_msgget,
    libc::SYS_semget,
    libc::SYS_mq_open,
    // Other processes.
    libc::SYS_ptrace,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_process_madvise,
    libc::SYS_kcmp,
    libc::SYS_kill,
    libc::SYS_tkill,
    libc::SYS_rt_sigqueueinfo,
    libc::SYS_rt_tgsigqueueinfo,
    libc::SYS_pidfd_open,
    libc::SYS_pidfd_getfd,
    libc::SYS_pidfd_send_signal,
    libc::SYS_execveat,
    // A file without a name is executed past Landlock.
    libc::SYS_memfd_create,
    // Files.
    libc::SYS_openat2,
    libc::SYS_open_by_handle_at,
    libc::SYS_name_to_handle_at,
    libc::SYS_mkdirat,
    libc::SYS_mknodat,
    libc::SYS_unlinkat,
    libc::SYS_renameat2,
    libc::SYS_linkat,
    libc::SYS_symlinkat,
    libc::SYS_truncate,
    libc::SYS_fchmod,
    libc::SYS_fchmodat,
    libc::SYS_fchown,
    libc::SYS_fchownat,
    libc::SYS_utimensat,
    libc::SYS_setxattr,
    libc::SYS_lsetxattr,
    libc::SYS_fsetxattr,
    libc::SYS_inotify_init1,
    libc::SYS_fanotify_init,
    libc::SYS_mount,
    libc::SYS_umount2,
    libc::SYS_pivot_root,
    libc::SYS_chroot,
    libc::SYS_open_tree,
    libc::SYS_move_mount,
    libc::SYS_fsopen,
    libc::SYS_fspick,
    // The system, and doors of the kernel that had holes.
    libc::SYS_setns,
    libc::SYS_unshare,
    libc::SYS_bpf,
    libc::SYS_perf_event_open,
    libc::SYS_userfaultfd,
    libc::SYS_io_uring_setup,
    libc::SYS_io_uring_enter,
    libc::SYS_io_uring_register,
    libc::SYS_add_key,
    libc::SYS_request_key,
    libc::SYS_keyctl,
    libc::SYS_init_module,
    libc::SYS_finit_module,
    libc::SYS_delete_module,
    libc::SYS_kexec_load,
    libc::SYS_reboot,
    libc::SYS_swapon,
    libc::SYS_swapoff,
    libc::SYS_sethostname,
    libc::SYS_setdomainname,
    libc::SYS_settimeofday,
    libc::SYS_clock_settime,
    libc::SYS_adjtimex,
    libc::SYS_clock_adjtime,
    libc::SYS_syslog,
    libc::SYS_acct,
    libc::SYS_quotactl,
    libc::SYS_setuid,
    libc::SYS_setgid,
    libc::SYS_setresuid,
    libc::SYS_setresgid,
    libc::SYS_setgroups,
    libc::SYS_personality,
];

/// Names of the same calls that only this architecture still has.
#[cfg(target_arch = "x86_64")]
const DENIED_HERE: &[libc::c_long] = &[
    libc::SYS_fork,
    libc::SYS_vfork,
    libc::SYS_creat,
    libc::SYS_mkdir,
    libc::SYS_rmdir,
    libc::SYS_mknod,
    libc::SYS_unlink,
    libc::SYS_rename,
    libc::SYS_renameat,
    libc::SYS_link,
    libc::SYS_symlink,
    libc::SYS_chmod,
    libc::SYS_chown,
    libc::SYS_lchown,
    libc::SYS_utime,
    libc::SYS_utimes,
    libc::SYS_inotify_init,
    libc::SYS_iopl,
    libc::SYS_ioperm,
    libc::SYS_modify_ldt,
];
#[cfg(not(target_arch = "x86_64"))]
const DENIED_HERE: &[libc::c_long] = &[];

pub(super) fn filters() -> io::Result<Vec<Vec<libc::sock_filter>>> {
    let Some(arch) = arch() else { return Ok(Vec::new()) };
    let mut denied: BTreeMap<i64, Vec<SeccompRule>> =
        DENIED.iter().chain(DENIED_HERE).map(|&call| (call, Vec::new())).collect();
    // A thread shares its process; everything else that is cloned is a new one.
    denied.insert(libc::SYS_clone, vec![bits(0, libc::CLONE_THREAD, 0)?]);
    denied.insert(libc::SYS_openat, writing(2)?);
    #[cfg(target_arch = "x86_64")]
    denied.insert(libc::SYS_open, writing(1)?);
    // Its flags lie in memory, where no filter sees them; libraries go back to `clone`.
    let missing = BTreeMap::from([(libc::SYS_clone3, Vec::new())]);
    let filter = |calls, errno: libc::c_int| -> io::Result<BpfProgram> {
        let action = SeccompAction::Errno(errno as u32);
        let filter = SeccompFilter::new(calls, SeccompAction::Allow, action, arch);
        filter.and_then(TryInto::try_into).map_err(io::Error::other)
    };
    let (denied, missing) = (filter(denied, libc::EPERM)?, filter(missing, libc::ENOSYS)?);
    let plain = |program: BpfProgram| {
        let instructions = program.into_iter();
        instructions.map(|i| libc::sock_filter { code: i.code, jt: i.jt, jf: i.jf, k: i.k }).collect()
    };
    Ok(vec![other_abis(), plain(denied), plain(missing)])
}

/// On x86-64, refuses the x32 numbers: the same calls by other names.
fn other_abis() -> Vec<libc::sock_filter> {
    const X32: u32 = 0x4000_0000;
    let statement = |code: u32, k| libc::sock_filter { code: code as u16, jt: 0, jf: 0, k };
    let refuse = libc::SECCOMP_RET_ERRNO | libc::ENOSYS as u32;
    let is_x32 = libc::BPF_JMP | libc::BPF_JGE | libc::BPF_K;
    let jump = libc::sock_filter {
        code: is_x32 as u16,
        jt: 0,
        jf: 1,
        k: if cfg!(target_arch = "x86_64") { X32 } else { u32::MAX },
    };
    vec![
        // The call's number is the first word of what a filter sees.
        statement(libc::BPF_LD | libc::BPF_W | libc::BPF_ABS, 0),
        jump,
        statement(libc::BPF_RET | libc::BPF_K, refuse),
        statement(libc::BPF_RET | libc::BPF_K, libc::SECCOMP_RET_ALLOW),
    ]
}

/// Flags of an open, in argument `at`, that ask for more than reading.
fn writing(at: u8) -> io::Result<Vec<SeccompRule>> {
    [
        bits(at, libc::O_ACCMODE, libc::O_WRONLY),
        bits(at, libc::O_ACCMODE, libc::O_RDWR),
        bits(at, libc::O_ACCMODE, libc::O_ACCMODE),
        bits(at, libc::O_CREAT, libc::O_CREAT),
        bits(at, libc::O_TRUNC, libc::O_TRUNC),
    ]
    .into_iter()
    .collect()
}

/// Where the masked bits of an argument have a value.
fn bits(at: u8, mask: libc::c_int, value: libc::c_int) -> io::Result<SeccompRule> {
    let condition = SeccompCondition::new(at, Dword, MaskedEq(mask as u64), value as u64);
    condition.and_then(|condition| SeccompRule::new(vec![condition])).map_err(io::Error::other)
}
