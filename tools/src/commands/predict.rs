//! `netcord predict`: the last stage of the live pipeline, and its accuracy on recorded flights.

use std::path::PathBuf;

use netcord_common::{Counters, DomainName, Shutdown, bus::Bus, rig::Rig};
use netcord_detect::flight::{self, PredictOptions};

use crate::exit::{CommandResult, Outcome};

/// Predict the ball's flight: live, from `ball/position` to `ball/trajectory` and the search windows.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig file.
    #[arg(long, env = "NETCORD_RIG", value_name = "RIG.toml")]
    rig: Option<PathBuf>,

    /// The domain in which the rig's processes meet; default: the rig's name.
    #[arg(long, env = "NETCORD_DOMAIN", value_name = "NAME")]
    domain: Option<DomainName>,

    /// Where the ball can be hit: the plane y = Y of the table frame, in place of the rig file's.
    #[arg(long, value_name = "Y", allow_negative_numbers = true)]
    hitting_plane_y_m: Option<f64>,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> CommandResult {
    let rig = args.rig.as_ref().ok_or("no rig: give its file with --rig RIG.toml")?;
    live(args, &Rig::load(rig)?)
}

fn live(args: &Args, rig: &Rig) -> CommandResult {
    let domain = args.domain.clone().unwrap_or_else(|| rig.name.clone());
    let stop = Shutdown::on_signals()?;
    let bus = Bus::join(&domain, "predict")?;
    let options = PredictOptions { hitting_plane_y_m: args.hitting_plane_y_m };
    flight::live::run(&bus, rig, options, &stop, &Counters::new(), || {
        tracing::info!(%domain, "predict is ready");
    })?;
    Ok(Outcome::Good)
}
