//! `netcord demo`: the whole pipeline on a synthetic rally, checked against the truth.

use std::path::{Path, PathBuf};

use netcord_common::Shutdown;

use crate::{
    exit::{CommandResult, Outcome},
    output::{self, refuse_existing},
    terminal::LiveLines,
    trial::{self, Scene, Setup},
};

/// Arguments of `netcord demo`.
///
/// Starts capture (a synthetic scene), segment, triangulate and predict as processes of their own, in a fresh
/// domain of which nothing stays, shows the ball live, and holds what they found against the truth. Exit codes:
/// 0 tracking and time budget hold; 1 something was missed (the report is written all the same); 2 an error.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Seconds that are judged, after the warm-up.
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 20.0,
          value_parser = super::between(0.1, super::LONGEST_S, "seconds"))]
    seconds: f64,

    /// Exposures a second.
    #[arg(long, value_name = "HZ", default_value_t = 100.0, allow_negative_numbers = true,
          value_parser = super::between(1.0, 10_000.0, "Hz"))]
    rate: f64,

    /// Cameras, 2 to 8.
    #[arg(long, value_name = "N", default_value_t = 2)]
    cameras: usize,

    /// Seed of the scene and the rally: the same seed gives the same frames.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,

    /// How hard the scene makes it.
    #[arg(long, value_enum, default_value_t = Scene::Normal)]
    scene: Scene,

    /// Seconds before the judged ones, in which the segmenter learns the background.
    #[arg(long, value_name = "N", value_parser = super::seconds, allow_negative_numbers = true, default_value_t = 2.0)]
    warm_up: f64,

    /// Publish N frames that are rendered beforehand, round and round, for rates at which the renderer would be
    /// the limit.
    #[arg(long, value_name = "N")]
    prerendered: Option<usize>,

    /// Attach `netcord record` and keep the recording in this file.
    #[arg(long, value_name = "OUT.mcap")]
    record: Option<PathBuf>,

    /// One more argument for `netcord capture`, such as a fault switch; may be repeated.
    #[arg(long = "capture-arg", value_name = "ARG", allow_hyphen_values = true)]
    capture_args: Vec<String>,

    /// Write the result here as JSON, and plots beside it as PNG.
    #[arg(long, value_name = "R.json", value_parser = super::file_to_write)]
    report: Option<PathBuf>,

    /// No live view.
    #[arg(long)]
    quiet: bool,
}

/// Runs `netcord demo`.
pub fn run(args: &Args) -> CommandResult {
    if let Some(path) = &args.record {
        refuse_existing(path, false)?;
    }
    let plots = args.report.as_deref().map(trial::plot_paths).transpose()?.flatten();
    let written = [&args.record, &args.report].into_iter().flatten();
    output::check(None::<&Path>, written.chain(plots.iter().flatten()))?;
    let setup = Setup {
        cameras: args.cameras,
        rate_hz: args.rate,
        seconds: args.seconds,
        warm_up_s: args.warm_up,
        seed: args.seed,
        scene: args.scene,
        prerendered: args.prerendered,
        capture_args: args.capture_args.clone(),
        record: args.record.clone(),
        view: None,
    };
    let stop = Shutdown::on_signals()?;
    let trial = trial::run(&setup, &stop, &mut LiveLines::new(args.quiet))?;
    let report = &trial.report;
    println!(
        "{} cameras, {} Hz, {} s, scene {}, seed {}",
        args.cameras,
        args.rate,
        args.seconds,
        args.scene.name(),
        args.seed
    );
    for line in report.lines() {
        println!("{line}");
    }
    if let Some(path) = &args.report {
        let text = serde_json::to_string_pretty(report)?;
        output::write(path, text + "\n")?;
    }
    if let Some(plots) = &plots {
        trial.write_plots(plots)?;
        for plot in plots {
            println!("  plot: {}", plot.display());
        }
    }
    if report.missed.is_empty() {
        println!("  verdict: tracking and time budget hold");
        return Ok(Outcome::Good);
    }
    for missed in &report.missed {
        println!("  missed: {missed}");
    }
    Ok(Outcome::Missed)
}
