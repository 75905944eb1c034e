//! `netcord calib`: boards, calibration of cameras and rigs.

mod board;
mod input;
mod options;
mod save;
mod session;
mod solve;

use clap::Subcommand;

use crate::exit::CommandResult;

/// Arguments of `netcord calib`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Draw a board to print: SVG, PDF or PNG at true scale, with a ruler.
    Board(board::Args),
    /// Calibrate the intrinsics of cameras, one by one.
    Mono(solve::MonoArgs),
    /// Calibrate the pose of a second camera from simultaneous views.
    Stereo(solve::RigArgs),
    /// Calibrate the poses of any number of cameras, which may see the board in a chain of overlaps.
    Rig(solve::RigArgs),
    /// Be led through a calibration in a browser.
    Session(session::Args),
}

/// Runs `netcord calib`.
pub fn run(args: &Args) -> CommandResult {
    match &args.action {
        Action::Board(args) => board::run(args),
        Action::Mono(args) => solve::mono(args),
        Action::Stereo(args) => solve::stereo(args),
        Action::Rig(args) => solve::rig(args),
        Action::Session(args) => session::run(args),
    }
}
