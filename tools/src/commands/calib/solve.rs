//! `netcord calib mono|stereo|rig`.

use std::{error::Error, path::PathBuf};

use clap::ValueEnum;
use nalgebra::Vector2;
use netcord_calib::{
    session::{Outcome as Calibrated, Solved, Solver, Task},
    solve::{CameraViews, MonoCalibration, Report, RigCalibration, RigOptions},
};
use netcord_common::{camera::CameraModel, rig::RigEdit};

use super::{
    input::{InputArgs, Wanted},
    options::SolverArgs,
    plots::{self, CameraPlot},
    save,
};
use crate::exit::{CommandResult, Outcome};

/// Arguments of `netcord calib mono`.
#[derive(Debug, clap::Args)]
pub struct MonoArgs {
    #[command(flatten)]
    input: InputArgs,

    /// Write the result into this rig file; cameras go by name.
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,

    #[command(flatten)]
    solver: SolverArgs,
}

/// Whether intrinsics take part in a stereo or rig calibration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Intrinsics {
    /// They stay as each camera's own calibration gave them.
    Fixed,
    /// They are refined together with the poses.
    Free,
    /// They stay as the rig file (--rig) has them.
    Rig,
}

/// Arguments of `netcord calib stereo` and `netcord calib rig`.
#[derive(Debug, clap::Args)]
pub struct RigArgs {
    #[command(flatten)]
    input: InputArgs,

    /// Write the result into this rig file; cameras go by name.
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,

    /// Whether intrinsics are refined together with the poses.
    #[arg(long, value_enum, default_value = "fixed")]
    intrinsics: Intrinsics,

    #[command(flatten)]
    solver: SolverArgs,
}

/// Runs `netcord calib mono`.
pub fn mono(args: &MonoArgs) -> CommandResult {
    let solver = Solver { mono: args.solver.mono(), ..Solver::default() };
    let input = args.input.open()?;
    input.check_outputs(args.rig.as_deref(), args.solver.report.as_deref())?;
    let found = input.solve(Wanted { task: Task::Mono, exactly: None, solver, model: &|_| Ok(None) })?;
    let Calibrated::Mono(results) = found.outcome.as_ref() else { return Err(OTHER_OUTCOME.into()) };
    results.iter().for_each(print_mono);
    let plots = results.iter().filter_map(|solved| {
        let c = &solved.calibration;
        let views = found.cameras.iter().find(|v| v.name == c.name)?;
        let fits = c.views.iter().map(|v| (v.name.as_str(), v.residuals.as_slice()));
        Some(plot_of(views, fits, Some(c)))
    });
    write(&found.outcome.report(), &args.solver, plots)?;
    if let Some(rig) = &args.rig {
        save::intrinsics(rig, &found.board, results.iter().map(|s| &s.calibration))?;
    }
    Ok(Outcome::Good)
}

/// Runs `netcord calib stereo`.
pub fn stereo(args: &RigArgs) -> CommandResult {
    solve_rig(args, Some((2, "calib stereo needs two cameras (calib rig takes any number)")))
}

/// Runs `netcord calib rig`.
pub fn rig(args: &RigArgs) -> CommandResult {
    solve_rig(args, None)
}

/// What a session for one thing would only give by a fault of its own.
const OTHER_OUTCOME: &str = "the session gave the result of another task";

fn solve_rig(args: &RigArgs, exactly: Option<(usize, &'static str)>) -> CommandResult {
    let free = if args.intrinsics == Intrinsics::Free { args.solver.free() } else { [false; 9] };
    let rig = RigOptions { free, loss: args.solver.loss.0 };
    let solver = Solver { mono: args.solver.mono(), rig };
    let edit = match (args.intrinsics, &args.rig) {
        (Intrinsics::Rig, Some(path)) => Some((path, RigEdit::open(path)?)),
        (Intrinsics::Rig, None) => return Err("--intrinsics rig needs the rig file: --rig".into()),
        (Intrinsics::Fixed | Intrinsics::Free, _) => None,
    };
    let model = |name: &str| -> Result<Option<CameraModel>, Box<dyn Error>> {
        let Some((path, edit)) = &edit else { return Ok(None) };
        let model = edit.intrinsics(name).ok_or_else(|| {
            format!(
                "{} has no intrinsics of a camera {name:?}: run `netcord calib mono` first",
                path.display()
            )
        })?;
        Ok(Some(model))
    };
    let input = args.input.open()?;
    input.check_outputs(args.rig.as_deref(), args.solver.report.as_deref())?;
    let found = input.solve(Wanted { task: Task::Rig, exactly, solver, model: &model })?;
    let Calibrated::Rig { solved, rig, .. } = found.outcome.as_ref() else {
        return Err(OTHER_OUTCOME.into());
    };
    print_rig(rig);
    let plots = found.cameras.iter().enumerate().map(|(i, views)| {
        let fits = rig.views.iter().filter(move |v| v.camera == i);
        plot_of(views, fits.map(|v| (v.view.as_str(), v.residuals.as_slice())), None)
    });
    write(&found.outcome.report(), &args.solver, plots)?;
    if let Some(path) = &args.rig {
        if !solved.is_empty() {
            save::intrinsics(path, &found.board, solved.iter().map(|s| &s.calibration))?;
        }
        save::rig(path, &found.board, rig)?;
    }
    Ok(if rig.rejected.is_empty() { Outcome::Good } else { Outcome::Missed })
}

/// What a camera's plot shows; `fits` are the residuals of its views by name.
fn plot_of<'a>(
    camera: &CameraViews,
    fits: impl Iterator<Item = (&'a str, &'a [Vector2<f64>])>,
    mono: Option<&MonoCalibration>,
) -> CameraPlot {
    let (mut corners, mut views) = (Vec::new(), Vec::new());
    for (name, residuals) in fits {
        let Some(view) = camera.views.iter().find(|v| v.name == name) else { continue };
        corners.extend(view.image.iter().copied().zip(residuals.iter().copied()));
        let squares: f64 = residuals.iter().map(Vector2::norm_squared).sum();
        views.push((name.to_owned(), (squares / residuals.len().max(1) as f64).sqrt()));
    }
    let uncertainty = mono.map_or_else(Vec::new, |c| c.uncertainty.grid(16, 10));
    CameraPlot { name: camera.name.clone(), size: camera.size, corners, views, uncertainty }
}

fn print_mono(Solved { calibration: c, coverage, validation }: &Solved) {
    println!(
        "{}: RMS {:.6} px over {} views, noise {:.3} px per coordinate",
        c.name,
        c.rms_px,
        c.views.len(),
        c.noise_px
    );
    for (i, name) in netcord_calib::solve::INTRINSIC_NAMES.iter().enumerate() {
        println!("  {name} {:>14.6} ± {:.6}", c.model.parameters()[i], c.standard_deviations()[i]);
    }
    println!("  corners in {:.0} % of the image", 100.0 * coverage);
    if let Some(v) = validation {
        let advice = if v.more_frames_help { "more frames would help" } else { "more frames would not help" };
        println!("  views left out: {:.4} px RMS; {advice}", v.held_out_rms_px);
    }
    for o in &c.outliers {
        println!("  outlier: view {}, point {}: {:.2} px", o.view, o.point, o.residual_px);
    }
}

fn print_rig(rig: &RigCalibration) {
    println!(
        "RMS {:.6} px per point over all cameras, noise {:.3} px per coordinate",
        rig.rms_px, rig.noise_px
    );
    for c in rig.cameras.iter().skip(1) {
        let (t, r) = (c.camera_from_first.translation, c.camera_from_first.rotation.scaled_axis());
        println!(
            "  {}: T = ({:.6}, {:.6}, {:.6}) m, rotation vector ({:.6}, {:.6}, {:.6}) rad, {:.5} ± {:.5} m from the first",
            c.name,
            t.x,
            t.y,
            t.z,
            r.x,
            r.y,
            r.z,
            t.norm(),
            c.baseline_sd_m()
        );
    }
    for c in &rig.cameras {
        let Some(clock) = &c.clock else { continue };
        let left_out = match c.unmoved {
            0 => String::new(),
            n => format!("; {n} of its views, in which nothing tells how the board moved, are left out"),
        };
        println!(
            "  {}: exposed {:.1} ± {:.1} ms {} than the others' frames of the same stamp: its clock is off, and was made good here{left_out}",
            c.name,
            1e3 * clock.later_s.abs(),
            1e3 * clock.sd_s,
            if clock.later_s > 0.0 { "later" } else { "earlier" },
        );
    }
    for r in &rig.rejected {
        let camera = r.camera.as_deref().unwrap_or("both cameras");
        println!("  rejected: view {} of {camera}: {}", r.view, r.reason());
    }
    for o in &rig.outliers {
        println!("  outlier: view {}, point {}: {:.2} px", o.view, o.point, o.residual_px);
    }
}

/// Writes the report, and the plots beside it.
fn write(
    report: &Report,
    solver: &SolverArgs,
    plots: impl Iterator<Item = CameraPlot>,
) -> Result<(), Box<dyn Error>> {
    if let Some(path) = &solver.report {
        let text = serde_json::to_string_pretty(report)?;
        crate::output::write(path, text)?;
        for file in plots::write(path, &plots.collect::<Vec<_>>())? {
            println!("{}", file.display());
        }
    }
    Ok(())
}
