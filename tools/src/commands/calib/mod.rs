//! `netcord calib`: boards, calibration of cameras and rigs.

mod board;
mod check;
mod input;
mod lines;
mod motion;
mod options;
mod pictures;
mod plots;
mod rigged;
mod save;
mod session;
mod solve;
mod table;
mod tracks;

use clap::Subcommand;

pub use self::save::today;
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
    /// Find the table before the cameras: by marks on it, a board that lies on it, or the ball's bounces.
    Table(table::Args),
    /// Check a calibrated rig by fresh pictures of a board, or a rod of known length.
    Check(check::Args),
    /// Calibrate the poses of cameras from points in motion: a wand, or the ball in flight.
    Motion(motion::Args),
}

/// Runs `netcord calib`.
pub fn run(args: &Args) -> CommandResult {
    match &args.action {
        Action::Board(args) => board::run(args),
        Action::Mono(args) => solve::mono(args),
        Action::Stereo(args) => solve::stereo(args),
        Action::Rig(args) => solve::rig(args),
        Action::Session(args) => session::run(args),
        Action::Table(args) => table::run(args),
        Action::Check(args) => check::run(args),
        Action::Motion(args) => motion::run(args),
    }
}
