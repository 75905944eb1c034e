//! `netcord predict`: the last stage of the live pipeline, and its accuracy on recorded flights.

mod evaluate;
mod files;

use std::path::PathBuf;

<<<<<<< HEAD:tools/src/commands/predict.rs
use netcord_common::DomainName;
use netcord_detect::flight::{self, PredictOptions};
=======
use netcord_common::{Counters, DomainName, Shutdown, bus::Bus, rig::Rig};
use netcord_detect::flight::{self, PredictOptions, recorded::EvaluateOptions};
>>>>>>> 9925ce7 (netcord predict --evaluate: prediction, landing, hitting and spin errors over recorded flights):tools/src/commands/predict/mod.rs

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

    /// Instead of running live: predict these recorded flights (files or folders) as if live, and compare.
    #[arg(long, num_args = 1.., value_name = "FLIGHTS")]
    evaluate: Vec<PathBuf>,

    /// Where the figures of --evaluate are written, as JSON.
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,

    /// Height of the table's surface in flights that are not in the table frame, m; default: found from
    /// the bounces.
    #[arg(long, value_name = "Z", allow_negative_numbers = true)]
    table_z: Option<f64>,

    /// Standard deviation of the recorded positions, m; default: found from their scatter.
    #[arg(long, value_name = "S")]
    sigma: Option<f64>,
}

impl Args {
    fn evaluate_options(&self) -> Result<EvaluateOptions, netcord_common::rig::RigError> {
        let mut options = EvaluateOptions { table_z_m: self.table_z, ..EvaluateOptions::default() };
        if let Some(path) = &self.rig {
            let rig = Rig::load(path)?;
            (options.constants, options.ball) = (rig.flight, rig.ball);
        }
        Ok(options)
    }
}

/// Runs the subcommand.
pub fn run(args: &Args) -> CommandResult {
<<<<<<< HEAD:tools/src/commands/predict.rs
    let rig = args.rig.clone().ok_or("no rig: give its file with --rig RIG.toml")?;
    let rig = RigArgs { rig, domain: args.domain.clone() };
=======
    if !args.evaluate.is_empty() {
        let sets = files::load(&args.evaluate)?;
        return evaluate::run(&sets, &args.evaluate_options()?, args.sigma, args.report.as_deref());
    }
    let rig = args.rig.as_ref().ok_or("no rig: give its file with --rig RIG.toml")?;
    live(args, &Rig::load(rig)?)
}

fn live(args: &Args, rig: &Rig) -> CommandResult {
    let domain = args.domain.clone().unwrap_or_else(|| rig.name.clone());
    let stop = Shutdown::on_signals()?;
    let bus = Bus::join(&domain, "predict")?;
>>>>>>> 9925ce7 (netcord predict --evaluate: prediction, landing, hitting and spin errors over recorded flights):tools/src/commands/predict/mod.rs
    let options = PredictOptions { hitting_plane_y_m: args.hitting_plane_y_m };
    stage::run("predict", &rig, |stage| {
        flight::live::run(&stage.bus, &stage.rig, options, &stage.stop, &stage.counters, || {
            tracing::info!(domain = %stage.bus.domain(), "predict is ready");
        })
    })
}
