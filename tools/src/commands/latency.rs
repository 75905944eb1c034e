//! `netcord latency`: attaches to a running rig and shows latencies, rates and losses.

use std::{
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use netcord_common::{Shutdown, bus::Bus};
use serde_json::json;

use super::RigArgs;
use crate::{
    exit::{CommandResult, Outcome},
    observer::{Observer, Tally},
    output,
    terminal::LiveLines,
};

/// Arguments of `netcord latency`.
///
/// Exit codes: 0 measured; 1 nothing was published while it looked; 2 an error.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,

    /// How long to measure; default: until SIGINT or SIGTERM.
    #[arg(long, value_name = "N", value_parser = super::seconds, allow_negative_numbers = true)]
    seconds: Option<f64>,

    /// Write the result here as JSON.
    #[arg(long, value_name = "R.json", value_parser = super::file_to_write)]
    report: Option<PathBuf>,
}

/// How often the live table is drawn.
const DRAW: Duration = Duration::from_millis(500);

/// Runs `netcord latency`.
pub fn run(args: &Args) -> CommandResult {
    let (rig, domain) = args.rig.load()?;
    output::check([&args.rig.rig], &args.report)?;
    let stop = Shutdown::on_signals()?;
    let bus = Bus::join(&domain, "latency")?;
    let mut observer = Observer::attach(&bus, &rig)?;
    let mut tally = Tally::default();
    let mut live = LiveLines::new(false);
    let (started, mut drawn) = (Instant::now(), Instant::now());
    while !stop.is_requested() && args.seconds.is_none_or(|s| started.elapsed().as_secs_f64() < s) {
        observer.drain(&mut |seen| tally.see(&seen))?;
        if drawn.elapsed() >= DRAW {
            drawn = Instant::now();
            live.draw(&tally.lines());
        }
        thread::sleep(observer.interval());
    }
    live.draw(&[]);
    for line in tally.lines() {
        println!("{line}");
    }
    if let Some(path) = &args.report {
        let report = json!({
            "rig": rig.name.as_str(),
            "domain": domain.as_str(),
            "seconds": started.elapsed().as_secs_f64(),
            "rate_hz": tally.rate_hz(),
            "positions": tally.positions(),
            "without_position": tally.without_position(),
            "latency_ms": tally.latencies(),
            "frames": tally.frames(),
        });
        output::write(path, format!("{report:#}\n"))?;
    }
    Ok(if tally.rate_hz().is_some() { Outcome::Good } else { Outcome::Missed })
}
