//! The command line. Each command has its file in `cli/`.

mod cli;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "effigy", version, about)]
struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Import, check and describe body models.
    Body(cli::body::Args),
    /// Fit an avatar to a clip.
    Fit(cli::fit::Args),
    /// Render an avatar in given poses, or as a turntable.
    Render(cli::render::Args),
    /// Compare an avatar with a folder of truth.
    Eval(cli::eval::Args),
    /// Make a clip of a clothed person, with truth.
    Synth(cli::synth::Args),
    /// Measure the paper's claims and write docs/results.md.
    Study(cli::study::Args),
    /// Fit spoiled versions of a clip and write docs/robustness.md.
    Robustness(cli::robustness::Args),
    /// Time the operators on this device.
    Bench(cli::bench::Args),
    /// Run the service: the API and its worker.
    Serve(cli::serve::Args),
    /// Run jobs of a data folder, without an API.
    Worker(cli::worker::Args),
    /// Make, list and revoke the keys of the service.
    Keys(cli::keys::Args),
    /// Check whether this machine can run the service, and tell how to mend what is in the way.
    Doctor(cli::doctor::Args),
    /// Copy the database and all files into a new folder, while the service runs.
    Backup(cli::backup::BackupArgs),
    /// Make a data folder from a backup.
    Restore(cli::backup::RestoreArgs),
    /// Print the settings in force and where each comes from.
    Config(cli::config::Args),
    /// Print the description of the API.
    Openapi,
}

fn main() -> anyhow::Result<()> {
    // Mesa's device-selection layer looks for a display and complains where there is none; adapters are chosen by us.
    // SAFETY: no other thread runs yet.
    unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    match Args::parse().command {
        Command::Body(args) => cli::body::run(args),
        Command::Fit(args) => cli::fit::run(args),
        Command::Render(args) => cli::render::run(args),
        Command::Eval(args) => cli::eval::run(args),
        Command::Synth(args) => cli::synth::run(args),
        Command::Study(args) => cli::study::run(args),
        Command::Robustness(args) => cli::robustness::run(args),
        Command::Bench(args) => cli::bench::run(args),
        Command::Serve(args) => cli::serve::run(args),
        Command::Worker(args) => cli::worker::run(args),
        Command::Keys(args) => cli::keys::run(args),
        Command::Doctor(args) => cli::doctor::run(args),
        Command::Backup(args) => cli::backup::run(args),
        Command::Restore(args) => cli::backup::restore(args),
        Command::Config(args) => cli::config::run(args),
        Command::Openapi => cli::openapi::run(),
    }
}
