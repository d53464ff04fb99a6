//! `effigy doctor`: whether this machine can run the service, and how to mend what is in the way.

use std::path::Path;
use std::process::Command;

use anyhow::{Result, bail};
use effigy::body::Body;
use effigy::capture::Confinement;
use effigy::config::{Bytes, Config, Value};
use effigy::data_dir::body_path_in;
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::http::Openness;
use effigy::jobs::sqlite::backup::examine;
use effigy::jobs::{Env, QueueError};
use effigy::storage::Store;
use serde::Serialize;

use super::service::{self, KeysFound, OWN, open_queue, policy};
use super::settings::ServerFlags;

#[derive(clap::Args)]
pub struct Args {
    /// Print JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: ServerFlags,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    Ok,
    /// It works, but not as well as it could.
    Warning,
    Failed,
}

/// What was looked at.
#[derive(Serialize)]
struct Check {
    name: &'static str,
    state: State,
    found: String,
    /// What to do about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    mend: Option<String>,
}

impl Check {
    fn ok(name: &'static str, found: impl Into<String>) -> Check {
        Check { name, state: State::Ok, found: found.into(), mend: None }
    }

    fn warning(name: &'static str, found: impl Into<String>, mend: impl Into<String>) -> Check {
        Check { name, state: State::Warning, found: found.into(), mend: Some(mend.into()) }
    }

    fn failed(name: &'static str, found: impl Into<String>, mend: impl Into<String>) -> Check {
        Check { name, state: State::Failed, found: found.into(), mend: Some(mend.into()) }
    }
}

/// Free space beside the reserve below which an upload of usual size may not fit.
const LITTLE_SPACE: u64 = 5 << 30;

pub fn run(args: Args) -> Result<()> {
    let in_force = args.settings.resolve()?;
    let data = in_force.config.data_dir();
    let mut checks = vec![
        device(),
        tool("ffmpeg"),
        tool("ffprobe"),
        decoder(),
        disk(&data, in_force.config.disk_reserve_bytes.0),
        body(&data),
        telling(&in_force.config),
    ];
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    checks.extend(runtime.block_on(database(&data, &in_force.config)));
    let failed = checks.iter().filter(|check| check.state == State::Failed).count();
    if args.json {
        println!("{}", serde_json::to_string_pretty(&serde_json::json!({ "ok": failed == 0, "checks": checks }))?);
    } else {
        for Check { name, state, found, mend } in &checks {
            let mark = match state {
                State::Ok => "ok     ",
                State::Warning => "warning",
                State::Failed => "FAILED ",
            };
            println!("{mark}  {name:9} {found}");
            if let Some(mend) = mend {
                println!("         {:9} → {mend}", "");
            }
        }
    }
    if failed > 0 {
        bail!("{failed} of {} checks failed", checks.len());
    }
    Ok(())
}

fn device() -> Check {
    let driver = "install a Vulkan driver (Debian: libvulkan1 and mesa-vulkan-drivers, or the vendor's), and in a container \
                  give it the device; EFFIGY_DEVICE chooses an adapter by a part of its name, NAME#2 the second of that name";
    match Gpu::open(&DeviceSelect::Auto) {
        Ok(gpu) => {
            let info = gpu.info();
            let mut found = format!("{} ({}, {})", info.name, info.backend, info.driver);
            if info.software {
                found.push_str(", which computes on the CPU");
            }
            if !gpu.skipped().is_empty() {
                let mend =
                    "mend what keeps it from opening (its driver, who else has it), or choose another by EFFIGY_DEVICE";
                return Check::warning("device", format!("{found}; passed over: {}", gpu.skipped().join("; ")), mend);
            }
            if info.software {
                let mend = "fits take minutes instead of seconds; a graphics device with a Vulkan driver is faster";
                return Check::warning("device", found, mend);
            }
            Check::ok("device", found)
        }
        Err(error) => Check::failed("device", error.to_string(), driver),
    }
}

fn tool(name: &'static str) -> Check {
    let mend = "install FFmpeg (Debian: apt-get install ffmpeg) so that it is in PATH";
    match Command::new(name).arg("-version").output() {
        Ok(output) if output.status.success() => {
            let text = String::from_utf8_lossy(&output.stdout);
            Check::ok(name, text.lines().next().unwrap_or("no version").split(" Copyright").next().unwrap_or_default())
        }
        Ok(output) => Check::failed(name, format!("it ends with {}", output.status), mend),
        Err(error) => Check::failed(name, error.to_string(), mend),
    }
}

/// What keeps a decoder that a crafted clip has taken over from the rest of the machine.
fn decoder() -> Check {
    let Confinement { files, calls } = Confinement::in_force();
    let word = |there| if there { "yes" } else { "no" };
    let found = format!("confined in files (Landlock): {}, in system calls (seccomp): {}", word(files), word(calls));
    if files && calls {
        return Check::ok("decoder", found);
    }
    let mend = "run it on Linux 5.13 or newer with Landlock and seccomp switched on and FFmpeg's libraries in the system's \
                folders, or in a container that holds nothing else; time, memory and output are bounded in any case";
    Check::warning("decoder", found, mend)
}

fn disk(data: &Path, reserve: u64) -> Check {
    let mend = "give the user who runs the service a folder that it may write (setting data_dir)";
    let store = match Store::open(data) {
        Ok(store) => store,
        Err(error) => return Check::failed("disk", format!("{}: {error}", data.display()), mend),
    };
    if let Err(error) = store.begin_upload() {
        return Check::failed("disk", format!("{} cannot be written: {error}", data.display()), mend);
    }
    match store.free_bytes() {
        Err(error) => Check::failed("disk", format!("{}: {error}", data.display()), mend),
        Ok(free) => {
            let found = format!("{:.1} GiB free in {}", free as f64 / (1u64 << 30) as f64, data.display());
            let little = reserve.saturating_add(LITTLE_SPACE);
            if free < reserve {
                let mend = format!(
                    "make room: {} are kept free (disk_reserve_bytes), and with less no upload is taken and no fit begins",
                    Bytes(reserve).text()
                );
                return Check::failed("disk", found, mend);
            }
            if store.is_open_to_all() {
                let mend = format!(
                    "chmod o-rwx {}: whoever reads the database can sign links to every avatar",
                    data.display()
                );
                return Check::warning("disk", format!("{found}, which all users of this machine can read"), mend);
            }
            if free < little {
                let mend = format!(
                    "make room, or set retain_days and start the service anew; {} are kept free (disk_reserve_bytes), and with \
                     less than {} uploads may not fit",
                    Bytes(reserve).text(),
                    Bytes(little).text()
                );
                return Check::warning("disk", found, mend);
            }
            Check::ok("disk", found)
        }
    }
}

/// Whether a server could log and send spans as it is told to.
fn telling(config: &Config) -> Check {
    if let Err(error) = service::log_filter(config) {
        return Check::failed("log", format!("{error:#}"), "write it as `warn,effigy=info` (setting log)");
    }
    let spans = config.otlp_endpoint.as_deref().map(effigy::telemetry::traces_url);
    match spans.transpose() {
        Err(error) => Check::failed("log", format!("{error:#}"), "write it as `http://127.0.0.1:4318`"),
        Ok(None) => Check::ok("log", config.log.clone()),
        // Not the whole address: it may hold a password.
        Ok(Some(url)) => Check::ok("log", format!("{}, spans to {}", config.log, url.origin().ascii_serialization())),
    }
}

fn body(data: &Path) -> Check {
    let path = body_path_in(data, "default");
    let data = data.display();
    let mend = format!(
        "import it, as the user who runs the service: EFFIGY_DATA_DIR='{data}' scripts/body.sh EFFIGY, or effigy body import \
         WHEEL --data-dir '{data}'"
    );
    match Body::load(&path) {
        Ok(body) => Check::ok("body", format!("{} vertices, {} faces", body.n_vertices(), body.n_faces())),
        Err(_) if !path.exists() => Check::failed("body", format!("there is no {}", path.display()), mend),
        Err(error) => Check::failed("body", format!("{}: {error}", path.display()), mend),
    }
}

/// The database, and whether a server would start on it.
async fn database(data: &Path, config: &Config) -> Vec<Check> {
    let path = data.join("effigy.db");
    let restore = "stop the service, move effigy.db* and jobs away, and restore a backup (docs/operating.md)";
    if !path.exists() {
        // The server does not start then.
        let jobs = Store::open(data).and_then(|store| store.job_folders()).map_or(0, |jobs| jobs.len());
        let found = match jobs {
            0 => Check::ok("database", "none yet; the first start makes it"),
            _ => Check::failed("database", format!("it is missing, and there are files of {jobs} jobs"), restore),
        };
        return vec![found, access(config, KeysFound { living: false, any: false })];
    }
    match examine(&path).await {
        Err(error) => {
            let mend = if error.is_refused() { OWN } else { restore };
            return vec![Check::failed("database", error.to_string(), mend)];
        }
        Ok(health) if health.integrity != "ok" => return vec![Check::failed("database", health.integrity, restore)],
        Ok(health) if health.version > health.known => {
            let found = format!("its schema {} is newer than this program's {}", health.version, health.known);
            return vec![Check::failed("database", found, "use the version of effigy that made it, or a newer one")];
        }
        // Opening it would bring it to this version, which is not a doctor's to do.
        Ok(health) if health.version < health.known => {
            let found = format!("schema {} becomes {} at the next start", health.version, health.known);
            return vec![Check::warning("database", found, "make a backup before that (effigy backup)")];
        }
        Ok(_) => {}
    }
    let Ok(store) = Store::open(data) else { return Vec::new() };
    match open_queue(&store, &Env::system(), policy(config)).await {
        Err(error) => {
            let mend = if service::is_queues(&error, QueueError::is_refused) { OWN } else { restore };
            vec![Check::failed("database", format!("{error:#}"), mend)]
        }
        Ok(queue) => {
            let whole = Check::ok("database", format!("{}, whole", path.display()));
            match KeysFound::of(queue.as_ref()).await {
                Ok(keys) => vec![whole, access(config, keys)],
                Err(error) => vec![Check::failed("database", format!("{error:#}"), restore)],
            }
        }
    }
}

/// Who could call a server with these settings.
fn access(config: &Config, keys: KeysFound) -> Check {
    let make = "make a key (effigy keys create NAME)";
    match service::openness(config, keys) {
        None => Check::failed(
            "access",
            "others can reach the server and there is no key",
            format!("{make}, listen on 127.0.0.1 instead of {}, or set auth", config.listen),
        ),
        Some(Openness::Keys) if keys.living => Check::ok("access", "callers need a key"),
        Some(Openness::Keys) if keys.any => {
            Check::warning("access", "callers need a key, and all keys are revoked or have expired", make)
        }
        Some(Openness::Keys) => Check::warning("access", "callers need a key, and there is none", make),
        Some(Openness::Local) => {
            Check::ok("access", format!("no keys: whoever is on this machine may call ({})", config.listen))
        }
        Some(Openness::Open) => Check::warning(
            "access",
            format!("whoever reaches {} may do everything, with a key or without", config.listen),
            "set auth to \"auto\" or \"keys\" unless something before the server asks who comes",
        ),
    }
}
