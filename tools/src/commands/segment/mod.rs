//! `netcord segment`: from frames to candidates for the ball, live.

mod learn;

use std::time::Duration;

use netcord_common::rig::BallColour;
use netcord_detect::segment::{
    InputMode, SegmentOptions,
    live::{self, LiveOptions},
};

use super::CameraArgs;
use crate::{exit::CommandResult, stage};

/// Searches the frames of all cameras, a thread each (or of one camera, a process each), for what may be the
/// ball, and publishes up to 16 candidates a frame on camera/<name>/detections. With --learn: learns the ball's colour.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    of: CameraArgs,

    /// How long before a frame is due to stop sleeping and watch for it, in microseconds: saves the 0.1–0.2 ms
    /// that a core takes to wake up, and costs as much of the core.
    #[arg(long, value_name = "US", default_value_t = 0)]
    spin_us: u64,

    #[command(flatten)]
    options: OptionArgs,

    #[command(flatten)]
    learn: learn::LearnArgs,
}

/// What to look for: shared with `netcord process`.
#[derive(Debug, Clone, clap::Args)]
pub struct OptionArgs {
    /// The ball's colour, in place of the rig file's, what was learnt included: orange, white or auto (both are
    /// tried).
    #[arg(long, value_name = "COLOUR")]
    ball: Option<BallColour>,

    /// What to search: raw (the mosaic), bilinear or edge-aware (interpolated first), or half (half resolution).
    #[arg(long, value_name = "INPUT", default_value = "raw")]
    input: InputMode,

    /// Take each frame for itself, by colour and shape alone: for pictures in no order.
    #[arg(long)]
    single_frames: bool,
}

impl OptionArgs {
    /// The options.
    pub fn options(&self) -> SegmentOptions {
        SegmentOptions { colour: self.ball, input: self.input, single_frames: self.single_frames }
    }
}

/// Runs `netcord segment`.
pub fn run(args: &Args) -> CommandResult {
    if let Some(input) = &args.learn.learn {
        return learn::run(&args.learn, input, &args.of.rig.rig, args.of.camera.as_ref());
    }
    let options = LiveOptions {
        segment: args.options.options(),
        camera: args.of.camera.clone(),
        spin: Duration::from_micros(args.spin_us),
    };
    stage::run("segment", &args.of.rig, |stage| {
        live::run(&stage.bus, &stage.rig, &options, &stage.stop, &stage.counters, || {
            tracing::info!(domain = %stage.bus.domain(), "segment is ready");
        })
    })
}
