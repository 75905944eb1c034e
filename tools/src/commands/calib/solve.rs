//! `netcord calib mono|stereo|rig`.

use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
};

use clap::ValueEnum;
use nalgebra::Vector2;
use netcord_calib::solve::{
    CameraViews, CrossValidation, MonoCalibration, MonoOptions, Report, RigCalibration, RigOptions,
    calibrate_mono, calibrate_rig, coverage, cross_validate,
};
use netcord_common::{camera::CameraModel, rig::RigEdit};

use super::{
    input::{Input, InputArgs},
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
    let Input { cameras, board } = args.input.load(false)?;
    let results = calibrate_each(&cameras, &args.solver)?;
    let report = Report::of_mono(&results);
    for (c, coverage, validation) in &results {
        print_mono(c, *coverage, validation.as_ref());
    }
    let plots = results.iter().zip(&cameras).map(|((c, ..), views)| {
        let fits = c.views.iter().map(|v| (v.name.as_str(), v.residuals.as_slice()));
        plot_of(views, fits, Some(c))
    });
    write(&report, &args.solver, plots)?;
    if let Some(rig) = &args.rig {
        save::intrinsics(rig, &board, results.iter().map(|(c, ..)| c))?;
    }
    Ok(Outcome::Good)
}

/// Runs `netcord calib stereo`.
pub fn stereo(args: &RigArgs) -> CommandResult {
    let input = args.input.load(true)?;
    if input.cameras.len() != 2 {
        let found = input.cameras.len();
        return Err(
            format!("calib stereo needs two cameras, not {found} (calib rig takes any number)").into()
        );
    }
    solve_rig("stereo", &input, args)
}

/// Runs `netcord calib rig`.
pub fn rig(args: &RigArgs) -> CommandResult {
    solve_rig("rig", &args.input.load(true)?, args)
}

fn solve_rig(kind: &'static str, input: &Input, args: &RigArgs) -> CommandResult {
    let cameras = &input.cameras;
    let results = match args.intrinsics {
        Intrinsics::Rig => Vec::new(),
        Intrinsics::Fixed | Intrinsics::Free => calibrate_each(cameras, &args.solver)?,
    };
    let models = match (args.intrinsics, &args.rig) {
        (Intrinsics::Rig, Some(path)) => models_of(path, cameras)?,
        (Intrinsics::Rig, None) => return Err("--intrinsics rig needs the rig file: --rig".into()),
        _ => results.iter().map(|(c, ..)| c.model).collect(),
    };
    let free = if args.intrinsics == Intrinsics::Free { args.solver.free() } else { [false; 9] };
    let rig = calibrate_rig(cameras, &models, &RigOptions { free, loss: args.solver.loss.0 })?;
    let covered: Vec<f64> = cameras
        .iter()
        .map(|c| coverage(c.size, c.views.iter().flat_map(|v| v.image.iter().copied())))
        .collect();
    print_rig(&rig);
    let plots = cameras.iter().enumerate().map(|(i, views)| {
        let fits = rig.views.iter().filter(move |v| v.camera == i);
        plot_of(views, fits.map(|v| (v.view.as_str(), v.residuals.as_slice())), None)
    });
    write(&Report::of_rig(kind, &rig, &covered), &args.solver, plots)?;
    if let Some(path) = &args.rig {
        if !results.is_empty() {
            save::intrinsics(path, &input.board, results.iter().map(|(c, ..)| c))?;
        }
        save::rig(path, &input.board, &rig)?;
    }
    Ok(if rig.rejected.is_empty() { Outcome::Good } else { Outcome::Missed })
}

/// Intrinsics of the cameras as the rig file has them.
fn models_of(path: &Path, cameras: &[CameraViews]) -> Result<Vec<CameraModel>, Box<dyn Error>> {
    let edit = RigEdit::open(path)?;
    cameras
        .iter()
        .map(|c| {
            let model = edit.intrinsics(&c.name).ok_or_else(|| {
                format!(
                    "{} has no intrinsics of a camera {:?}: run `netcord calib mono` first",
                    path.display(),
                    c.name
                )
            })?;
            if (model.width, model.height) != c.size {
                return Err(format!(
                    "camera {}: the pictures are {} × {} px, its intrinsics in {} are for {} × {}",
                    c.name,
                    c.size.0,
                    c.size.1,
                    path.display(),
                    model.width,
                    model.height
                )
                .into());
            }
            Ok(model)
        })
        .collect()
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

type Calibrated = (MonoCalibration, f64, Option<CrossValidation>);

fn calibrate_each(cameras: &[CameraViews], solver: &SolverArgs) -> Result<Vec<Calibrated>, Box<dyn Error>> {
    /// Parts of the cross-validation: a fifth of the views left out each time.
    const FOLDS: usize = 5;
    let options =
        MonoOptions { free: solver.free(), tie_aspect: solver.tie_aspect, start: None, loss: solver.loss.0 };
    cameras
        .iter()
        .map(|camera| {
            let found = calibrate_mono(camera, &options)?;
            let covered = coverage(camera.size, camera.views.iter().flat_map(|v| v.image.iter().copied()));
            // With few views, those left without a part may not do; then there is no such figure.
            let validation = cross_validate(camera, &options, &found, FOLDS).ok();
            Ok((found, covered, validation))
        })
        .collect()
}

fn print_mono(c: &MonoCalibration, coverage: f64, validation: Option<&CrossValidation>) {
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
        fs::write(path, text).map_err(|e| format!("cannot write the report {}: {e}", path.display()))?;
        for file in plots::write(path, &plots.collect::<Vec<_>>())? {
            println!("{}", file.display());
        }
    }
    Ok(())
}
