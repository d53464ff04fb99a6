//! `effigy doctor` on machines that lack something.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

fn doctor(data: &Path, change: impl FnOnce(&mut Command)) -> (bool, Value) {
    let mut command = crate::program::effigy();
    command.args(["doctor", "--json", "--data-dir"]).arg(data);
    change(&mut command);
    let output = command.output().unwrap();
    let report = serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {output:?}"));
    (output.status.success(), report)
}

#[track_caller]
fn check<'a>(report: &'a Value, name: &str) -> &'a Value {
    let found = report["checks"].as_array().unwrap().iter().find(|check| check["name"] == name);
    found.unwrap_or_else(|| panic!("{name}: {report}"))
}

#[cfg(target_os = "linux")]
fn kernel_has_landlock() -> bool {
    // SAFETY: asks for the version of an interface and passes no memory.
    unsafe { libc::syscall(libc::SYS_landlock_create_ruleset, std::ptr::null::<u8>(), 0, 1) > 0 }
}

#[cfg(target_os = "linux")]
fn kernel_has_seccomp() -> bool {
    const GET_ACTION_AVAIL: libc::c_uint = 2;
    let action = libc::SECCOMP_RET_ERRNO;
    // SAFETY: asks whether an action is known; the pointer is to a live number.
    unsafe { libc::syscall(libc::SYS_seccomp, GET_ACTION_AVAIL, 0, &raw const action) == 0 }
}

#[cfg(not(target_os = "linux"))]
fn kernel_has_landlock() -> bool {
    false
}

#[cfg(not(target_os = "linux"))]
fn kernel_has_seccomp() -> bool {
    false
}

#[test]
fn a_missing_body_and_tool_are_named_with_their_cure() {
    let data = tempfile::tempdir().unwrap();
    // A driver loader finds its drivers without PATH, FFmpeg is found by it.
    let (ok, report) = doctor(data.path(), |command| {
        command.env("PATH", data.path());
    });
    assert!(!ok && report["ok"] == false);
    for (name, cure) in
        [("body", "effigy body import"), ("ffmpeg", "apt-get install ffmpeg"), ("ffprobe", "install FFmpeg")]
    {
        let check = check(&report, name);
        assert_eq!(check["state"], "failed", "{check}");
        assert!(check["mend"].as_str().unwrap().contains(cure), "{check}");
    }
    assert_ne!(check(&report, "disk")["state"], "failed");
    assert_eq!(check(&report, "database")["state"], "ok");
}

#[test]
fn a_machine_that_has_all_is_well() {
    let data = tempfile::tempdir().unwrap();
    std::fs::create_dir(data.path().join("bodies")).unwrap();
    effigy::body::Body::test_body().save(&data.path().join("bodies/default.body.npz")).unwrap();
    let (ok, report) = doctor(data.path(), |_| {});
    let decoder = check(&report, "decoder");
    let fences = [("files (Landlock)", kernel_has_landlock()), ("system calls (seccomp)", kernel_has_seccomp())];
    for (fence, there) in fences {
        let told = format!("{fence}: {}", if there { "yes" } else { "no" });
        assert!(decoder["found"].as_str().unwrap().contains(&told), "the kernel: {told}; {decoder}");
    }
    let whole = fences.iter().all(|(_, there)| *there);
    assert_eq!(decoder["state"], if whole { "ok" } else { "warning" }, "{decoder}");
    for name in ["ffmpeg", "ffprobe", "body", "database", "access"] {
        assert_eq!(check(&report, name)["state"], "ok", "{report}");
    }
    let device = check(&report, "device")["state"] != "failed";
    assert_eq!(ok, device, "{report}");
    assert!(device || std::env::var_os("CI").is_none(), "CI has a device: {report}");
    let (ok, report) = doctor(data.path(), |command| {
        command.arg("--listen=0.0.0.0:8080");
    });
    assert!(!ok && check(&report, "access")["mend"].as_str().unwrap().contains("effigy keys create"));
    for arguments in [["keys", "create", "lost"], ["keys", "revoke", "lost"]] {
        let mut keys = crate::program::effigy();
        assert!(keys.args(arguments).arg("--data-dir").arg(data.path()).output().unwrap().status.success());
    }
    // As a server would take callers.
    let access = |arguments: &[&str]| {
        let (_, report) = doctor(data.path(), |command| {
            command.args(arguments);
        });
        let access = check(&report, "access");
        (access["state"].as_str().unwrap().to_string(), access["found"].as_str().unwrap().to_string())
    };
    let says = |arguments: &[&str], state: &str, found: &str| {
        let (had, said) = access(arguments);
        assert!(had == state && said.contains(found), "{arguments:?}: {had}, {said}");
    };
    says(&[], "warning", "all keys are revoked");
    says(&["--auth=open"], "warning", "with a key or without");
    says(&["--auth=keys"], "warning", "all keys are revoked");
    says(&["--listen=0.0.0.0:8080"], "failed", "no key");
    let (_, report) = doctor(data.path(), |command| {
        command.arg("--disk-reserve-bytes=5000TiB");
    });
    assert_eq!(check(&report, "disk")["state"], "failed", "no upload has room: {report}");
    for (argument, wrong) in
        [("--log=x==", "the setting log"), ("--otlp-endpoint=nonsense", "the setting otlp_endpoint")]
    {
        let (_, report) = doctor(data.path(), |command| {
            command.arg(argument);
        });
        let told = check(&report, "log");
        assert!(told["state"] == "failed" && told["found"].as_str().unwrap().contains(wrong), "{told}");
    }
    let (_, report) = doctor(data.path(), |command| {
        command.arg("--otlp-endpoint=http://me:secret@127.0.0.1:4318");
    });
    let told = check(&report, "log")["found"].to_string();
    assert!(told.contains("spans to http://127.0.0.1:4318") && !told.contains("secret"), "{told}");
}

#[test]
fn what_is_no_jobs_folder_is_no_job() {
    let data = tempfile::tempdir().unwrap();
    std::fs::create_dir(data.path().join("jobs")).unwrap();
    std::fs::write(data.path().join("jobs/.DS_Store"), "").unwrap();
    let (_, report) = doctor(data.path(), |command| {
        command.arg("--auth=keys");
    });
    assert_eq!(check(&report, "database")["state"], "ok", "{report}");
    assert_eq!(check(&report, "access")["found"], "callers need a key, and there is none");
    std::fs::create_dir(data.path().join("jobs/0190a1b2-c3d4-7e5f-8a9b-0c1d2e3f4a5b")).unwrap();
    assert_eq!(check(&doctor(data.path(), |_| {}).1, "database")["state"], "failed");
}

#[test]
fn bodies_are_looked_for_where_the_doctor_looks() {
    let data = tempfile::tempdir().unwrap();
    let (_, report) = doctor(data.path(), |_| {});
    let option = format!("--data-dir '{}'", data.path().display());
    assert!(check(&report, "body")["mend"].as_str().unwrap().contains(&option), "{report}");
    let body = || {
        let mut body = crate::program::effigy();
        body.args(["body", "check", "default", "--data-dir"]).arg(data.path()).output().unwrap()
    };
    assert!(!body().status.success());
    std::fs::create_dir_all(data.path().join("bodies")).unwrap();
    effigy::body::Body::test_body().save(&data.path().join("bodies/default.body.npz")).unwrap();
    let said = body();
    assert!(said.status.success() && String::from_utf8_lossy(&said.stdout).contains("valid"), "{said:?}");
}

#[test]
fn a_device_that_is_not_there_is_told_with_those_that_are() {
    let data = tempfile::tempdir().unwrap();
    let (ok, report) = doctor(data.path(), |command| {
        command.env("EFFIGY_DEVICE", "no such device#2");
    });
    let check = check(&report, "device");
    assert!(!ok && check["state"] == "failed" && check["mend"].as_str().unwrap().contains("NAME#2"), "{report}");
    assert!(check["found"].as_str().unwrap().contains("no such device#2"), "{report}");
}

#[test]
fn a_damaged_database_is_told() {
    let data = tempfile::tempdir().unwrap();
    let path = data.path().join("effigy.db");
    let mut bytes = include_bytes!("../fixtures/effigy-0.1.0.db").to_vec();
    std::fs::write(&path, &bytes).unwrap();
    let (_, report) = doctor(data.path(), |_| {});
    assert_eq!(check(&report, "database")["state"], "warning", "an old schema: {report}");
    assert_eq!(std::fs::read(&path).unwrap(), bytes, "a doctor changes nothing");
    bytes.truncate(4096);
    std::fs::write(&path, &bytes).unwrap();
    let (ok, report) = doctor(data.path(), |_| {});
    let check = check(&report, "database");
    assert!(!ok && check["state"] == "failed" && check["mend"].as_str().unwrap().contains("restore"), "{report}");
}
