//! `effigy config`: the settings in force, or their documentation.

use anyhow::Result;

use super::settings::ServerFlags;

#[derive(clap::Args)]
pub struct Args {
    /// Print the table of all settings, as `docs/configuration.md` holds it.
    #[arg(long)]
    table: bool,
    #[command(flatten)]
    settings: ServerFlags,
}

pub fn run(args: Args) -> Result<()> {
    if args.table {
        print!("{}", effigy::config::table());
        return Ok(());
    }
    let in_force = args.settings.resolve()?;
    print!("{}", effigy::config::show(&in_force.effective));
    for (name, nearest) in in_force.strange {
        eprintln!("{name} is no setting; did you mean {nearest}?");
    }
    Ok(())
}
