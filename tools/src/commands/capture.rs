//! `netcord capture`: frames from a source into shared memory, checked and counted.

use std::{path::PathBuf, sync::Arc, time::Duration};

use netcord_capture::{
    FrameSource,
    recording::Footage,
    replay::{Pace, ReplayOptions, ReplaySource},
    synthetic::{
        Fault, SyntheticOptions, SyntheticSource,
        scene::{Preset, SceneOptions},
    },
    usb::{UsbOptions, UsbSource},
};
use netcord_common::Counters;

use super::RigArgs;
use crate::{exit::CommandResult, stage};

/// Publishes the frames of all cameras on camera/<name>/frame and the verdict on each trigger on rig/frameset,
/// from a synthetic scene or a recording. The scene's truth travels in a domain of its own, <domain>-truth.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,

    /// Where frames come from.
    #[arg(long, value_enum, default_value_t = SourceKind::Synthetic)]
    source: SourceKind,

    /// Frames in flight of each camera on USB, 1 to 7.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=7))]
    depth: usize,

    /// Processors of the thread that handles USB events, apart from the others of this process; may be repeated.
    #[arg(long, value_name = "CPU")]
    event_cpu: Vec<usize>,

    /// SCHED_FIFO priority of that thread, 1 to 99.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(i32).range(1..=99))]
    event_priority: Option<i32>,

    /// The recording to be replayed, with --source replay: MCAP with foxglove.RawImage on /camera/<name>/image.
    #[arg(long, value_name = "IN.mcap", required_if_eq("source", "replay"))]
    recording: Option<PathBuf>,

    /// How fast a recording is replayed: recorded, a factor such as 0.5 or 4, or readers (as fast as the segmenter takes
    /// the frames).
    #[arg(long, value_name = "PACE", default_value = "recorded")]
    pace: Pace,

    /// Begin the recording again at its end.
    #[arg(long = "loop")]
    repeat: bool,

    #[command(flatten)]
    scene: SceneArgs,

    /// Exposures a second, in place of the rig file's.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,

    /// Publish N frames rendered beforehand, round and round (400 where N is not given): for rates at which rendering would be what is
    /// measured.
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "400", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    prerendered: Option<usize>,

    /// Time from the end of an exposure until its frame is complete, in microseconds: what a camera's link takes.
    #[arg(long, value_name = "US", default_value_t = 0)]
    transfer_us: u64,

    /// End after so many frames of each camera.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,

    /// Let something go wrong: KIND[,camera=NAME][,every=N|,p=SHARE][,us=MICROSECONDS][,share=SHARE], with KIND one of
    /// drop, delay, duplicate, reorder, desync (exposed µs after the others), truncate (to a share of its bytes);
    /// may be repeated.
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<Fault>,
}

/// Kinds of sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum SourceKind {
    /// A rendered scene.
    Synthetic,
    /// The rig's USB3 Vision cameras, by the serial numbers of its file.
    Usb,
    /// A recording, given with --recording.
    Replay,
}

/// What a synthetic scene shows.
#[derive(Debug, Clone, clap::Args)]
pub struct SceneArgs {
    /// How hard it is: clean, normal, or hard (dim and changing light, a white ball among white things, 30 m/s, 6 ms
    /// of exposure).
    #[arg(long, value_name = "PRESET", default_value = "normal")]
    scene: Preset,

    /// The same seed gives the same frames.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,

    /// Recorded flights in place of simulated rallies: a CSV file t,x,y,z (s, m, table frame) or a folder of them.
    #[arg(long, value_name = "CSV")]
    flights: Option<PathBuf>,

    /// Length of the exposure in microseconds, in place of the scene's or the rig file's.
    #[arg(long, value_name = "US")]
    exposure_us: Option<u64>,

    /// Carry a calibration board through the scene in place of play: as `netcord calib board` takes it, such as
    /// charuco:6x4:DICT_4X4_50:120mm:90mm.
    #[arg(long, value_name = "BOARD", conflicts_with = "flights")]
    board: Option<String>,

    /// The board's way, in place of a tour before all cameras: a CSV file t,x,y,z,rx,ry,rz (s, m, and a rotation
    /// vector in rad; the board's origin in the table frame).
    #[arg(long, value_name = "CSV", requires = "board")]
    board_path: Option<PathBuf>,
}

impl SceneArgs {
    /// The options of the scene.
    pub fn options(&self) -> SceneOptions {
        SceneOptions {
            preset: self.scene,
            seed: self.seed,
            flights: self.flights.clone(),
            exposure_ns: self.exposure_us.map(|us| Duration::from_micros(us).as_nanos() as u64),
            board: self.board.clone(),
            board_path: self.board_path.clone(),
        }
    }
}

/// Runs `netcord capture`.
pub fn run(args: &Args) -> CommandResult {
    if let Some(recording) = args.recording.as_ref().filter(|_| args.source != SourceKind::Replay) {
        let recording = recording.display();
        return Err(format!("--recording {recording} is shown with --source replay only; add it").into());
    }
    // A scene is seen through the cameras as they are; real frames come as they come, calibrated or not.
    let loaded = match args.source {
        SourceKind::Synthetic => args.rig.load()?,
        SourceKind::Usb | SourceKind::Replay => args.rig.load_for_pictures()?,
    };
    stage::run_with("capture", loaded, |stage| {
        let mut source = source(args, &stage.rig, &stage.counters)?;
        netcord_capture::run(&stage.bus, &stage.rig, source.as_mut(), &stage.stop, &stage.counters)?;
        report(&stage.counters);
        Ok::<_, Box<dyn std::error::Error>>(())
    })
}

fn source(
    args: &Args,
    rig: &netcord_common::rig::Rig,
    counters: &Arc<Counters>,
) -> Result<Box<dyn FrameSource>, Box<dyn std::error::Error>> {
    if args.source == SourceKind::Usb {
        let options = UsbOptions {
            depth: args.depth,
            event_cpus: args.event_cpu.clone(),
            event_priority: args.event_priority,
        };
        return Ok(Box::new(UsbSource::new(rig, options, counters)?));
    }
    if let (SourceKind::Replay, Some(recording)) = (args.source, &args.recording) {
        let footage = Arc::new(Footage::open(recording)?);
        let options = ReplayOptions { pace: args.pace, repeat: args.repeat };
        return Ok(Box::new(ReplaySource::new(footage, rig, options)?));
    }
    let options = SyntheticOptions {
        scene: args.scene.options(),
        rate_hz: args.rate,
        prerendered: args.prerendered,
        transfer_ns: args.transfer_us * 1000,
        frames: args.frames,
        faults: args.faults.clone(),
    };
    Ok(Box::new(SyntheticSource::new(rig, options)?))
}

/// Says at the end what became of the frames, losses by reason.
fn report(counters: &Counters) {
    let counts = counters.snapshot();
    let sum =
        |what: &str| counts.iter().filter(|(name, _)| name.ends_with(what)).map(|(_, n)| n).sum::<u64>();
    let (published, lost) = (sum("frames_published"), sum("/frames_lost"));
    if lost == 0 {
        tracing::info!("{published} frames published, none lost");
        return;
    }
    let by_reason = counts.iter().filter(|(name, n)| name.starts_with("lost_") && *n > 0);
    let reasons = by_reason.map(|(name, n)| format!("{name} {n}")).collect::<Vec<_>>().join(", ");
    tracing::warn!("{published} frames published, {lost} lost: {reasons}");
}
