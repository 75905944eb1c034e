//! `netcord predict`: the last stage of the live pipeline, and its accuracy on recorded flights.

use std::path::PathBuf;

use netcord_common::DomainName;
use netcord_detect::flight::{self, PredictOptions};

use super::RigArgs;
use crate::{exit::CommandResult, stage};

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
    let rig = args.rig.clone().ok_or("no rig: give its file with --rig RIG.toml")?;
    let rig = RigArgs { rig, domain: args.domain.clone() };
    let options = PredictOptions { hitting_plane_y_m: args.hitting_plane_y_m };
    stage::run("predict", &rig, |stage| {
        flight::live::run(&stage.bus, &stage.rig, options, &stage.stop, &stage.counters, || {
            tracing::info!(domain = %stage.bus.domain(), "predict is ready");
        })
    })
}
