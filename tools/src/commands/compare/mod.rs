//! `netcord compare`: the triangulation methods side by side, or the segmenter on raw and converted frames.

mod input;
mod plots;
mod points;

use std::path::{Path, PathBuf};

use netcord_common::{rig::Rig, wire::WorldFrame};
use netcord_detect::triangulate::comparison::{self, Accuracy, PLACES, Setting};
use rayon::prelude::*;
use serde::Serialize;

use crate::{
    exit::{CommandResult, Outcome},
    output,
};

/// Compare the triangulation methods: precision over noise, calibration error, number of cameras and place
/// over the table, and time per point; or triangulate given points with each method; or compare what the
/// segmenter makes of raw, demosaiced and half-resolution frames.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig [default: the example rigs with 2, 4 and 8 cameras].
    #[arg(long, env = "NETCORD_RIG", value_name = "RIG.toml")]
    rig: Option<PathBuf>,

    /// Write every figure to this file, and the plot beside it.
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,

    /// Where to draw the plot, PNG or SVG [default: beside the report, or compare.png].
    #[arg(long, value_name = "FILE.png")]
    plot: Option<PathBuf>,

    /// Compare recall, error of the centre and time for raw, demosaiced (bilinear and edge-aware) and
    /// half-resolution frames of the synthetic scenes instead, each frame searched as a whole.
    #[arg(long, conflicts_with_all = ["points", "trials"])]
    input: bool,

    /// Frames of each camera and scene, with --input.
    #[arg(long, default_value_t = 300, requires = "input", value_name = "N",
          value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,

    /// Trials for each cell.
    #[arg(long, default_value_t = 500, value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    trials: usize,

    /// Seed of the random numbers.
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Triangulate these observations instead: header id,camera,x_px,y_px, raw pixels. They are points
    /// and not balls, and all of equal weight.
    #[arg(long, value_name = "FILE.csv", requires = "rig", requires = "out")]
    points: Option<PathBuf>,

    /// Folder for one <method>.csv each (id,x,y,z in metres, in the rig's world frame).
    #[arg(long, value_name = "DIR", requires = "points")]
    out: Option<PathBuf>,
}

/// Noise of the observations, px.
const NOISES_PX: [f64; 5] = [0.1, 0.2, 0.5, 1.0, 2.0];

/// Errors of the calibration, px.
const CALIBRATIONS_PX: [f64; 4] = [0.0, 0.2, 0.5, 1.0];

/// Draws of the calibration in each cell that has an error of it.
const CALIBRATION_DRAWS: usize = 25;

/// The plot's name where there is no report that it could be called after.
const PLOT: &str = "compare.png";

/// One cell of the comparison.
#[derive(Debug, Serialize)]
struct Cell {
    method: &'static str,
    cameras: usize,
    noise_px: f64,
    calibration_px: f64,
    place: &'static str,
    place_m: [f64; 3],
    rms_mm: Option<f64>,
    bias_mm: Option<f64>,
    p95_mm: Option<f64>,
    /// Trials that gave a point; where it is none, the place is not in view of two cameras.
    found: usize,
    trials: usize,
}

/// A method's time.
#[derive(Debug, Serialize)]
struct Timing {
    method: &'static str,
    cameras: usize,
    us_per_point: f64,
}

/// All places of one setting taken together.
#[derive(Debug, Clone, Serialize)]
struct Row {
    method: &'static str,
    cameras: usize,
    noise_px: f64,
    calibration_px: f64,
    rms_mm: Option<f64>,
    bias_mm: Option<f64>,
    p95_mm: Option<f64>,
    found: f64,
}

impl Row {
    fn text(&self) -> String {
        let (Some(rms), Some(bias), Some(p95)) = (self.rms_mm, self.bias_mm, self.p95_mm) else {
            return "-".into();
        };
        let missed = if self.found < 0.9995 { "*" } else { "" };
        format!("{rms:.2} / {bias:.2} / {p95:.2}{missed}")
    }
}

#[derive(Debug, Serialize)]
struct Report {
    rigs: Vec<String>,
    summary: Vec<Row>,
    time: Vec<Timing>,
    cells: Vec<Cell>,
}

/// Runs `netcord compare`.
pub fn run(args: &Args) -> CommandResult {
    if let (Some(points), Some(out), Some(rig)) = (&args.points, &args.out, &args.rig) {
        return points::triangulate(&Rig::load(rig)?, points, out);
    }
    let rigs = rigs(args.rig.as_deref())?;
    let plot = match (&args.plot, &args.report) {
        (Some(plot), _) => plot.clone(),
        (None, Some(report)) => output::beside(report, ".png")?.unwrap_or_else(|| PLOT.into()),
        (None, None) => PLOT.into(),
    };
    output::check(&args.rig, std::iter::once(&plot).chain(&args.report))?;
    if args.input {
        let rows = input::measure(&rigs[0], args.seed, args.frames)?;
        input::print(&rows);
        input::draw(&plot, &rows)?;
        println!("\nplot: {}", plot.display());
        return write_report(args.report.as_deref(), &rows);
    }
    if let Some(rig) = rigs.iter().find(|rig| rig.world != WorldFrame::Table) {
        return Err(
            format!("the rig {} has no [table]; methods are compared at places over it", rig.name).into()
        );
    }
    let report = measure(&rigs, args);
    print_tables(&report);
    plots::draw(&plot, &report)?;
    println!("\nplot: {}", plot.display());
    write_report(args.report.as_deref(), &report)
}

fn write_report(path: Option<&Path>, report: &impl Serialize) -> CommandResult {
    if let Some(path) = path {
        let text = serde_json::to_string_pretty(report)?;
        output::write(path, text)?;
        println!("report: {}", path.display());
    }
    Ok(Outcome::Good)
}

/// The rig with its first 2, 3, 4, 8 and all cameras; or the example rigs.
fn rigs(path: Option<&Path>) -> Result<Vec<Rig>, Box<dyn std::error::Error>> {
    let Some(path) = path else {
        return Ok([
            include_str!("../../../../common/rigs/example-2cam.toml"),
            include_str!("../../../../common/rigs/example-4cam.toml"),
            include_str!("../../../../common/rigs/example-8cam.toml"),
        ]
        .into_iter()
        .map(|text| Rig::parse(text, Path::new("example")))
        .collect::<Result<_, _>>()?);
    };
    let whole = Rig::load(path)?;
    let all = whole.cameras.len();
    if all < 2 {
        return Err(format!("{} has one camera; depth needs two", path.display()).into());
    }
    let counts = [2, 3, 4, 8].into_iter().filter(|n| *n < all).chain([all]);
    Ok(counts
        .map(|n| {
            let mut rig = whole.clone();
            rig.cameras.truncate(n);
            rig
        })
        .collect())
}

fn measure(rigs: &[Rig], args: &Args) -> Report {
    let mut settings = Vec::new();
    for rig in rigs {
        for (_, method) in comparison::methods_for(rig.cameras.len()) {
            for noise_px in NOISES_PX {
                for calibration_px in CALIBRATIONS_PX {
                    settings.push((rig, method, noise_px, calibration_px));
                }
            }
        }
    }
    let rows: Vec<(Row, Vec<Cell>)> = settings
        .par_iter()
        .map(|&(rig, method, noise_px, calibration_px)| {
            let calibrations = if calibration_px > 0.0 { CALIBRATION_DRAWS } else { 1 };
            let setting =
                Setting { noise_px, calibration_px, calibrations, draws: args.trials.div_ceil(calibrations) };
            let cells: Vec<_> = PLACES
                .iter()
                .enumerate()
                .map(|(i, place)| {
                    // The same draws for each method: they are compared on the same observations.
                    let seed = args.seed + i as u64;
                    let a = comparison::accuracy(rig, method, &place.at, &setting, seed);
                    cell(method.code().name(), rig.cameras.len(), &setting, i, a)
                })
                .collect();
            (summed(&cells), cells)
        })
        .collect();
    let mut time = Vec::new();
    for rig in rigs {
        for (code, method) in comparison::methods_for(rig.cameras.len()) {
            let seconds = comparison::seconds_per_point(rig, method, args.seed);
            time.extend(seconds.map(|seconds| Timing {
                method: code.name(),
                cameras: rig.cameras.len(),
                us_per_point: 1e6 * seconds,
            }));
        }
    }
    let (summary, cells): (Vec<_>, Vec<_>) = rows.into_iter().unzip();
    let rigs = rigs.iter().map(|r| format!("{}, {} cameras", r.name, r.cameras.len())).collect();
    Report { rigs, summary, time, cells: cells.into_iter().flatten().collect() }
}

fn cell(method: &'static str, cameras: usize, setting: &Setting, place: usize, a: Option<Accuracy>) -> Cell {
    Cell {
        method,
        cameras,
        noise_px: setting.noise_px,
        calibration_px: setting.calibration_px,
        place: PLACES[place].name,
        place_m: PLACES[place].at.coords.into(),
        rms_mm: a.map(|a| 1e3 * a.rms_m),
        bias_mm: a.map(|a| 1e3 * a.bias_m),
        p95_mm: a.map(|a| 1e3 * a.p95_m),
        found: a.map_or(0, |a| a.found),
        trials: setting.calibrations * setting.draws,
    }
}

/// Root mean squares over the places that are in view.
fn summed(cells: &[Cell]) -> Row {
    let seen: usize = cells.iter().map(|c| c.found).sum();
    let mean = |of: fn(&Cell) -> Option<f64>| {
        let squares: f64 = cells.iter().filter_map(|c| Some(of(c)?.powi(2) * c.found as f64)).sum();
        (seen > 0).then(|| (squares / seen as f64).sqrt())
    };
    let first = &cells[0];
    let in_view: usize = cells.iter().filter(|c| c.found > 0).map(|c| c.trials).sum();
    Row {
        method: first.method,
        cameras: first.cameras,
        noise_px: first.noise_px,
        calibration_px: first.calibration_px,
        rms_mm: mean(|c| c.rms_mm),
        bias_mm: mean(|c| c.bias_mm),
        p95_mm: mean(|c| c.p95_mm),
        found: seen as f64 / in_view.max(1) as f64,
    }
}

fn camera_counts(report: &Report) -> Vec<usize> {
    let mut counts: Vec<_> = report.summary.iter().map(|r| r.cameras).collect();
    counts.dedup();
    counts
}

fn print_tables(report: &Report) {
    println!("Error over all places, mm: RMS / bias / 95 % stay below");
    for cameras in camera_counts(report) {
        println!("\n{cameras} cameras");
        print!("{:<26}", "noise, calibration (px)");
        let methods: Vec<_> = comparison::methods_for(cameras).map(|(code, _)| code.name()).collect();
        methods.iter().for_each(|m| print!(" {m:>19}"));
        println!();
        for noise in NOISES_PX {
            for calibration in CALIBRATIONS_PX {
                print!("{:<26}", format!("{noise:.1}, {calibration:.1}"));
                for m in &methods {
                    let row = report.summary.iter().find(|r| {
                        r.method == *m
                            && r.cameras == cameras
                            && r.noise_px == noise
                            && r.calibration_px == calibration
                    });
                    print!(" {:>19}", row.map_or_else(String::new, Row::text));
                }
                println!();
            }
        }
        print!("{:<26}", "time per point, µs");
        for m in &methods {
            let time = report.time.iter().find(|t| t.method == *m && t.cameras == cameras);
            print!(" {:>19}", time.map_or_else(|| "-".into(), |t| format!("{:.2}", t.us_per_point)));
        }
        println!();
    }
    println!("\n* not every trial gave a point. Methods for two views stand only where there are two.");
}
