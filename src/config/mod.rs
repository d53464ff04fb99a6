//! What can be set about the service: one list of settings, from which come the flags, the variables, the file's keys,
//! the values and their documentation (`docs/configuration.md`).
//!
//! A flag wins over a variable, a variable over the file, the file over the default. To add a setting, add a line below.

mod resolve;
mod table;
mod value;

#[cfg(test)]
mod tests;

use std::net::SocketAddr;
use std::path::PathBuf;

pub use resolve::{ConfigError, Effective, Origin, Sources, find_file};
pub use table::{show, table};
pub use value::{Auth, Bytes, LogFormat, Origins, Seconds, Value};

/// A setting as it is declared.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// Its key in the file. The flag is `--key-with-hyphens`, the variable `EFFIGY_KEY_IN_CAPITALS`.
    pub key: &'static str,
    /// What its values look like.
    pub kind: fn() -> String,
    /// As it would be written in a variable; empty for none.
    pub default: &'static str,
    pub doc: &'static str,
    /// Whether workers follow it too, or the server alone.
    pub worker: bool,
}

impl Setting {
    pub fn flag(&self) -> String {
        self.key.replace('_', "-")
    }

    pub fn variable(&self) -> String {
        format!("EFFIGY_{}", self.key.to_uppercase())
    }

    pub fn of(key: &str) -> Option<&'static Setting> {
        SETTINGS.iter().find(|setting| setting.key == key)
    }
}

macro_rules! settings {
    ($($(#[doc = $doc:literal])+ $scope:ident $key:ident: $type:ty = $default:literal;)+) => {
        /// The settings' values.
        #[derive(Clone, Debug)]
        pub struct Config {
            $($(#[doc = $doc])+ pub $key: $type,)+
        }

        /// All settings, in the order of their documentation.
        pub const SETTINGS: &[Setting] = &[$(Setting {
            key: stringify!($key),
            kind: <$type as Value>::kind,
            default: $default,
            doc: concat!($($doc),+),
            worker: settings!(@$scope),
        }),+];

        impl Config {
            /// Values from all sources, and where each came from.
            pub fn resolve(sources: &Sources) -> Result<(Config, Vec<Effective>), ConfigError> {
                sources.check_keys()?;
                let mut effective = Vec::new();
                let config = Config { $($key: sources.value(stringify!($key), &mut effective)?,)+ };
                Ok((config, effective))
            }
        }
    };
    (@serve) => { false };
    (@both) => { true };
}

settings! {
    /// Where jobs, avatars and bodies are kept; by default `$XDG_DATA_HOME/effigy`, else `~/.local/share/effigy`.
    both data_dir: Option<PathBuf> = "";
    /// Address and port to listen on; port 0 takes a free one, and the server prints it.
    serve listen: SocketAddr = "127.0.0.1:8080";
    /// 1: the server runs a worker as a child process. 0: the API alone, for workers started by `effigy worker`.
    serve workers: Workers = "1";
    /// The largest upload, all parts together.
    serve max_upload_bytes: Bytes = "4GiB";
    /// So many resumable uploads that no job has used yet may be open, a quarter of them of one key.
    serve max_open_uploads: u32 = "100";
    /// The bytes of all open resumable uploads together.
    serve max_open_upload_bytes: Bytes = "32GiB";
    /// A resumable upload is removed when nothing has come for so many seconds.
    serve upload_ttl_secs: Seconds = "86400";
    /// Remove a job's files so many days after its end, also where it ended before the server started with this; without it
    /// they stay.
    both retain_days: Option<u32> = "";
    /// A fit that shows no step for so many seconds hangs: its attempt ends, and the worker's process is started anew;
    /// so is one that answers no render for a minute longer.
    both stall_secs: Seconds = "600";
    /// So many jobs may wait; more are refused with 429.
    serve max_queued: u32 = "1000";
    /// New uploads and fits leave so much of the data folder's disk free.
    both disk_reserve_bytes: Bytes = "1GiB";
    /// Who must show a key (`effigy keys create`). `auto`: everybody, once there is a key; a server that others can reach
    /// does not start without one. `keys`: everybody, always; right behind a proxy. `open`: nobody.
    serve auth: Auth = "auto";
    /// Origins whose pages may call the API from a browser, as `https://example.org`; `*` for all.
    serve cors_origins: Origins = "";
    /// Send webhooks also by plain HTTP and to addresses of one's own network. Whoever may make a webhook can then make
    /// the server talk to what only it can reach.
    serve webhooks_to_private: bool = "false";
    /// What is logged, in the form of `tracing`'s filters.
    both log: String = "warn,effigy=info";
    /// How it is logged: lines for people, or JSON objects for programs.
    both log_format: LogFormat = "text";
    /// An OpenTelemetry collector, as `http://127.0.0.1:4318`: it gets a span for each request, attempt and stage, by OTLP
    /// over HTTP. Without it nothing is sent.
    both otlp_endpoint: Option<String> = "";
}

pub use value::Workers;

impl Config {
    pub fn data_dir(&self) -> PathBuf {
        self.data_dir.clone().unwrap_or_else(crate::data_dir::data_dir)
    }
}
