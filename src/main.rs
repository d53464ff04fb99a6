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
    /// Render an avatar in given poses, or as a turntable.
    Render(cli::render::Args),
    /// Compare an avatar with a folder of truth.
    Eval(cli::eval::Args),
    /// Make a clip of a clothed person, with truth.
    Synth(cli::synth::Args),
}

fn main() -> anyhow::Result<()> {
    match Args::parse().command {
        Command::Body(args) => cli::body::run(args),
        Command::Render(args) => cli::render::run(args),
        Command::Eval(args) => cli::eval::run(args),
        Command::Synth(args) => cli::synth::run(args),
    }
}
