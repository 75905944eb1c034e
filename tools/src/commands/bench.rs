//! `netcord bench`: kernels, transport and the whole pipeline, measured beside the machine's floors.

use std::path::PathBuf;

use clap::ValueEnum;
use netcord_capture::synthetic::scene::Preset;
use netcord_common::{DomainName, Shutdown};
use netcord_detect::triangulate::{CALIBRATION_SLACK_PX, Robust, comparison::seconds_per_point};
use serde_json::{Map, Value, json};

use crate::{
    bench::{
        FrameRing, measure_kernels, measure_ladder, measure_prediction, measure_record_effect,
        measure_recovery, measure_transport, measure_triangulation, measure_view_effect, serve_reader,
    },
    console,
    exit::{CommandResult, Outcome},
    terminal::LiveLines,
    trial::example_rig,
};

/// Arguments of `netcord bench`.
///
/// Scalars are medians. The floor is one thread summing a frame with the same vector width as the segmenter's
/// kernels, frames taken in turn from a ring of more than 128 MB; reading and segmenting alternate in one loop.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Measure this only; may be repeated.
    #[arg(long, value_enum, value_name = "NAME")]
    only: Vec<Part>,

    /// Write the result here as JSON.
    #[arg(long, value_name = "R.json", value_parser = super::file_to_write)]
    report: Option<PathBuf>,

    /// Where the recordings of the record-effect go: a folder on tmpfs with 6 GB of room.
    #[arg(long, value_name = "FOLDER", default_value = "/dev/shm")]
    record_folder: PathBuf,

    /// The other end of the transport's measurement: started by this command itself.
    #[arg(long, hide = true)]
    transport_reader: Option<DomainName>,
}

/// What can be measured by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Part {
    /// read_frame_us, segment_full_us (until the detections of the whole frame are there), segment_all_us (until
    /// the frame has been learnt from, too), segment_full_over_read, segment_window_us
    Kernels,
    /// triangulate_us.{2,8}: a point by the method `robust`, from raw pixels, the fastest of 30
    /// rounds over 256 points; triangulate_stage_us.{2,8}: all that
    /// the stage does for one position
    Triangulate,
    /// predict_us.{p50,p99}: from a position to its trajectory and the next search windows
    Predict,
    /// transport_us.{100k,1m,4m,16m}
    Transport,
    /// max_rate_hz: the highest rate of a ladder with no loss in 10 s, frames rendered beforehand
    MaxRate,
    /// record_effect: five interleaved pairs of runs with and without recording
    RecordEffect,
    /// view_effect: five interleaved pairs of runs with and without `netcord view` and a viewer of all topics
    ViewEffect,
    /// recovery: from kill -9 of a process until positions flow again
    Recovery,
}

/// Runs `netcord bench`.
pub fn run(args: &Args) -> CommandResult {
    if let Some(domain) = &args.transport_reader {
        serve_reader(domain)?;
        return Ok(Outcome::Good);
    }
    let stop = Shutdown::on_signals()?;
    let mut progress = Progress { live: LiveLines::new(false) };
    let mut report = Map::new();
    let parts = if args.only.is_empty() { Part::value_variants().to_vec() } else { args.only.clone() };
    for part in parts {
        if stop.is_requested() {
            return Err("stopped before the end".into());
        }
        let result = measure(part, args, &stop, &mut progress)?;
        progress.live.draw(&[]);
        for (key, value) in result {
            println!("{key}: {value}");
            report.insert(key.to_owned(), value);
        }
        if args.report.is_none() && !console::is_read() {
            // Whoever read us has seen enough: what follows would be measured for nobody.
            break;
        }
    }
    if let Some(path) = &args.report {
        let text = serde_json::to_string_pretty(&report)?;
        crate::output::write(path, text + "\n")?;
    }
    Ok(Outcome::Good)
}

/// One measurement's keys and values.
fn measure(
    part: Part,
    args: &Args,
    stop: &Shutdown,
    progress: &mut Progress,
) -> Result<Vec<(&'static str, Value)>, Box<dyn std::error::Error>> {
    Ok(match part {
        Part::Kernels => {
            let rig = example_rig(2)?;
            progress.say("rendering frames".into());
            let ring = FrameRing::render(&rig, Preset::Normal, 1)?;
            let times = measure_kernels(&rig, &ring, &mut |share| progress.share("kernels", share))?;
            vec![
                ("read_frame_us", json!(times.read_frame_us)),
                ("segment_full_us", json!(times.segment_full_us)),
                ("segment_all_us", json!(times.segment_all_us)),
                ("segment_full_over_read", json!(times.segment_full_over_read)),
                ("segment_window_us", json!(times.segment_window_us)),
            ]
        }
        Part::Triangulate => {
            let (mut points, mut stages) = (Map::new(), Map::new());
            for cameras in [2, 8] {
                progress.say(format!("triangulation with {cameras} cameras"));
                let rig = example_rig(cameras)?;
                let robust = Robust::with_slack_px(CALIBRATION_SLACK_PX);
                let seconds = seconds_per_point(&rig, &robust, 1);
                points.insert(cameras.to_string(), json!(seconds.map(|seconds| 1e6 * seconds)));
                stages.insert(cameras.to_string(), json!(measure_triangulation(&rig)));
            }
            vec![("triangulate_us", Value::Object(points)), ("triangulate_stage_us", Value::Object(stages))]
        }
        Part::Transport => {
            let times = measure_transport(&mut |share| progress.share("transport", share))?;
            let times = times.into_iter().map(|(size, us)| (size.key.to_owned(), json!(us)));
            vec![("transport_us", Value::Object(times.collect()))]
        }
        Part::MaxRate => {
            let ladder = measure_ladder(stop, &mut |text| progress.say(text))?;
            vec![("max_rate_hz", json!(ladder.max_rate_hz)), ("max_rate_ladder", json!(ladder.rungs))]
        }
        Part::Predict => {
            progress.say("prediction".into());
            vec![("predict_us", json!(measure_prediction(&example_rig(2)?)?))]
        }
        Part::ViewEffect => {
            let effect = measure_view_effect(stop, &mut |text| progress.say(text))?;
            vec![("view_effect", json!(effect))]
        }
        Part::RecordEffect => {
            let effect = measure_record_effect(&args.record_folder, stop, &mut |text| progress.say(text))?;
            vec![("record_effect", json!(effect))]
        }
        Part::Recovery => {
            vec![("recovery", json!(measure_recovery(stop, &mut |text| progress.say(text))?))]
        }
    })
}

/// What is being measured, in the terminal.
struct Progress {
    live: LiveLines,
}

impl Progress {
    fn say(&mut self, text: String) {
        self.live.draw(&[text]);
    }

    fn share(&mut self, what: &str, share: f64) {
        // Drawn for whole percents only, so that drawing disturbs little.
        let percent = share * 100.0;
        if percent.fract() < 0.35 {
            self.live.draw(&[format!("{what}: {percent:.0} %")]);
        }
    }
}
