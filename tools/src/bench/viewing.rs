use std::{error::Error, net::TcpListener};

use netcord_common::Shutdown;
use serde::Serialize;

use super::{
    pipeline::{PAIRS, RunPair, RunTimes, growth, interleaved},
    spectator::Spectator,
};
use crate::{
    terminal::LiveLines,
    trial::{self, Setup},
};

/// What a viewer does to the pipeline.
#[derive(Debug, Clone, Serialize)]
pub struct ViewEffect {
    /// Growth of the median, over the runs, of the p50 of frame → position, as a fraction.
    pub p50_growth: Option<f64>,
    /// The same of the p99.
    pub p99_growth: Option<f64>,
    /// Frames that the pipeline lost while it was viewed.
    pub lost: u64,
    /// Least number of messages that a viewer got in a run.
    pub messages: u64,
    /// The pairs, in the order in which they ran.
    pub pairs: Vec<RunPair>,
}

/// Runs interleaved pairs of 10 s at 100 Hz without and with `netcord view` and a viewer that looks at everything.
///
/// # Errors
/// Those of a trial, a run without a position, and a viewer that got nothing.
pub fn measure_view_effect(
    stop: &Shutdown,
    say: &mut dyn FnMut(String),
) -> Result<ViewEffect, Box<dyn Error>> {
    let mut messages = u64::MAX;
    let mut run = |viewed: bool| -> Result<RunTimes, Box<dyn Error>> {
        let port = viewed.then(free_port).transpose()?;
        let spectator = port.map(Spectator::attach);
        let setup = Setup { seconds: 10.0, view: port, ..Setup::default() };
        let trial = trial::run(&setup, stop, &mut LiveLines::new(true));
        let seen = spectator.map(Spectator::leave);
        let report = trial?.report;
        if let Some(seen) = seen {
            if seen == 0 {
                return Err("netcord view sent its viewer nothing".into());
            }
            messages = messages.min(seen);
        }
        let q = report.latency_ms.frame_to_position.ok_or("a run without a position")?;
        Ok(RunTimes { lost: report.frames.lost, not_recorded: 0, p50: q.p50, p99: q.p99 })
    };
    let pairs = interleaved(&mut run, &mut |n| say(format!("effect of viewing: pair {n} of {PAIRS}")))?;
    Ok(ViewEffect {
        p50_growth: growth(&pairs, |run| run.p50),
        p99_growth: growth(&pairs, |run| run.p99),
        lost: pairs.iter().map(|pair| pair.with.lost).sum(),
        messages,
        pairs,
    })
}

/// A port that nobody listens on at this moment.
fn free_port() -> std::io::Result<u16> {
    Ok(TcpListener::bind(("127.0.0.1", 0))?.local_addr()?.port())
}
