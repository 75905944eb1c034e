//! `netcord control`: asks a running capture to change something, or how it is.

use std::time::Duration;

use netcord_common::{
    CameraName,
    bus::{Bus, ControlClient},
    rig::Rig,
    wire::{ALL_CAMERAS, ControlCommand, ControlRequest, ControlStatus},
};

use super::CameraArgs;
use crate::exit::{CommandResult, Outcome};

/// Arguments of `netcord control`.
///
/// What a source can do is its own matter: cameras know all of this, a synthetic scene start, stop, exposure and gain,
/// a recording start and stop. A request that cannot be carried out is an error that says why, with exit code 2.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    of: CameraArgs,

    #[command(subcommand)]
    request: Request,
}

/// What is asked.
#[derive(Debug, Clone, Copy, clap::Subcommand)]
enum Request {
    /// Nothing changes: is it delivering frames, and which trigger was the last?
    Status,
    /// Begin to deliver frames.
    Start,
    /// Stop delivering frames; the process stays.
    Stop,
    /// Expose once, now: cameras whose trigger is `software`.
    Trigger,
    /// Set the exposure.
    Exposure {
        /// Microseconds.
        #[arg(allow_negative_numbers = true, value_parser = super::between(1.0, 1e6, "microseconds"))]
        us: f64,
    },
    /// Set the gain.
    Gain {
        /// Decibels.
        #[arg(allow_negative_numbers = true, value_parser = super::between(-100.0, 100.0, "decibels"))]
        db: f64,
    },
    /// Set the frame rate.
    Rate {
        /// Hertz.
        #[arg(allow_negative_numbers = true, value_parser = super::between(0.001, 100_000.0, "Hz"))]
        hz: f64,
    },
    /// Set the white balance.
    WhiteBalance {
        /// Factor of red against green.
        #[arg(allow_negative_numbers = true, value_parser = super::between(0.001, 1000.0, "times green"))]
        red: f64,
        /// Factor of blue against green.
        #[arg(allow_negative_numbers = true, value_parser = super::between(0.001, 1000.0, "times green"))]
        blue: f64,
    },
    /// Set the region of interest, in pixels.
    Region {
        /// Left edge.
        x: u32,
        /// Top edge.
        y: u32,
        /// Width.
        width: u32,
        /// Height.
        height: u32,
    },
}

impl Request {
    fn message(self, camera: u32) -> ControlRequest {
        use ControlCommand as Command;
        let (command, values) = match self {
            Self::Status => (Command::Status, [0.0; 4]),
            Self::Start => (Command::Start, [0.0; 4]),
            Self::Stop => (Command::Stop, [0.0; 4]),
            Self::Trigger => (Command::Trigger, [0.0; 4]),
            Self::Exposure { us } => (Command::SetExposure, [us * 1e3, 0.0, 0.0, 0.0]),
            Self::Gain { db } => (Command::SetGain, [db, 0.0, 0.0, 0.0]),
            Self::Rate { hz } => (Command::SetRate, [hz, 0.0, 0.0, 0.0]),
            Self::WhiteBalance { red, blue } => (Command::SetWhiteBalance, [red, blue, 0.0, 0.0]),
            Self::Region { x, y, width, height } => {
                (Command::SetRegion, [x, y, width, height].map(f64::from))
            }
        };
        ControlRequest { command: command.code(), camera, values }
    }
}

/// How long capture may take: a camera's registers are written over USB.
const PATIENCE: Duration = Duration::from_secs(3);

/// Runs `netcord control`.
pub fn run(args: &Args) -> CommandResult {
    let (rig, domain) = args.of.rig.load()?;
    let camera = args.of.camera.as_ref().map_or(Ok(ALL_CAMERAS), |name| place(&rig, name))?;
    let bus = Bus::join(&domain, "control")?;
    let answer = ControlClient::open(&bus)?.ask(&args.request.message(camera), PATIENCE)?;
    if answer.status != ControlStatus::Done.code() {
        let status = ControlStatus::from_code(answer.status).map_or("unknown", ControlStatus::name);
        return Err(format!("capture answers {status}: {}", answer.text.as_str()).into());
    }
    let state = if answer.running == 1 { "delivering frames" } else { "stopped" };
    print!("capture is {state}, last trigger {}", answer.trigger_id);
    match args.request {
        Request::Exposure { .. } => print!(", exposure {} µs", answer.values[0] * 1e-3),
        Request::Gain { .. } => print!(", gain {} dB", answer.values[0]),
        _ => {}
    }
    match answer.text.as_str() {
        "" => println!(),
        text => println!(": {text}"),
    }
    Ok(Outcome::Good)
}

fn place(rig: &Rig, name: &CameraName) -> Result<u32, String> {
    rig.cameras.iter().find(|c| c.name == *name).map(|c| c.index.code()).ok_or_else(|| {
        let names: Vec<_> = rig.cameras.iter().map(|c| c.name.as_str()).collect();
        format!("the rig has no camera {name}; it has {}", names.join(", "))
    })
}
