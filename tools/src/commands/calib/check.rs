//! `netcord calib check`.

use std::{
    error::Error,
    path::{Path, PathBuf},
};

use nalgebra::Vector2;
use netcord_calib::{
    check::{Check, CheckedCorner, Limits, Spread, check_boards, check_rod},
    gather::GatherOptions,
    solve::{CameraViews, MovingPoints, on_time},
};

use super::{
    board,
    motion::{self, PointsArgs},
    pictures::{self, CameraPictures},
    plots,
    rigged::CalibratedRig,
};
use crate::{
    exit::{CommandResult, Outcome},
    output::{self, OutputError},
    plot,
};

/// Checks a calibrated rig: by fresh pictures of a board, by a rod or wand of known length, or by both. Says what to do
/// again; exit code 1 when something is off.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig file.
    rig: PathBuf,

    /// Fresh pictures of a board: NAME=PATH of pictures or folders, files of one name being simultaneous; or a recording.
    #[arg(value_name = "IMAGES", requires = "board")]
    images: Vec<String>,

    /// The board in the pictures, as for `calib board`.
    #[arg(long)]
    board: Option<String>,

    #[command(flatten)]
    points: PointsArgs,

    /// Length of the rod in metres: the distance of the two markers named by --ends.
    #[arg(long, value_name = "M", requires = "tracks")]
    length: Option<f64>,

    /// Largest median error of a corner and of the epipolar lines, px.
    #[arg(long, value_name = "PX", default_value_t = Limits::default().reprojection_px)]
    limit_px: f64,

    /// Largest error of a length, as a share of it.
    #[arg(long, value_name = "SHARE", default_value_t = Limits::default().length)]
    limit_length: f64,

    /// Write the report here, as JSON; plots go beside it.
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
}

/// Runs `netcord calib check`.
pub fn run(args: &Args) -> CommandResult {
    let rig = CalibratedRig::load(&args.rig)?;
    let limits =
        Limits { reprojection_px: args.limit_px, epipolar_px: args.limit_px, length: args.limit_length };
    let images = pictures::unread(&args.images)?;
    check_outputs(args, &rig, &images)?;
    let (mut check, mut corners, mut views) = (Check::default(), Vec::new(), Vec::new());
    if let Some(spec) = &args.board {
        let seen = views_of(&rig, spec, &images)?;
        views = on_time(&seen, &rig.later_s);
        for ((before, after), later_s) in
            seen.iter().zip(&views).zip(&rig.later_s).filter(|(_, s)| **s != 0.0)
        {
            println!(
                "{}: its corners are taken back by the {:+.1} ms of its clock; {} of {} views, in which nothing tells how the \
                 board moved, are left out",
                after.name,
                1e3 * later_s,
                before.views.len() - after.views.len(),
                before.views.len()
            );
        }
        (check, corners) = check_boards(&rig.cameras, &views, &limits);
    }
    if !args.points.tracks.is_empty() {
        let length = args.length.ok_or("a rod's length is needed: --length")?;
        let joined =
            args.points.load(|name| rig.place(name).map(|i| (rig.cameras[i].model, rig.later_s[i])))?;
        let mut points: Vec<MovingPoints> = rig
            .cameras
            .iter()
            .map(|c| MovingPoints {
                name: c.name.clone(),
                model: c.model,
                pixels: vec![None; joined.instants * joined.markers],
                velocities: Vec::new(),
            })
            .collect();
        for seen in joined.cameras {
            let place = rig.place(&seen.name)?;
            points[place] = seen;
        }
        let ends = motion::pairs(joined.instants, joined.markers, args.points.ends(joined.markers)?);
        let rod = check_rod(&rig.cameras, &points, ends, length)
            .ok_or("no instant at which two cameras see both ends of the rod")?;
        check.add_rod(rod, &limits);
    }
    if args.board.is_none() && args.points.tracks.is_empty() {
        return Err("nothing to check the rig by: give pictures with --board, or --track and --length".into());
    }
    print(&check);
    if let Some(path) = &args.report {
        write(path, &rig, &check, &corners, &views)?;
    }
    Ok(if check.redo.is_empty() { Outcome::Good } else { Outcome::Missed })
}

/// The report and its plots go to places of their own, and not over what is read.
fn check_outputs(args: &Args, rig: &CalibratedRig, images: &[CameraPictures]) -> Result<(), OutputError> {
    let Some(report) = &args.report else { return Ok(()) };
    let dictionary = args.board.as_deref().and_then(board::dictionary_file);
    let read = [Some(&args.rig), dictionary.as_ref()].into_iter().flatten().map(PathBuf::as_path);
    let read = read.chain(args.points.files()).chain(pictures::files(images));
    let mut written = vec![report.clone()];
    if !images.is_empty() {
        written.extend(plots::paths(report, rig.cameras.iter().map(|c| c.name.as_str()))?);
    }
    if !args.points.tracks.is_empty() {
        written.extend(rod_plot(report)?);
    }
    output::check(read, &written)
}

/// Where the picture of a rod's errors goes.
fn rod_plot(report: &Path) -> Result<Option<PathBuf>, OutputError> {
    output::beside(report, "-rod.png")
}

fn views_of(
    rig: &CalibratedRig,
    spec: &str,
    images: &[CameraPictures],
) -> Result<Vec<CameraViews>, Box<dyn Error>> {
    let all = GatherOptions { max_iou: 1.0, max_views: usize::MAX, ..GatherOptions::default() };
    let mut views: Vec<CameraViews> = rig
        .cameras
        .iter()
        .map(|c| CameraViews {
            name: c.name.clone(),
            size: (c.model.width, c.model.height),
            views: Vec::new(),
        })
        .collect();
    for found in pictures::find(spec, images, &all)? {
        let place = rig.place(&found.name)?;
        if found.size != views[place].size {
            return Err(format!(
                "camera {}: the pictures are {} × {} px, the rig file says {} × {}",
                found.name, found.size.0, found.size.1, views[place].size.0, views[place].size.1
            )
            .into());
        }
        views[place].views.extend(found.views);
    }
    Ok(views)
}

fn print(check: &Check) {
    let show = |s: &Option<Spread>| {
        s.map_or("      –       –".to_owned(), |s| format!("{:>7.3} {:>7.3}", s.median, s.p95))
    };
    if !check.cameras.is_empty() {
        println!("corners, px (median, 95 %)     by itself          in the rig");
        for c in &check.cameras {
            println!(
                "  {:<14} {:>4} views  {}    {}",
                c.camera,
                c.views,
                show(&c.own_px),
                show(&c.common_px)
            );
        }
    }
    if !check.pairs.is_empty() {
        println!("epipolar distance, px          median    95 %");
        for p in &check.pairs {
            let names = p.cameras.join(" – ");
            println!("  {names:<26} {}    of {} corners", show(&Some(p.epipolar_px)), p.epipolar_px.count);
        }
    }
    if let Some(off) = check.board_scale_error {
        println!("lengths on the board: {:+.3} %", 100.0 * off);
    }
    if let Some(rod) = &check.rod {
        println!(
            "rod of {:.1} mm: median {:.2} mm ({:+.3} %), error {:.2} mm median, {:.2} mm 95 %, {:.2} mm at most, {} instants",
            rod.length_m * 1e3,
            rod.median_m * 1e3,
            100.0 * rod.scale_error,
            rod.error_m.median * 1e3,
            rod.error_m.p95 * 1e3,
            rod.error_m.max * 1e3,
            rod.error_m.count
        );
    }
    if check.redo.is_empty() {
        println!("the calibration holds");
    }
    for advice in &check.redo {
        println!("to do: {advice}");
    }
}

fn write(
    path: &Path,
    rig: &CalibratedRig,
    check: &Check,
    corners: &[CheckedCorner],
    views: &[CameraViews],
) -> Result<(), Box<dyn Error>> {
    output::write(path, serde_json::to_string_pretty(check)?)?;
    let mut written = Vec::new();
    if !corners.is_empty() {
        let cameras: Vec<plots::CameraPlot> = views
            .iter()
            .enumerate()
            .map(|(i, v)| {
                let own: Vec<(Vector2<f64>, Vector2<f64>)> =
                    corners.iter().filter(|c| c.camera == i).map(|c| (c.pixel, c.residual)).collect();
                plots::CameraPlot {
                    name: v.name.clone(),
                    size: v.size,
                    views: per_view(v, &own),
                    corners: own,
                    uncertainty: Vec::new(),
                }
            })
            .filter(|c| !c.corners.is_empty())
            .collect();
        written.extend(plots::write(path, &cameras)?);
    }
    if let (Some(rod), Some(file)) = (&check.rod, rod_plot(path)?) {
        let places: Vec<([f64; 3], f64)> = match &rig.first_from_table {
            Some(pose) => {
                let table = pose.inverse();
                let moved =
                    |p: &[f64; 3]| (&table * netcord_common::geometry::Point::new(p[0], p[1], p[2])).coords;
                rod.places.iter().map(|(p, e)| (moved(p).into(), *e)).collect()
            }
            None => rod.places.clone(),
        };
        let frame = if rig.first_from_table.is_some() { "table frame" } else { "first camera's frame" };
        plot::draw(&file, (1400, 600), &plots::RodPlot { places: &places, frame })?;
        written.push(file);
    }
    for file in written {
        println!("{}", file.display());
    }
    Ok(())
}

/// RMS of each view's corners in the common pose, found again by their pixels.
fn per_view(views: &CameraViews, own: &[(Vector2<f64>, Vector2<f64>)]) -> Vec<(String, f64)> {
    views
        .views
        .iter()
        .filter_map(|v| {
            let residuals: Vec<f64> =
                own.iter().filter(|(p, _)| v.image.contains(p)).map(|(_, r)| r.norm_squared()).collect();
            let rms = (residuals.iter().sum::<f64>() / residuals.len().max(1) as f64).sqrt();
            (!residuals.is_empty()).then(|| (v.name.clone(), rms))
        })
        .collect()
}
