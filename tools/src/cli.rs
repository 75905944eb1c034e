//! The command line: options that all subcommands share, and the list of subcommands.

use clap::{Parser, Subcommand};
use netcord_common::{
    realtime,
    telemetry::{self, LogFormat},
};

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

    /// Run on these processors only, such as 0,2.
    #[arg(long, global = true, value_name = "CPUS", value_delimiter = ',')]
    cpus: Vec<usize>,

    /// Run with this SCHED_FIFO real-time priority, 1-99.
    #[arg(long, global = true, value_name = "P", value_parser = clap::value_parser!(i32).range(1..=99))]
    priority: Option<i32>,

    #[command(subcommand)]
    command: Command,
}

/// One row a subcommand.
#[derive(Debug, Subcommand)]
enum Command {
    /// Run the whole pipeline on a synthetic rally and check it against the truth.
    Demo(commands::demo::Args),
    /// Start the processes of a rig, watch them, restart those that die, stop all in order.
    Up(commands::up::Args),
    /// Publish frames of all cameras: of USB3 Vision cameras, a synthetic scene, or a recording.
    Capture(commands::capture::Args),
    /// Ask a running capture to change exposure or gain, to start or to stop.
    Control(commands::control::Args),
    /// Find what may be the ball in each camera's frames; learn its colour from marked ones (--learn).
    Segment(commands::segment::Args),
    /// Find the ball's position at each trigger from the detections of all cameras.
    Triangulate(commands::triangulate::Args),
    /// Predict the ball's flight, live or over recorded flights.
    Predict(commands::predict::Args),
    /// Record a running rig into an MCAP file.
    Record(commands::record::Args),
    /// Save what is whole of a recording that was cut off.
    Recover(commands::recover::Args),
    /// Turn pictures into a recording.
    Import(commands::import::Args),
    /// Draw a recording: from above, from the side, in perspective, errors.
    Plot(commands::plot::Args),
    /// Show a running rig in Foxglove or Lichtblick.
    View(commands::view::Args),
    /// Run the stages over a recording: positions, detections, predictions, and a recording of them all.
    Process(commands::process::Args),
    /// Measure latencies, rates and losses of a running rig.
    Latency(commands::latency::Args),
    /// Print messages of a running rig as JSON lines.
    Listen(commands::listen::Args),
    /// Measure kernels, transport and the whole pipeline beside the machine's floors.
    Bench(commands::bench::Args),
    /// Find what about this machine would break real time, and the cure.
    Doctor(commands::doctor::Args),
    /// Check a rig file and show what it says; import and export calibrations; clean shared memory.
    Rig(commands::rig::Args),
    /// Compare the triangulation methods, triangulate given points with each, or compare kinds of frames (--input).
    Compare(commands::compare::Args),
    /// List USB3 Vision cameras, read and set their features, look through one.
    Cameras(commands::cameras::Args),
    /// Calibrate cameras, rig and table, from printed boards, moving points or straight lines.
    Calib(commands::calib::Args),
}

impl Cli {
    /// Runs the subcommand.
    pub fn run(self) -> CommandResult {
        telemetry::init(&self.log, self.log_format)?;
        if !self.cpus.is_empty() {
            realtime::bind_to_cpus(&self.cpus)?;
        }
        if let Some(priority) = self.priority {
            realtime::set_fifo_priority(priority)?;
        }
        match self.command {
            Command::Demo(args) => commands::demo::run(&args),
            Command::Up(args) => commands::up::run(&args),
            Command::Capture(args) => commands::capture::run(&args),
            Command::Control(args) => commands::control::run(&args),
            Command::Segment(args) => commands::segment::run(&args),
            Command::Triangulate(args) => commands::triangulate::run(&args),
            Command::Predict(args) => commands::predict::run(&args),
            Command::Record(args) => commands::record::run(&args),
            Command::Recover(args) => commands::recover::run(&args),
            Command::Import(args) => commands::import::run(&args),
            Command::Plot(args) => commands::plot::run(&args),
            Command::View(args) => commands::view::run(&args),
            Command::Process(args) => commands::process::run(&args),
            Command::Latency(args) => commands::latency::run(&args),
            Command::Listen(args) => commands::listen::run(&args),
            Command::Bench(args) => commands::bench::run(&args),
            Command::Doctor(args) => commands::doctor::run(&args),
            Command::Rig(args) => commands::rig::run(&args),
            Command::Compare(args) => commands::compare::run(&args),
            Command::Cameras(args) => commands::cameras::run(&args),
            Command::Calib(args) => commands::calib::run(&args),
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn no_two_arguments_of_a_command_have_one_name() {
        Cli::command().debug_assert();
    }
}
