//! `netcord record`: everything of a running rig into an MCAP file.

mod gather;
mod store;

use std::{fs, path::PathBuf, time::Duration};

use netcord_capture::synthetic::truth_domain;
use netcord_common::{
    bus::{Bus, DomainRemains},
    realtime,
};
use nix::sys::signal::{SigHandler, Signal, signal};

use self::{gather::Gather, store::Store};
use super::RigArgs;
use crate::{
    exit::{CommandResult, Outcome},
    output::refuse_existing,
    stage,
};

/// Records a running rig: raw frames with their headers, calibration, detections, positions, trajectories, and
/// the scene for viewers. Attaches and detaches at any time, and never makes the pipeline wait: what the disk
/// does not take is lost, counted and reported. Runs only while a processor has nothing else to do. Exit code 1 when something was lost.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The file to be written.
    out: PathBuf,

    #[command(flatten)]
    rig: RigArgs,

    /// End after so many seconds; default: on SIGINT or SIGTERM.
    #[arg(long, value_name = "N", value_parser = super::seconds, allow_negative_numbers = true)]
    seconds: Option<f64>,

    /// Leave the frames out: only results, a few kilobytes a trigger.
    #[arg(long)]
    no_images: bool,

    /// Record the truth of a synthetic source too, from its domain <domain>-truth; done without this where
    /// that domain is there when recording begins.
    #[arg(long)]
    truth: bool,

    /// Replace OUT.mcap if it is there.
    #[arg(long)]
    overwrite: bool,
}

/// Runs `netcord record`.
pub fn run(args: &Args) -> CommandResult {
    refuse_existing(&args.out, args.overwrite)?;
    // At a file size limit the system would end this process; ignored, the write fails like any other.
    // SAFETY: ignoring a signal installs no handler that could run code.
    unsafe { signal(Signal::SIGXFSZ, SigHandler::SigIgn) }?;
    let mut outcome = Outcome::Good;
    stage::run("record", &args.rig, |stage| {
        if let Err(e) = realtime::give_way() {
            tracing::debug!("recording runs at ordinary priority: {e}");
        }
        let truth_domain = truth_domain(stage.bus.domain())?;
        let wanted = args.truth || !DomainRemains::of(&truth_domain).inhabitants()?.is_empty();
        let truth = wanted.then(|| Bus::join(&truth_domain, "record")).transpose()?;
        // The stage has just read it; should it be gone since, the recording is whole without.
        let rig_text = fs::read_to_string(&args.rig.rig).unwrap_or_default();
        let store = Store::begin(&args.out, &stage.rig, &rig_text, !args.no_images, wanted)?;
        let mut gather = Gather::attach(stage, truth.as_ref(), !args.no_images)?;
        let ended = gather.run(stage, &store, args.seconds.map(Duration::from_secs_f64));
        let stored = store.finish()?;
        ended?;
        outcome = gather.report(&args.out, &stored);
        Ok::<_, Box<dyn std::error::Error>>(())
    })?;
    Ok(outcome)
}
