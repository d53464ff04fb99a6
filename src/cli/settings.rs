//! The settings as flags: every command of the service takes them, and reads the rest from variables and the file.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::PathBuf;

use anyhow::Result;
use clap::{Arg, ArgAction, ArgMatches, Command, FromArgMatches};
use effigy::config::{Config, Effective, SETTINGS, Setting, Sources, find_file};

/// The settings that a command was given; `ALL` also those that only the server follows.
#[derive(Clone, Debug, Default)]
pub struct Flags<const ALL: bool> {
    flags: BTreeMap<String, String>,
    file: Option<PathBuf>,
}

pub type ServerFlags = Flags<true>;
pub type CommonFlags = Flags<false>;

fn taken(all: bool) -> impl Iterator<Item = &'static Setting> {
    SETTINGS.iter().filter(move |setting| all || setting.worker)
}

impl<const ALL: bool> clap::Args for Flags<ALL> {
    fn augment_args(command: Command) -> Command {
        let file = Arg::new("config")
            .long("config")
            .value_name("FILE")
            // A path that may be empty.
            .value_parser(clap::value_parser!(OsString))
            .help("The configuration file [env: EFFIGY_CONFIG]; empty for none")
            .help_heading("Settings");
        taken(ALL).fold(command.arg(file), |command, setting| command.arg(argument(setting)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

fn argument(setting: &'static Setting) -> Arg {
    let default = if setting.default.is_empty() { "".into() } else { format!(" [default: {}]", setting.default) };
    Arg::new(setting.key)
        .long(setting.flag())
        .value_name("VALUE")
        .action(ArgAction::Set)
        .allow_hyphen_values(true)
        .help(format!("{}{default} [env: {}]", setting.doc.trim().trim_end_matches('.'), setting.variable()))
        .help_heading("Settings")
}

impl<const ALL: bool> FromArgMatches for Flags<ALL> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut settings = Self::default();
        settings.update_from_arg_matches(matches)?;
        Ok(settings)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.file = matches.get_one::<OsString>("config").map(PathBuf::from);
        for setting in taken(ALL) {
            if let Some(value) = matches.get_one::<String>(setting.key) {
                self.flags.insert(setting.key.into(), value.clone());
            }
        }
        Ok(())
    }
}

/// The settings in force.
pub struct InForce {
    pub config: Config,
    pub effective: Vec<Effective>,
    /// Variables that look like misspelt settings, with the setting that is near.
    pub strange: Vec<(String, String)>,
}

impl<const ALL: bool> Flags<ALL> {
    pub fn resolve(&self) -> Result<InForce> {
        // A variable that is no UTF-8 is nothing that we know.
        let variables = std::env::vars_os().filter_map(|(k, v)| Some((k.into_string().ok()?, v.into_string().ok()?)));
        let (mut sources, strange) = Sources::default().with_variables(variables);
        if let Some(path) = find_file(self.file.as_deref(), |name| std::env::var_os(name).map(PathBuf::from)) {
            sources = sources.with_file(&path)?;
        }
        sources.flags = self.flags.clone();
        let (config, effective) = Config::resolve(&sources)?;
        Ok(InForce { config, effective, strange })
    }
}

impl InForce {
    /// What makes a worker follow the same settings, whatever happens to the file meanwhile.
    pub fn worker_flags(&self, data_dir: &str) -> Vec<String> {
        let mut flags = vec!["--config=".to_string()];
        for Effective { setting, text, .. } in self.effective.iter().filter(|e| e.setting.worker) {
            let text = if setting.key == "data_dir" { data_dir } else { text };
            flags.push(format!("--{}={text}", setting.flag()));
        }
        flags
    }
}
