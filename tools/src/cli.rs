//! The command line: options that all subcommands share, and the list of subcommands.

use clap::{Parser, Subcommand};
use netcord_common::telemetry::{self, LogFormat};

use crate::{commands, exit::CommandResult};

/// Finds a table tennis ball in 3D from synchronised cameras, in real time, and predicts its flight.
///
/// Every subcommand is a process of its own; processes of one rig meet in shared memory under the rig's
/// domain. Exit codes: 0 good, 1 done but something was missed, 2 an error.
#[derive(Debug, Parser)]
#[command(name = "netcord", version, propagate_version = true)]
pub struct Cli {
    /// Log level, or a list such as warn,netcord_capture=debug.
    #[arg(long, global = true, env = "NETCORD_LOG", default_value = "info", value_name = "FILTER")]
    log: String,

    /// Form of the log lines: text or json.
    #[arg(long, global = true, env = "NETCORD_LOG_FORMAT", default_value = "text", value_name = "FORMAT")]
    log_format: LogFormat,

    #[command(subcommand)]
    command: Command,
}

/// One row a subcommand.
#[derive(Debug, Subcommand)]
enum Command {
    /// Find the ball's position at each trigger from the detections of all cameras.
    Triangulate(commands::triangulate::Args),
    /// Predict the ball's flight, live or over recorded flights.
    Predict(commands::predict::Args),
    /// Check a rig file and show what it says.
    Rig(commands::rig::Args),
    /// Calibrate cameras, rig and table, from printed boards.
    Calib(commands::calib::Args),
}

impl Cli {
    /// Runs the subcommand.
    pub fn run(self) -> CommandResult {
        telemetry::init(&self.log, self.log_format)?;
        match self.command {
            Command::Triangulate(args) => commands::triangulate::run(&args),
            Command::Predict(args) => commands::predict::run(&args),
            Command::Rig(args) => commands::rig::run(&args),
            Command::Calib(args) => commands::calib::run(&args),
        }
    }
}
