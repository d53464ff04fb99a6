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
}

fn main() -> anyhow::Result<()> {
    match Args::parse().command {
        Command::Body(args) => cli::body::run(args),
    }
}
