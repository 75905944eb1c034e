//! `netcord process`: the stages of the live pipeline over a recording.

mod input;
mod outputs;
mod report;
mod stages;
mod tables;

use std::{path::PathBuf, sync::Arc, time::Instant};

use indicatif::{ProgressBar, ProgressStyle};
use netcord_capture::recording::{Ending, Footage};
use netcord_common::{Shutdown, rig::Rig};

use self::{
    input::Input,
    outputs::{Outputs, Paths, metadata},
    report::Tally,
    stages::Stages,
};
use super::segment::OptionArgs;
use crate::{
    exit::{CommandResult, Outcome},
    output::{Output, Plan},
};

/// Arguments of `netcord process`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The recording: MCAP with foxglove.RawImage on /camera/<name>/image.
    #[arg(value_name = "IN.mcap")]
    recording: PathBuf,

    /// The rig file; default: cameras, calibration and poses come from the recording itself.
    #[arg(long, env = "NETCORD_RIG", value_name = "RIG.toml")]
    rig: Option<PathBuf>,

    /// Results as a recording, with the images, for replay and viewers.
    #[arg(long, value_name = "OUT.mcap")]
    out: Option<PathBuf>,

    /// Leave the images out of OUT.mcap.
    #[arg(long, requires = "out")]
    no_images: bool,

    /// Positions as CSV: t_ns,x,y,z,sigma_x,sigma_y,sigma_z,residual_px,views,method.
    #[arg(long, value_name = "P.csv")]
    positions: Option<PathBuf>,

    /// Detections as CSV: t_ns,camera,u,v,x0,y0,x1,y1,score.
    #[arg(long, value_name = "D.csv")]
    detections: Option<PathBuf>,

    /// Predictions as CSV: t_ns_made,t_ns_for,x,y,z; from every position, 20 ms apart, to 0.6 s ahead.
    #[arg(long, value_name = "Q.csv")]
    predictions: Option<PathBuf>,

    /// Counts, computing times, and recall and errors where the recording has /truth/ball, as JSON.
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,

    /// Let the background learn from the first N triggers, then start over.
    #[arg(long, value_name = "N", default_value_t = 0)]
    warm_up: usize,

    #[command(flatten)]
    look_for: OptionArgs,

    /// Largest difference between the exposures of one trigger, such as 500us or 2ms (a bare number is in
    /// microseconds); default: the rig file's, else half a frame interval.
    #[arg(long, value_name = "TIME", value_parser = tolerance)]
    tolerance: Option<u64>,

    /// Threads that work at the same time; default: one for each processor. The results are the same.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

/// Runs `netcord process`.
pub fn run(args: &Args) -> CommandResult {
    if let Some(threads) = args.threads {
        rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build_global()?;
    }
    let stop = Shutdown::on_signals()?;
    let (paths, report_output) = args.outputs()?;
    let footage = Arc::new(Footage::open(&args.recording)?);
    let rig = args.rig(&footage)?;
    let input = Input::new(&footage, &rig);
    let mut stages = Stages::new(&rig, &args.look_for.options())?;
    if args.warm_up > 0 {
        let progress = bar(args.warm_up.min(input.triggers()), "warming up");
        for exposure in input.exposures(args.warm_up) {
            if stop.is_requested() {
                return Err("stopped before the end; nothing was written".into());
            }
            stages.warm_up(&exposure?)?;
            progress.inc(1);
        }
        progress.finish_and_clear();
    }
    let about = metadata(&rig, &footage.metadata, "netcord process");
    let mut outputs = Outputs::create(paths, &rig, &about, footage.truth.clone())?;
    let mut tally = Tally::new(&rig, &footage, input.interval_ns());
    let progress = bar(input.triggers(), "processing");
    let began = Instant::now();
    for exposure in input.exposures(usize::MAX) {
        if stop.is_requested() {
            return Err("stopped before the end; nothing was written".into());
        }
        let exposure = exposure?;
        let results = stages.step(&exposure)?;
        tally.see(&exposure, &results);
        outputs.write(exposure, results)?;
        progress.inc(1);
    }
    outputs.finish()?;
    progress.finish_and_clear();
    let seconds = began.elapsed().as_secs_f64();
    let report = tally.report();
    if let Some(output) = report_output {
        output.write(serde_json::to_string_pretty(&report)? + "\n")?;
    }
    report.print();
    println!("{:.1} s, {:.0} triggers a second", seconds, input.triggers() as f64 / seconds);
    Ok(warn_of_what_is_missing(&args.recording, &footage, report.missing_inside))
}

/// Says what the recording lacks, though what there is has been processed.
fn warn_of_what_is_missing(path: &std::path::Path, footage: &Footage, missing: u64) -> Outcome {
    let mut outcome = Outcome::Good;
    if missing > 0 {
        tracing::warn!("{missing} images are missing of triggers that other cameras recorded");
        outcome = Outcome::Missed;
    }
    for camera in footage.cameras.iter().filter(|c| c.duplicates > 0) {
        tracing::warn!(
            "camera {}: {} images have the time stamp of another and were left out",
            camera.name,
            camera.duplicates
        );
        outcome = Outcome::Missed;
    }
    match &footage.ending {
        Ending::Whole => outcome,
        Ending::CutOff { at, why } => {
            tracing::warn!(
                "{} is truncated at byte {at}: {why}. All that stands before was processed",
                path.display()
            );
            Outcome::Missed
        }
    }
}

impl Args {
    /// All outputs, begun: where nothing can be written, nothing is to be computed. The last one is the report's.
    fn outputs(&self) -> Result<(Paths, Option<Output>), Box<dyn std::error::Error>> {
        let files = [&self.out, &self.positions, &self.detections, &self.predictions, &self.report];
        if files.iter().all(|f| f.is_none()) {
            return Err(
                "nothing to write: give at least one of --out, --positions, --detections, --predictions \
                        and --report"
                    .into(),
            );
        }
        let mut plan = Plan::of(std::iter::once(&self.recording).chain(&self.rig));
        let mut begin = |path: &Option<PathBuf>| path.as_deref().map(|path| plan.begin(path)).transpose();
        let paths = Paths {
            recording: begin(&self.out)?,
            positions: begin(&self.positions)?,
            detections: begin(&self.detections)?,
            predictions: begin(&self.predictions)?,
            images: !self.no_images,
        };
        Ok((paths, begin(&self.report)?))
    }

    /// The rig file's rig or the recording's own, with what the command line replaces.
    fn rig(&self, footage: &Footage) -> Result<Rig, Box<dyn std::error::Error>> {
        let mut rig = match &self.rig {
            Some(path) => {
                let mut rig = Rig::load(path)?;
                footage.check_against(&rig)?;
                input::adopt_recording(&mut rig, footage);
                rig
            }
            None => footage.rig()?,
        };
        if let Some(colour) = self.look_for.options().colour {
            rig.ball.colour = colour;
        }
        if let Some(tolerance_ns) = self.tolerance {
            rig.tolerance_ns = tolerance_ns;
        }
        Ok(rig)
    }
}

/// A time such as `500us`, `2ms`, `0.01s`, `250000ns`, or a number of microseconds; in ns.
fn tolerance(text: &str) -> Result<u64, String> {
    let units = [("ns", 1.0), ("us", 1e3), ("µs", 1e3), ("ms", 1e6), ("s", 1e9)];
    let (number, factor) = units
        .iter()
        .find_map(|(unit, factor)| text.strip_suffix(unit).map(|number| (number, *factor)))
        .unwrap_or((text, 1e3));
    let valid = number.trim().parse::<f64>().ok().filter(|n| n.is_finite() && *n >= 0.0);
    let ns =
        valid.ok_or_else(|| format!("{text:?} is no time; valid are 500us, 2ms, 0.01s, or microseconds"))?;
    Ok((ns * factor).round() as u64)
}

fn bar(length: usize, what: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} triggers, {per_sec}, {eta} left");
    // Only a template that is wrong fails.
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(length as u64).with_style(style).with_message(what)
}

#[cfg(test)]
mod tests {
    use super::tolerance;

    #[test]
    fn times_may_have_a_unit() {
        for (text, ns) in
            [("500us", 500_000), ("2ms", 2_000_000), ("0.01s", 10_000_000), ("40ns", 40), ("250", 250_000)]
        {
            assert_eq!(tolerance(text), Ok(ns), "{text}");
        }
        assert!(tolerance("soon").is_err() && tolerance("-1ms").is_err());
    }
}
