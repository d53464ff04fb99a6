//! `effigy keys`: who may use the service. Works on the data folder, whether a server runs on it or not.

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Subcommand;
use effigy::config::{Bytes, Value};
use effigy::jobs::keys::{Key, Keys, NewKey, Quota, Scope, Token};
use effigy::jobs::{Env, Timestamp};

use super::service::{open_queue, open_store, policy, tell_of_owner};
use super::settings::CommonFlags;

#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Make a key and print its token, which is shown this once.
    Create(Create),
    /// List all keys.
    List {
        #[command(flatten)]
        settings: CommonFlags,
    },
    /// End a key, by its name or id. Its jobs stay.
    Revoke {
        key: String,
        #[command(flatten)]
        settings: CommonFlags,
    },
}

#[derive(clap::Args)]
struct Create {
    /// For people, and for `revoke`.
    #[arg(value_parser = name)]
    name: String,
    /// What it allows: read, write, metrics, admin (all of it, on everybody's jobs).
    #[arg(long, value_delimiter = ',', default_value = "read,write", value_parser = scope)]
    scopes: Vec<Scope>,
    /// Jobs that may wait at a time.
    #[arg(long, value_name = "N")]
    max_queued: Option<u32>,
    /// Jobs that may run at a time; more wait.
    #[arg(long, value_name = "N")]
    max_running: Option<u32>,
    /// Inputs and results that may be kept, as 10GiB.
    #[arg(long, value_name = "BYTES", value_parser = bytes)]
    max_bytes: Option<Bytes>,
    /// Requests a minute.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    per_minute: Option<u32>,
    /// The key ends after so many days.
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..))]
    expires_in_days: Option<u32>,
    #[command(flatten)]
    settings: CommonFlags,
}

fn scope(text: &str) -> Result<Scope, String> {
    Scope::from_name(text).ok_or_else(|| format!("one of {}", Scope::ALL.map(Scope::name).join(", ")))
}

fn name(text: &str) -> Result<String, String> {
    let fits = (1..=64).contains(&text.chars().count()) && !text.trim().is_empty() && !text.contains(char::is_control);
    fits.then(|| text.into()).ok_or_else(|| "a name of 1 to 64 characters on one line".into())
}

/// No more than SQLite's whole numbers hold.
fn bytes(text: &str) -> Result<Bytes, String> {
    Bytes::parse(text).filter(|bytes| i64::try_from(bytes.0).is_ok()).ok_or_else(Bytes::kind)
}

#[tokio::main(flavor = "current_thread")]
pub async fn run(args: Args) -> Result<()> {
    match args.command {
        Command::Create(args) => create(args).await,
        Command::List { settings } => {
            println!("{:36}  {:20}  {:24}  {:40}  state", "id", "name", "scopes", "quota");
            for key in open(&settings).await?.list_keys().await? {
                println!("{}", line(&key));
            }
            Ok(())
        }
        Command::Revoke { key, settings } => match open(&settings).await?.revoke_key(&key).await? {
            Some(key) => {
                println!("revoked {} ({})", key.name, key.id);
                Ok(())
            }
            None => bail!("there is no living key {key:?}"),
        },
    }
}

async fn open(settings: &CommonFlags) -> Result<impl Keys> {
    let in_force = settings.resolve()?;
    let store = open_store(&in_force.config.data_dir())?;
    let queue = open_queue(&store, &Env::system(), policy(&in_force.config)).await?;
    tell_of_owner(&store)?;
    std::sync::Arc::into_inner(queue).context("the queue is ours alone")
}

async fn create(args: Create) -> Result<()> {
    let days = |days: u32| Env::system().now().plus(Duration::from_secs(u64::from(days) * 86_400));
    let new = NewKey {
        name: args.name,
        scopes: args.scopes.into_iter().collect::<BTreeSet<_>>(),
        quota: Quota {
            max_queued: args.max_queued,
            max_running: args.max_running,
            max_bytes: args.max_bytes.map(|bytes| bytes.0),
            per_minute: args.per_minute,
        },
        expires_at: args.expires_in_days.map(days),
    };
    let token = Token::new().context("the system's randomness")?;
    let key = open(&args.settings).await?.create_key(&new, &token).await?;
    let Some(key) = key else { bail!("there is a living key {:?} already", new.name) };
    eprintln!("key {} ({}); its token, which is not shown again:", key.name, key.id);
    println!("{}", token.reveal());
    Ok(())
}

fn line(key: &Key) -> String {
    let scopes = key.scopes.iter().map(|scope| scope.name()).collect::<Vec<_>>().join(",");
    let quota = &key.quota;
    let limits = [
        ("queued", quota.max_queued.map(|n| n.to_string())),
        ("running", quota.max_running.map(|n| n.to_string())),
        ("bytes", quota.max_bytes.map(|n| Bytes(n).text())),
        ("a minute", quota.per_minute.map(|n| n.to_string())),
    ];
    let limits = limits.into_iter().filter_map(|(name, limit)| Some(format!("{} {name}", limit?)));
    let limits = limits.collect::<Vec<_>>().join(", ");
    let state = match (key.revoked_at, key.expires_at) {
        (Some(time), _) => format!("revoked {}", time.rfc3339()),
        (None, Some(time)) if !key.is_alive(Env::system().now()) => format!("expired {}", time.rfc3339()),
        (None, end) => end.map_or("alive".into(), |time: Timestamp| format!("alive until {}", time.rfc3339())),
    };
    format!("{}  {:20}  {scopes:24}  {limits:40}  {state}", key.id, key.name)
}
