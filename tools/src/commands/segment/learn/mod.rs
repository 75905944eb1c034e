//! `netcord segment --learn`: marked frames become the ball's colour in the rig file.

mod frames;
mod marks;
mod picture;
mod report;

use std::{
    collections::BTreeMap,
    ffi::OsString,
    path::{Path, PathBuf},
};

use netcord_common::{
    CameraName, DomainName, FrameView, PixelFormat,
    rig::{LearningNote, RigEdit},
};
use netcord_detect::segment::learn::{Learner, Lesson, Mark, MarkError};

use self::{
    frames::{Frame, Frames},
    marks::Marks,
    picture::{LessonPlot, MarkedBall},
    report::{CameraReport, Report},
};
use super::super::{calib::today, file_to_write};
use crate::{
    exit::{CommandResult, Outcome},
    output, plot,
};

/// How to learn the ball's colour.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Learning")]
pub struct LearnArgs {
    /// Learn the ball's colour from marked frames, write it into the rig file, and end. IN is a recording (.mcap), a
    /// folder of pictures, or a folder of one such folder a camera; pictures are mosaicked as `netcord import` does.
    /// Where the rig file does not exist, one for finding the ball in such frames is begun.
    #[arg(long, value_name = "IN")]
    pub learn: Option<PathBuf>,

    /// The marks: a CSV or JSON file with the columns or keys image (a picture's name), frame (a number from 0) or
    /// t_ns; camera, where there are several; and u, v, diameter (centre and diameter, px; blur_u and blur_v, the way
    /// during the exposure, may follow) or x0, y0, x1, y1 (a box with one ball in it). Or a folder of YOLO labels,
    /// named after the pictures. All balls of a marked frame must be marked. Default: labels beside the pictures (in
    /// the same folder, or in ../labels), or the recording's own /truth/ball.
    #[arg(long, value_name = "MARKS", requires = "learn")]
    marks: Option<PathBuf>,

    /// Learn each camera's colour by itself; default: cameras with colour share one, cameras without another.
    #[arg(long, requires = "learn")]
    each_camera: bool,

    /// Most frames of each camera that are learnt from, spread over all that are marked.
    #[arg(long, value_name = "N", default_value_t = 60, requires = "learn",
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    most_frames: u32,

    /// What was learnt and how well it separates, as JSON.
    #[arg(long, value_name = "R.json", requires = "learn", value_parser = file_to_write)]
    report: Option<PathBuf>,

    /// Write what was learnt into the rig file also where it hardly tells the ball, or most marks were left out.
    #[arg(long, requires = "learn")]
    force: bool,

    /// What was learnt, as a picture: the region among the ball's and other colours, and the marked balls with the
    /// cells that pass. PNG or SVG.
    #[arg(long, value_name = "P.png", requires = "learn", value_parser = file_to_write)]
    plot: Option<PathBuf>,
}

/// What one group of cameras is taught.
#[derive(Debug, Default)]
struct Class {
    learner: Learner,
    cameras: Vec<CameraName>,
    balls: Vec<MarkedBall>,
    skipped: Vec<String>,
}

/// Learns from `input`, and writes what was learnt into the rig file.
pub fn run(args: &LearnArgs, input: &Path, rig: &Path, only: Option<&CameraName>) -> CommandResult {
    let (mut edit, begun) =
        if rig.exists() { (RigEdit::open(rig)?, false) } else { (RigEdit::create(rig, &name_of(rig)), true) };
    let frames = Frames::open(input, only)?;
    let read = [Some(rig), Some(input), args.marks.as_deref()].into_iter().flatten();
    output::check(read.chain(frames.pictures()), [&args.plot, &args.report].into_iter().flatten())?;
    if begun {
        frames.begin(&mut edit)?;
    }
    // Learning needs no calibration.
    let known = edit.clone().with_nominal_calibration().resolve()?;
    frames.check_against(&known, rig)?;
    let marks = Marks::gather(args.marks.as_deref(), &frames, &known)?;
    let mut classes: BTreeMap<String, Class> = BTreeMap::new();
    for (camera, place) in marks.frames(args.most_frames as usize) {
        let frame = frames.read(camera, place, &known)?;
        let name = frames.camera(camera).clone();
        let key = match (args.each_camera, frame.format) {
            (true, _) => name.to_string(),
            (false, PixelFormat::Mono8) => "grey".to_owned(),
            (false, _) => "colour".to_owned(),
        };
        let class = classes.entry(key).or_default();
        if !class.cameras.contains(&name) {
            class.cameras.push(name);
        }
        see(class, &frame, &marks.of(camera, place, &frame)?)?;
    }
    let mut report = Report::default();
    let mut plots = Vec::new();
    let mut doubts = Vec::new();
    for class in classes.values() {
        let names = class.cameras.iter().map(CameraName::as_str).collect::<Vec<_>>().join(", ");
        for skipped in &class.skipped {
            tracing::warn!("{skipped}: it is left out");
        }
        let lesson = class.learner.learn().map_err(|e| format!("camera {names}: {e}"))?;
        println!("{}", summary(&names, &lesson));
        doubts.extend(doubt(class, &lesson).map(|why| format!("camera {names}: {why}")));
        for camera in &class.cameras {
            edit.set_ball(camera, &lesson.colour, &note(&lesson));
            report.cameras.push(CameraReport::of(camera, &lesson, &class.skipped));
        }
        plots.push(LessonPlot::new(&names, lesson, &class.balls));
    }
    if begun {
        edit = edit.with_nominal_calibration();
    }
    // What cannot be read back must not be written.
    edit.clone().with_nominal_calibration().resolve()?;
    if let Some(path) = &args.plot {
        for (i, lesson) in plots.iter().enumerate() {
            let path = if i == 0 { path.clone() } else { numbered(path, i + 1) };
            plot::draw(&path, picture::SIZE, lesson)?;
        }
    }
    if let Some(path) = &args.report {
        report.write(path)?;
    }
    if !doubts.is_empty() && !args.force {
        return Err(format!(
            "{}; are the marks where the balls are? {} is as it was; --force writes it all the same",
            doubts.join("; "),
            rig.display()
        )
        .into());
    }
    let kept =
        edit.save()?.map_or_else(String::new, |old| format!("; the old one is kept as {}", old.display()));
    println!("{}: written{kept}", rig.display());
    if begun {
        tracing::warn!(
            "the lens of the new rig file {} is a nominal one: enough to find the ball's image, not for positions",
            rig.display()
        );
    }
    let left_out = classes.values().any(|class| !class.skipped.is_empty());
    Ok(if left_out { Outcome::Missed } else { Outcome::Good })
}

/// A colour whose curve has less area under it tells the ball from hardly more than half of all else.
const LEAST_AREA: f64 = 0.85;

/// Why what was learnt is not to be trusted.
fn doubt(class: &Class, lesson: &Lesson) -> Option<String> {
    let area = lesson.separation.area;
    if class.skipped.len() > lesson.frames {
        Some(format!("{} marked frames were left out and {} learnt from", class.skipped.len(), lesson.frames))
    } else if area < LEAST_AREA {
        Some(format!(
            "the colour does not tell the ball: area under the curve {area:.2}, from 0.5 (nothing) to 1"
        ))
    } else {
        None
    }
}

/// The name of a rig whose file is begun: that of the file, where it can be one.
fn name_of(rig: &std::path::Path) -> String {
    let stem = rig.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    DomainName::new(stem).map_or_else(|_| "learnt".to_owned(), |name| name.to_string())
}

/// Learns from one frame. A box in which no ball can be told is left out with its frame.
fn see(class: &mut Class, frame: &Frame, marks: &[Mark]) -> Result<(), String> {
    let view = FrameView::new(&frame.pixels, frame.size, frame.size.0, frame.format)
        .map_err(|e| format!("{}: {e}", frame.name))?;
    match class.learner.see(&view, marks) {
        Ok(labelled) => class.balls.extend(MarkedBall::of(frame, &labelled)),
        Err(e @ MarkError::NothingInBox { .. }) => class.skipped.push(format!("{}: {e}", frame.name)),
        Err(e) => return Err(format!("{}: {e}", frame.name)),
    }
    Ok(())
}

fn summary(names: &str, lesson: &Lesson) -> String {
    let separation = &lesson.separation;
    let confusion = &separation.confusion;
    let of = if separation.held_out {
        "in frames that were not learnt from"
    } else {
        "in the one marked frame itself"
    };
    format!(
        "camera {names}: learnt from {} balls in {} frames ({} cells, diameters {:.0} to {:.0} px); {of}, {:.1} % of the \
         ball's cells pass and {:.2} % of all others; area under the curve {:.4}",
        lesson.balls,
        lesson.frames,
        lesson.ball_cells,
        lesson.colour.diameter_px[0],
        lesson.colour.diameter_px[1],
        100.0 * confusion.kept(),
        100.0 * confusion.let_through(),
        separation.area,
    )
}

fn note(lesson: &Lesson) -> LearningNote {
    let share = |share: f64| lesson.separation.held_out.then_some((share * 1e4).round() / 1e4);
    LearningNote {
        date: today(),
        frames: lesson.frames as u64,
        balls: lesson.balls as u64,
        kept: share(lesson.separation.confusion.kept()),
        let_through: share(lesson.separation.confusion.let_through()),
    }
}

/// `p.png` becomes `p-2.png`.
fn numbered(path: &Path, n: usize) -> PathBuf {
    // A path without a name was refused with the arguments (`file_to_write`).
    let mut name = path.file_stem().map_or_else(OsString::new, OsString::from);
    name.push(format!("-{n}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}
