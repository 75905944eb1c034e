//! `netcord predict`: the last stage of the live pipeline, and its accuracy on recorded flights.

mod evaluate;
mod files;
mod fit;
mod plot;
mod reliability;

use std::{error::Error, path::PathBuf};

use netcord_common::{DomainName, rig::Rig};
use netcord_detect::flight::{self, PredictOptions, recorded::EvaluateOptions};

use super::RigArgs;
use crate::{exit::CommandResult, output, stage};

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
    #[arg(long, value_name = "Y", allow_negative_numbers = true, conflicts_with_all = ["evaluate", "fit"],
          value_parser = super::between(-10.0, 10.0, "metres"))]
    hitting_plane_y_m: Option<f64>,

    /// Instead of running live: predict these recorded flights (files or folders) as if live, and compare.
    #[arg(long, num_args = 1.., value_name = "FLIGHTS")]
    evaluate: Vec<PathBuf>,

    /// Instead of running live: fit the physical constants to these recorded flights, one in three held out.
    #[arg(long, num_args = 1.., value_name = "FLIGHTS", conflicts_with = "evaluate")]
    fit: Vec<PathBuf>,

    /// Writes what --fit found into the [flight] table of this rig file; the old file is kept beside it.
    /// The fit starts from the constants of --rig, or else of this file. Refused where the flights that were held
    /// out are predicted worse with them.
    #[arg(long, value_name = "RIG.toml", requires = "fit")]
    write: Option<PathBuf>,

    /// Has --write write constants that predict the flights that were held out worse than those before.
    #[arg(long, requires = "write")]
    force: bool,

    /// Where the figures of --evaluate or --fit are written, as JSON; a plot of the errors beside it, as PNG.
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,

    /// Height of the table's surface in flights that are not in the table frame, m; default: found from
    /// the bounces.
    #[arg(long, value_name = "Z", allow_negative_numbers = true,
          value_parser = super::between(-1000.0, 1000.0, "metres"))]
    table_z: Option<f64>,

    /// Standard deviation of the recorded positions, m; default: found from their scatter.
    #[arg(long, value_name = "S", allow_negative_numbers = true,
          value_parser = super::between(1e-6, 1.0, "metres"))]
    sigma: Option<f64>,
}

impl Args {
    fn evaluate_options(&self) -> Result<EvaluateOptions, netcord_common::rig::RigError> {
        let mut options = EvaluateOptions { table_z_m: self.table_z, ..EvaluateOptions::default() };
        if let Some(path) = self.rig.as_ref().or(self.write.as_ref()) {
            let rig = Rig::load(path)?;
            (options.constants, options.ball) = (rig.flight, rig.ball);
        }
        Ok(options)
    }

    /// Live, nothing must look as if it had an effect.
    fn refuse_unused(&self) -> Result<(), String> {
        let given = [
            ("--sigma", self.sigma.is_some(), "every position brings its own covariance"),
            ("--table-z", self.table_z.is_some(), "the rig file says where the table is"),
            (
                "--report",
                self.report.is_some(),
                "`netcord latency` and `netcord record` report on a live rig",
            ),
        ];
        match given.into_iter().find(|(_, given, _)| *given) {
            Some((name, _, live)) => {
                Err(format!("{name} is for recorded flights, with --evaluate or --fit; live, {live}"))
            }
            None => Ok(()),
        }
    }

    /// What is written replaces nothing that is read.
    fn check_outputs(&self) -> Result<(), Box<dyn Error>> {
        let mut read = files::listed(&[self.evaluate.as_slice(), &self.fit].concat())?;
        read.extend(self.rig.iter().chain(&self.write).cloned());
        let mut written: Vec<PathBuf> = self.report.iter().cloned().collect();
        if let (Some(report), true) = (&self.report, self.fit.is_empty()) {
            written.extend(evaluate::plot_path(report)?);
        }
        Ok(output::check(&read, &written)?)
    }
}

/// Runs the subcommand.
pub fn run(args: &Args) -> CommandResult {
    args.check_outputs()?;
    if !args.evaluate.is_empty() {
        let sets = files::load(&args.evaluate)?;
        return evaluate::run(&sets, &args.evaluate_options()?, args.sigma, args.report.as_deref());
    }
    if !args.fit.is_empty() {
        let sets = files::load(&args.fit)?;
        let outputs =
            fit::Outputs { report: args.report.as_deref(), rig: args.write.as_deref(), force: args.force };
        return fit::run(&sets, &args.evaluate_options()?, args.sigma, outputs);
    }
    args.refuse_unused()?;
    let rig = args.rig.clone().ok_or("no rig: give its file with --rig RIG.toml")?;
    let rig = RigArgs { rig, domain: args.domain.clone() };
    let options = PredictOptions { hitting_plane_y_m: args.hitting_plane_y_m };
    stage::run("predict", &rig, |stage| {
        flight::live::run(&stage.bus, &stage.rig, options, &stage.stop, &stage.counters, || {
            tracing::info!(domain = %stage.bus.domain(), "predict is ready");
        })
    })
}
