//! `netcord calib motion`: poses of cameras from points in motion.

use std::{
    collections::BTreeMap,
    error::Error,
    path::{Path, PathBuf},
};

use nalgebra::{Vector2, Vector3};
use netcord_calib::{
    solve::{
        INTRINSIC_NAMES, Inconsistent, MotionCalibration, MotionMember, MotionOptions, MovingPoints, Stray,
        calibrate_motion, scale_by_gravity,
    },
    table::mark,
};
use netcord_common::{
    CameraName,
    camera::CameraModel,
    geometry::Point,
    rig::{CalibrationNote, RigEdit},
};
use serde::Serialize;

use super::{
    options::Intrinsic,
    save,
    tracks::{Track, read_detections, read_track},
};
use crate::{
    exit::{CommandResult, Outcome},
    output,
};

/// Points in motion.
#[derive(Debug, Clone, clap::Args)]
pub struct PointsArgs {
    /// Points in motion: NAME=FILE.csv of one camera with rows t_ns;u1;v1;u2;v2;… (raw pixels, −1 where a marker is not
    /// seen), or the CSV of `netcord process --detections` with all cameras.
    #[arg(long = "track", value_name = "TRACK")]
    pub tracks: Vec<String>,

    /// The wand's two markers whose distance is known, counted from 1 [default: the first and the last].
    #[arg(long, value_name = "I,J")]
    ends: Option<String>,

    /// Instants of two cameras that differ by no more than this are the same, in microseconds.
    #[arg(long, value_name = "US", default_value_t = 1000)]
    together_us: u64,
}

/// Points of all cameras at common instants.
pub struct Joined {
    /// Each camera's; the place is instant × markers + marker.
    pub cameras: Vec<MovingPoints>,
    /// Markers at an instant.
    pub markers: usize,
    /// Number of instants.
    pub instants: usize,
    /// The instants, ns.
    pub times_ns: Vec<u64>,
}

/// The camera, unless the file tells it, and the file.
fn track_of(track: &str) -> (Option<&str>, &Path) {
    track.split_once('=').map_or((None, track.as_ref()), |(name, path)| (Some(name), path.as_ref()))
}

impl PointsArgs {
    /// The files that are read.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.tracks.iter().map(|track| track_of(track).1)
    }

    /// Reads the tracks and joins them by their instants; `known` gives a camera's intrinsics, and how much later than
    /// stamped its frames are exposed, s: its points are taken back to the instants of their stamps.
    pub fn load(
        &self,
        known: impl Fn(&str) -> Result<(CameraModel, f64), String>,
    ) -> Result<Joined, Box<dyn Error>> {
        let mut tracks: Vec<(String, Track)> = Vec::new();
        for track in &self.tracks {
            match track_of(track) {
                (Some(name), path) => tracks.push((name.to_owned(), read_track(path)?)),
                (None, path) => tracks.extend(read_detections(path)?),
            }
        }
        let markers = tracks.iter().flat_map(|(_, t)| t.values()).map(Vec::len).max().unwrap_or(0);
        if let Some((name, _)) = tracks.iter().find(|(_, t)| t.values().any(|p| p.len() != markers)) {
            return Err(
                format!("camera {name}: it has fewer markers than the others, which have {markers}").into()
            );
        }
        // Instants that lie together become the earliest of them.
        let mut all: Vec<u64> = tracks.iter().flat_map(|(_, t)| t.keys().copied()).collect();
        all.sort_unstable();
        let tolerance_ns = self.together_us * 1000;
        let mut times_ns: Vec<u64> = Vec::new();
        for t in all {
            if times_ns.last().is_none_or(|last| t - last > tolerance_ns) {
                times_ns.push(t);
            }
        }
        let times_s: Vec<f64> = times_ns.iter().map(|t| (t - times_ns[0]) as f64 * 1e-9).collect();
        let cameras = tracks
            .into_iter()
            .map(|(name, track)| {
                let (model, later_s) = known(&name)?;
                let mut pixels: Vec<Option<Vector2<f64>>> = vec![None; times_ns.len() * markers];
                for (t, points) in track {
                    let instant = times_ns.partition_point(|x| *x <= t).saturating_sub(1);
                    pixels[instant * markers..(instant + 1) * markers].clone_from_slice(&points);
                }
                let points = MovingPoints { name, model, pixels, velocities: Vec::new() };
                Ok(points.with_velocities(markers, &times_s).on_time(later_s))
            })
            .collect::<Result<_, String>>()?;
        Ok(Joined { cameras, markers, instants: times_ns.len(), times_ns })
    }

    /// The two markers of known distance, counted from 0.
    pub fn ends(&self, markers: usize) -> Result<(usize, usize), String> {
        let Some(text) = &self.ends else {
            return if markers >= 2 {
                Ok((0, markers - 1))
            } else {
                Err("a length needs two markers; these tracks have one point each".to_owned())
            };
        };
        let parsed =
            text.split_once(',').and_then(|(a, b)| Some((a.trim().parse().ok()?, b.trim().parse().ok()?)));
        parsed
            .filter(|(a, b): &(usize, usize)| {
                a != b && (1..=markers).contains(a) && (1..=markers).contains(b)
            })
            .map(|(a, b)| (a - 1, b - 1))
            .ok_or_else(|| {
                format!("--ends {text:?}: give two of the markers 1 to {markers}, such as 1,{markers}")
            })
    }
}

/// Places of the two ends at each instant.
pub fn pairs(instants: usize, markers: usize, ends: (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    (0..instants).map(move |i| (i * markers + ends.0, i * markers + ends.1))
}

/// Finds the poses of cameras from points in motion: a wand's markers, or the ball in flight. No board, and no common view
/// of anything else is needed. Says which camera contradicts the others. The scale comes from the wand's length, from two
/// marks of the table, or from gravity.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("scale").args(["length", "marks", "gravity"]))]
pub struct Args {
    /// The rig file: its intrinsics are used, and the poses are written into it.
    rig: PathBuf,

    #[command(flatten)]
    points: PointsArgs,

    /// Scale by the wand's length: the distance in metres of the markers that --ends names.
    #[arg(long, value_name = "M")]
    length: Option<f64>,

    /// Scale by the table's size: CAMERA:MARK:U,V of marks as for `calib table`, each in two cameras.
    #[arg(long = "mark", value_name = "MARK", allow_hyphen_values = true)]
    marks: Vec<String>,

    /// Scale by gravity: the points are a ball in flight.
    #[arg(long)]
    gravity: bool,

    /// Intrinsics to refine with the poses: a comma-separated list of fx fy cx cy k1 k2 p1 p2 k3. The points must
    /// then fill the pictures.
    #[arg(long, value_delimiter = ',', value_name = "LIST")]
    refine: Vec<Intrinsic>,

    /// Write the report here, as JSON.
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,

    /// Only show the result: do not write it into the rig file.
    #[arg(long)]
    dry_run: bool,
}

#[derive(Serialize)]
struct Report {
    /// `wand`, `table`, `gravity`, or `none`: then lengths are in units of the first baseline.
    scale: &'static str,
    /// Standard deviation of the scale as a share of it, where it is known.
    scale_sigma: Option<f64>,
    /// Whether the markers were found to be a rigid wand's, and held to that.
    rigid_wand: bool,
    cameras: BTreeMap<String, CameraReport>,
    inconsistent: BTreeMap<String, InconsistentReport>,
    points: usize,
}

#[derive(Serialize)]
struct InconsistentReport {
    median_px: f64,
    /// How much later its frames were exposed than the others' of the same stamp, s, where that explains it; and the
    /// median residual that is left then.
    later_s: Option<f64>,
    then_px: Option<f64>,
}

#[derive(Serialize)]
struct CameraReport {
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
    median_px: f64,
    /// Without strays, and with them.
    rms_px: f64,
    rms_all_px: f64,
    points: usize,
    strays: Vec<StrayReport>,
    /// fx fy cx cy k1 k2 p1 p2 k3, where some were refined.
    #[serde(skip_serializing_if = "Option::is_none")]
    intrinsics: Option<BTreeMap<&'static str, f64>>,
}

/// A point that contradicts the rest.
#[derive(Serialize)]
struct StrayReport {
    t_ns: u64,
    /// Counted from 1.
    marker: usize,
    off_px: f64,
    /// Seen just before or after the camera lost a marker: something comes before it.
    half_hidden: bool,
}

/// Runs `netcord calib motion`.
pub fn run(args: &Args) -> CommandResult {
    let mut edit = RigEdit::open(&args.rig)?;
    let names = edit.camera_names();
    if args.points.tracks.is_empty() {
        return Err("no points in motion: give --track".into());
    }
    output::check(args.points.files().chain([args.rig.as_path()]), &args.report)?;
    let joined = args.points.load(|name| {
        let model = edit.intrinsics(name).ok_or_else(|| {
            format!(
                "{} has no intrinsics of a camera {name:?}; its cameras are {}",
                args.rig.display(),
                names.join(", ")
            )
        })?;
        Ok((model, edit.clock_delay_s(name)))
    })?;
    for name in &names {
        let later_s = edit.clock_delay_s(name);
        if later_s != 0.0 {
            println!(
                "{name}: its points are taken back by the {:+.2} ms that {} gives its clock",
                1e3 * later_s,
                args.rig.display()
            );
        }
    }
    let mut options = MotionOptions { markers: joined.markers, ..MotionOptions::default() };
    for Intrinsic(i) in &args.refine {
        options.intrinsics[*i] = true;
    }
    let mut found = calibrate_motion(&joined.cameras, &options)?;
    let (scale, scale_sigma) = scale(args, &joined, &mut found)?;
    for c in &found.cameras {
        let t = c.camera_from_first.origin().coords;
        println!(
            "{:<12} {} points, median {:.3} px, RMS {:.3} px without {} that do not fit ({} of them half hidden), {:.3} px \
             with them; at ({:+.4}, {:+.4}, {:+.4})",
            c.name,
            c.points,
            c.median_px,
            c.rms_px,
            c.strays.len(),
            c.strays.iter().filter(|s| s.half_hidden).count(),
            c.rms_all_px,
            t.x,
            t.y,
            t.z
        );
    }
    found.inconsistent.iter().for_each(say_inconsistent);
    match (scale, scale_sigma) {
        ("none", _) => {
            println!("lengths are in units of the first baseline: give --length, --mark or --gravity")
        }
        (by, Some(sigma)) => println!("scale by {by}: ± {:.2} %", 100.0 * sigma),
        (by, None) => println!("scale by {by}"),
    }
    if let Some(path) = &args.report {
        let report = report(scale, scale_sigma, &found, &joined, !args.refine.is_empty());
        output::write(path, serde_json::to_string_pretty(&report)?)?;
    }
    if !args.dry_run && scale != "none" {
        write(&mut edit, args, scale, &joined, &found)?;
    }
    Ok(if found.inconsistent.is_empty() { Outcome::Good } else { Outcome::Missed })
}

fn say_inconsistent(Inconsistent { name, median_px, delay }: &Inconsistent) {
    match delay {
        Some(delay) => println!(
            "{name} contradicts the others: {median_px:.2} px; its clock is wrong: its frames were exposed {:.2} ms {} \
             than the others' of the same stamp ({:.2} px with that made good: mend the clock, or note \
             clock_delay_ms = {:.2} with the camera in the rig file)",
            1e3 * delay.later_s.abs(),
            if delay.later_s > 0.0 { "later" } else { "earlier" },
            delay.median_px,
            1e3 * delay.later_s,
        ),
        None => println!(
            "{name} contradicts the others: {median_px:.2} px; its intrinsics or its markers are wrong (no clock's error explains it)"
        ),
    }
}

/// Makes lengths metres; says by what, and how sure.
fn scale(
    args: &Args,
    joined: &Joined,
    found: &mut MotionCalibration,
) -> Result<(&'static str, Option<f64>), Box<dyn Error>> {
    if let Some(length) = args.length {
        let ends = args.points.ends(joined.markers)?;
        let median = found.median_distance(pairs(joined.instants, joined.markers, ends));
        found.scale(length / median.ok_or("no instant at which two cameras see both ends of the wand")?);
        return Ok(("wand", None));
    }
    if !args.marks.is_empty() {
        found.scale(scale_by_marks(&args.marks, found)?);
        return Ok(("table", None));
    }
    if args.gravity {
        let track: Vec<(f64, Vector3<f64>)> = (0..joined.instants)
            .filter_map(|i| {
                Some((joined.times_ns[i] as f64 * 1e-9, found.points[i * joined.markers]?.coords))
            })
            .collect();
        let (factor, sigma) = scale_by_gravity(&track)
            .ok_or("the points do not fall: gravity needs a second or more of a ball in free flight")?;
        found.scale(factor);
        return Ok(("gravity", Some(sigma / factor)));
    }
    Ok(("none", None))
}

/// The factor by which distances between marks of the table are too short.
fn scale_by_marks(marks: &[String], found: &MotionCalibration) -> Result<f64, Box<dyn Error>> {
    let mut seen: BTreeMap<String, Vec<(usize, Vector2<f64>)>> = BTreeMap::new();
    for text in marks {
        let wrong =
            || format!("{text:?} is no mark; give it as CAMERA:MARK:U,V, such as left:x+y-:811.5,340");
        let [camera, name, pixel] = text.split(':').collect::<Vec<_>>()[..] else {
            return Err(wrong().into());
        };
        let (u, v) = pixel.split_once(',').ok_or_else(wrong)?;
        let pixel =
            Vector2::new(u.trim().parse().map_err(|_| wrong())?, v.trim().parse().map_err(|_| wrong())?);
        mark(name)?;
        let place =
            found.cameras.iter().position(|c| c.name == camera).ok_or_else(|| {
                format!("{text:?}: camera {camera} is not among those that were solved for")
            })?;
        seen.entry(name.to_owned()).or_default().push((place, pixel));
    }
    let mut places = Vec::new();
    for (name, views) in &seen {
        let rays = views.iter().filter_map(|(place, pixel)| {
            let member = &found.cameras[*place];
            Some((&member.camera_from_first, member.model.ray(pixel)?))
        });
        if let Some(at) = netcord_calib::check::nearest_point(rays) {
            places.push((mark(name)?, at));
        }
    }
    let mut ratios: Vec<f64> = Vec::new();
    for (i, a) in places.iter().enumerate() {
        ratios.extend(places[..i].iter().map(|b| (a.0 - b.0).norm() / (a.1 - b.1).norm()));
    }
    ratios.sort_by(f64::total_cmp);
    ratios
        .get(ratios.len() / 2)
        .copied()
        .filter(|r| r.is_finite())
        .ok_or_else(|| "scale by the table needs two marks, each in two cameras".into())
}

fn report(
    scale: &'static str,
    scale_sigma: Option<f64>,
    found: &MotionCalibration,
    joined: &Joined,
    refined: bool,
) -> Report {
    let stray = |s: &Stray| StrayReport {
        t_ns: joined.times_ns[s.place / joined.markers],
        marker: s.place % joined.markers + 1,
        off_px: s.off_px,
        half_hidden: s.half_hidden,
    };
    let camera = |c: &MotionMember| CameraReport {
        rotation: c.camera_from_first.rotation.matrix().transpose().into(),
        translation: c.camera_from_first.translation.into(),
        median_px: c.median_px,
        rms_px: c.rms_px,
        rms_all_px: c.rms_all_px,
        points: c.points,
        strays: c.strays.iter().map(stray).collect(),
        intrinsics: refined.then(|| INTRINSIC_NAMES.into_iter().zip(c.model.parameters()).collect()),
    };
    let inconsistent = |i: &Inconsistent| InconsistentReport {
        median_px: i.median_px,
        later_s: i.delay.map(|d| d.later_s),
        then_px: i.delay.map(|d| d.median_px),
    };
    Report {
        scale,
        scale_sigma,
        rigid_wand: found.rigid,
        cameras: found.cameras.iter().map(|c| (c.name.clone(), camera(c))).collect(),
        inconsistent: found.inconsistent.iter().map(|i| (i.name.clone(), inconsistent(i))).collect(),
        points: found.points.iter().flatten().count(),
    }
}

/// Poses into the rig file; those of cameras that contradict the others stay as they are.
fn write(
    edit: &mut RigEdit,
    args: &Args,
    scale: &str,
    joined: &Joined,
    found: &MotionCalibration,
) -> Result<(), Box<dyn Error>> {
    let names = edit.camera_names();
    let first = names.first().cloned().unwrap_or_default();
    let Some(reference) = found.cameras.iter().find(|c| c.name == first) else {
        return Err(format!(
            "poses in {} refer to its first camera, {first}, which is not among those that agree; nothing is written",
            args.rig.display()
        )
        .into());
    };
    let to_first = reference.camera_from_first.inverse();
    for c in &found.cameras {
        let pose = {
            let rotation = c.camera_from_first.rotation * to_first.rotation;
            let moved = (&c.camera_from_first * Point::from(to_first.translation)).coords;
            (rotation, moved)
        };
        let note = CalibrationNote {
            date: save::today(),
            board: format!("points in motion, scale by {scale}"),
            frames: joined.instants as u64,
            rms_px: c.rms_px,
        };
        let name = CameraName::new(&c.name)?;
        if !args.refine.is_empty() {
            edit.set_intrinsics(&name, &c.model, None, Some(&note));
        }
        edit.set_pose(&name, pose.0.matrix(), &pose.1, None, Some(&note));
    }
    super::save::save(edit, &args.rig)
}
