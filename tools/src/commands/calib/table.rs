//! `netcord calib table`.

use std::{error::Error, path::PathBuf, str::FromStr, sync::Arc};

use nalgebra::Vector3;
use netcord_calib::{
    detect::Detector,
    session::{Mark, Outcome as Solved, Session, SessionCamera, Setup, TableKnown, TableOutcome, Task},
    table::{
        BoardOnTable, Contact, Table, TableCalibration, TableCamera, TableStart, TrackedPoint, find_bounces,
        mark,
    },
};
use netcord_common::geometry::{Point, Transform, World};
use serde::Serialize;

use super::{board, input::process, lines, pictures, rigged::CalibratedRig, save};
use crate::{
    exit::{CommandResult, Outcome},
    output,
};

/// Finds the table's pose before the cameras of a calibrated rig, from marks on it, from a board that lies on it,
/// from the ball's bounces, or from all of them together; and writes it into the rig file.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig file; its cameras must be calibrated.
    rig: PathBuf,

    /// Marks of the table in a camera's picture: CAMERA:MARK:U,V in raw pixels. MARK is a corner (x-y-, x+y-, x+y+,
    /// x-y+, by the signs of the table's x and y; the outer edge of the white line), the end of the middle line
    /// (x0y-, x0y+), where the net meets a side (x-y0, x+y0), the centre (x0y0), or any place X/Y or X/Y/Z in metres.
    #[arg(long = "mark", value_name = "MARK", allow_hyphen_values = true, value_parser = parse_mark)]
    marks: Vec<Mark>,

    /// Marks from a CSV file with the header camera,mark,u,v.
    #[arg(long = "marks", value_name = "FILE.csv")]
    marks_file: Option<PathBuf>,

    /// Find the table's lines in pictures: NAME=PATH of a picture, a folder, or a recording. They are looked for near
    /// the table of the rig file, or where --mark has it; what --mark says then only serves that.
    #[arg(long, value_name = "NAME=PATH")]
    find: Vec<String>,

    /// A board that lies on the table, printed side up, as for `calib board`; then give its pictures as NAME=PATH.
    #[arg(long, requires = "images", requires = "board_at")]
    board: Option<String>,

    /// Where the board lies: X,Y,YAW[,HEIGHT]: its origin (the first corner) on the table in metres, the direction of
    /// its x axis counted from the table's x towards y in degrees, and the height of its printed side in metres.
    #[arg(long, value_name = "X,Y,YAW", allow_hyphen_values = true)]
    board_at: Option<BoardAt>,

    /// Pictures of the board: NAME=PATH of a picture, a folder, or one recording.
    #[arg(value_name = "IMAGES", requires = "board")]
    images: Vec<String>,

    /// Positions of the ball (the CSV of `netcord process --positions` with this rig file): its bounces tell the
    /// table's height and tilt. The rest comes from marks, or stays as it is.
    #[arg(long, value_name = "POSITIONS.csv")]
    bounces: Option<PathBuf>,

    /// Standard deviation of a mark along one axis, px [default: from how well they fit].
    #[arg(long, value_name = "PX")]
    noise: Option<f64>,

    /// Write the report here, as JSON.
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,

    /// Only show the result: do not write it into the rig file.
    #[arg(long)]
    dry_run: bool,
}

fn new_mark(camera: &str, name: &str, u: &str, v: &str) -> Result<Mark, String> {
    let number = |text: &str| -> Result<f64, String> {
        let parsed = text.trim().parse().ok().filter(|v: &f64| v.is_finite());
        parsed.ok_or_else(|| format!("{text:?} is no pixel coordinate"))
    };
    let name = name.trim();
    mark(name)?;
    Ok(Mark { camera: camera.trim().to_owned(), mark: name.to_owned(), at: [number(u)?, number(v)?] })
}

/// `CAMERA:MARK:U,V`.
fn parse_mark(text: &str) -> Result<Mark, String> {
    let parts: Vec<&str> = text.split(':').collect();
    let wrong = || format!("{text:?} is no mark; give it as CAMERA:MARK:U,V, such as left:x+y-:811.5,340");
    let [camera, name, pixel] = parts[..] else { return Err(wrong()) };
    let (u, v) = pixel.split_once(',').ok_or_else(wrong)?;
    new_mark(camera, name, u, v)
}

/// `X,Y,YAW[,HEIGHT]`.
#[derive(Debug, Clone, Copy)]
struct BoardAt(BoardOnTable);

impl FromStr for BoardAt {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<f64>> =
            text.split(',').map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let (origin_m, yaw, height_m) = match numbers.as_deref() {
            Some([x, y, yaw]) => ([*x, *y], *yaw, 0.0),
            Some([x, y, yaw, height]) => ([*x, *y], *yaw, *height),
            _ => {
                return Err(format!(
                    "{text:?} is no place on the table; give X,Y,YAW[,HEIGHT] in m, m, degrees, m"
                ));
            }
        };
        Ok(Self(BoardOnTable { origin_m, yaw_rad: yaw.to_radians(), height_m }))
    }
}

/// How far the table of the rig file may be off where nothing new is measured: in turn, rad, and place, m.
const BELIEVED: [f64; 6] = [0.01, 0.01, 0.01, 0.02, 0.02, 0.02];

#[derive(Serialize)]
struct Report {
    first_from_table: PoseReport,
    rms_px: f64,
    rms_bounces_mm: f64,
    /// Standard deviations along the table's x, y and z, mm.
    sigma_centre_mm: [f64; 3],
    sigma_corner_mm: [f64; 3],
    moved_mm: Option<f64>,
    residuals: Vec<ResidualReport>,
}

#[derive(Serialize)]
struct PoseReport {
    rotation: [[f64; 3]; 3],
    translation_m: [f64; 3],
    /// Of the rotation vector, rad, and the translation, m.
    sigma: [f64; 6],
}

#[derive(Serialize)]
struct ResidualReport {
    camera: Option<String>,
    mark: String,
    residual_px: Option<f64>,
    residual_mm: Option<f64>,
    outlier: bool,
}

/// Runs `netcord calib table`: a session for the table, without a browser.
pub fn run(args: &Args) -> CommandResult {
    let rig = CalibratedRig::load(&args.rig)?;
    let (of_lines, of_board) = (pictures::unread(&args.find)?, pictures::unread(&args.images)?);
    let dictionary = args.board.as_deref().and_then(board::dictionary_file);
    let lists = [Some(&args.rig), args.marks_file.as_ref(), args.bounces.as_ref(), dictionary.as_ref()];
    let read = lists.into_iter().flatten().map(PathBuf::as_path);
    output::check(read.chain(pictures::files(&of_lines)).chain(pictures::files(&of_board)), &args.report)?;
    let mut sources = Vec::new();
    let mut marks = args.marks.clone();
    if let Some(path) = &args.marks_file {
        marks.extend(read_marks(path)?);
    }
    if !of_lines.is_empty() {
        marks = lines::find(&rig, &of_lines, &rough(args, &rig, &marks)?)?;
    }
    if !marks.is_empty() {
        sources.push(format!("{} marks", marks.len()));
    }
    let contacts = match &args.bounces {
        Some(path) => of_bounces(&rig, path)?,
        None => Vec::new(),
    };
    let mut session = session_of(args, &rig, &contacts)?;
    set_marks(&mut session, &rig, &marks)?;
    if let Some(spec) = &args.board {
        let mut shots = pictures::search(session.detector(), &of_board)?;
        let places = of_board.iter().map(|(camera, _)| rig.place(camera)).collect::<Result<Vec<_>, _>>()?;
        for shot in &mut shots {
            let mut sights: Vec<_> = rig.cameras.iter().map(|_| None).collect();
            for (place, sight) in places.iter().zip(shot.sights.drain(..)) {
                sights[*place] = sight;
            }
            shot.sights = sights;
        }
        pictures::offer(&mut session, shots)?;
        sources.push(format!("{spec} on the table"));
    }
    if !contacts.is_empty() {
        sources.push(format!("{} bounces", contacts.len()));
    }
    if sources.is_empty() {
        return Err("nothing to find the table by: give --mark, --marks, --find, --board or --bounces".into());
    }
    let outcome = process(&mut session)?;
    let Solved::Table(found) = outcome.as_ref() else {
        return Err(OTHER_OUTCOME.into());
    };
    let report = report(&rig, found);
    print(&report, &found.table);
    if let Some(path) = &args.report {
        output::write(path, serde_json::to_string_pretty(&report)?)?;
    }
    let measured = &found.table.residuals;
    if !args.dry_run {
        let count = measured.iter().filter(|r| !r.outlier).count();
        save::table(&args.rig, &sources.join(", "), count, &found.table)?;
    }
    Ok(if measured.iter().any(|r| r.outlier && r.camera.is_some()) { Outcome::Missed } else { Outcome::Good })
}

fn set_marks(session: &mut Session, rig: &CalibratedRig, marks: &[Mark]) -> Result<(), Box<dyn Error>> {
    for m in marks {
        rig.place(&m.camera)?;
        session.set_mark(m.clone())?;
    }
    Ok(())
}

/// Where the table is about: by the marks that somebody pointed at, or as the rig file has it.
fn rough(
    args: &Args,
    rig: &CalibratedRig,
    marks: &[Mark],
) -> Result<Transform<World, Table>, Box<dyn Error>> {
    if marks.is_empty() {
        return rig.first_from_table.ok_or_else(|| {
            "--find needs to know about where the table is: the rig file has none; point at four of its corners with \
             --mark"
                .into()
        });
    }
    let mut session = session_of(args, rig, &[])?;
    set_marks(&mut session, rig, marks)?;
    match process(&mut session)?.as_ref() {
        Solved::Table(found) => Ok(found.table.first_from_table),
        _ => Err(OTHER_OUTCOME.into()),
    }
}

/// What a session for one thing would only give by a fault of its own.
const OTHER_OUTCOME: &str = "the session gave the result of another task";

/// A session for the table with the rig's cameras and all that is known already.
fn session_of(args: &Args, rig: &CalibratedRig, contacts: &[Contact]) -> Result<Session, Box<dyn Error>> {
    // Without a board there are no pictures, and nothing is searched for.
    let spec = args.board.as_deref().unwrap_or("chessboard:3x3:1m");
    let camera = |c: &TableCamera| SessionCamera {
        name: c.name.clone(),
        model: Some(c.model),
        camera_from_first: Some(c.camera_from_first),
    };
    let mut setup = Setup::new(Task::Table, rig.cameras.iter().map(camera).collect());
    // The board lies still: its views are alike, and all of them count.
    setup.options.max_views = usize::MAX;
    setup.on_table = args.board_at.map(|BoardAt(lies)| lies);
    setup.table = TableKnown {
        contacts: contacts.to_vec(),
        start: rig.first_from_table.map(|first_from_table| TableStart { first_from_table, sigma: BELIEVED }),
        noise_px: args.noise,
    };
    Ok(Session::new(setup, Arc::new(Detector::new(board::parse(spec)?))))
}

fn read_marks(path: &std::path::Path) -> Result<Vec<Mark>, Box<dyn Error>> {
    let failed = |line: u64, what: String| format!("{}, line {line}: {what}", path.display());
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(path)
        .map_err(|e| format!("cannot read {}: {e}", path.display()))?;
    let header = reader.headers().map_err(|e| format!("{}: {e}", path.display()))?;
    let header: Vec<String> = header.iter().map(str::to_owned).collect();
    if header != ["camera", "mark", "u", "v"] {
        return Err(failed(1, format!("the header is {}, not camera,mark,u,v", header.join(","))).into());
    }
    let mut marks = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|e| format!("{}: {e}", path.display()))?;
        let line = record.position().map_or(0, csv::Position::line);
        let field = |i: usize| record.get(i).unwrap_or_default();
        let parsed = new_mark(field(0), field(1), field(2), field(3)).map_err(|e| failed(line, e))?;
        marks.push(parsed);
    }
    Ok(marks)
}

/// Bounces of the ball, in the first camera's frame.
fn of_bounces(rig: &CalibratedRig, path: &std::path::Path) -> Result<Vec<Contact>, Box<dyn Error>> {
    let track = super::tracks::read_positions(path)?;
    let track: Vec<TrackedPoint> = track
        .iter()
        .map(|(t_ns, at)| {
            // Positions are in the table frame where the rig has one.
            let at = match &rig.first_from_table {
                Some(pose) => Point::from((pose * Point::from(*at)).coords),
                None => Point::from(*at),
            };
            TrackedPoint { t_s: *t_ns as f64 * 1e-9, at }
        })
        .collect();
    let up = rig.first_from_table.map(|pose| pose.rotation * Vector3::z());
    let bounces = find_bounces(&track, up);
    // On the floor, a racket or the net's edge it bounces too; the table is where most of them lie in a plane.
    let near = |height: f64| (height - rig.ball_radius_m).abs() < 0.06;
    let on_table = |at: &Point<_>| {
        rig.first_from_table.is_none_or(|pose| {
            let p = (&pose.inverse() * *at).coords;
            near(p.z) && p.x.abs() < 0.8 && p.y.abs() < 1.4
        })
    };
    let contacts: Vec<Contact> = bounces
        .iter()
        .filter(|b| on_table(&b.at))
        .map(|b| Contact { at: b.at, height_m: rig.ball_radius_m, sigma_m: b.sigma_m.max(5e-4) })
        .collect();
    println!("{}: {} bounces, {} of them on the table", path.display(), bounces.len(), contacts.len());
    if contacts.is_empty() {
        return Err(format!("{} holds no bounce on the table that is clear enough", path.display()).into());
    }
    Ok(contacts)
}

fn report(rig: &CalibratedRig, outcome: &TableOutcome) -> Report {
    let found = &outcome.table;
    let pose = &found.first_from_table;
    let mm = |v: Vector3<f64>| -> [f64; 3] { (v * 1e3).into() };
    let corner = Vector3::new(0.7625, 1.37, 0.0);
    let moved_mm = rig.first_from_table.map(|old| {
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        let off = |(x, y): (f64, f64)| {
            let p = Point::new(x * corner.x, y * corner.y, 0.0);
            (&old * p).distance(&(pose * p))
        };
        corners.into_iter().map(off).fold(0.0, f64::max) * 1e3
    });
    Report {
        first_from_table: PoseReport {
            rotation: pose.rotation.matrix().transpose().into(),
            translation_m: pose.translation.into(),
            sigma: found.standard_deviations(),
        },
        rms_px: found.rms_px,
        rms_bounces_mm: found.rms_contact_m * 1e3,
        sigma_centre_mm: mm(found.sigma_at(&Vector3::zeros())),
        sigma_corner_mm: mm(found.sigma_at(&corner)),
        moved_mm,
        residuals: found
            .residuals
            .iter()
            .map(|r| ResidualReport {
                camera: r.camera.map(|c| outcome.cameras[c].name.clone()),
                mark: r.mark.clone(),
                residual_px: r.camera.map(|_| r.length),
                residual_mm: r.camera.is_none().then_some(r.length * 1e3),
                outlier: r.outlier,
            })
            .collect(),
    }
}

fn print(report: &Report, found: &TableCalibration) {
    /// Of a board's many corners only what is wrong is of interest.
    const FEW: usize = 24;
    let marks = report.residuals.iter().filter(|r| r.camera.is_some()).count();
    for r in report.residuals.iter().filter(|r| r.outlier || r.camera.is_some() && marks <= FEW) {
        let left_out = if r.outlier { "  left out" } else { "" };
        match (&r.camera, r.residual_px, r.residual_mm) {
            (Some(camera), Some(px), _) => println!("  {camera:<12} {:<18} {px:>7.2} px{left_out}", r.mark),
            (_, _, Some(mm)) => println!("  {:<31} {mm:>7.2} mm{left_out}", r.mark),
            _ => {}
        }
    }
    if marks > 0 {
        println!("marks: {:.2} px RMS", found.rms_px);
    }
    if marks < report.residuals.len() {
        println!("bounces: {:.2} mm RMS in height", report.rms_bounces_mm);
    }
    let t = found.first_from_table.translation;
    println!("the table's centre is at ({:.4}, {:.4}, {:.4}) m before the first camera", t.x, t.y, t.z);
    let show = |v: [f64; 3]| format!("{:.2}, {:.2}, {:.2} mm", v[0], v[1], v[2]);
    println!(
        "standard deviations along x, y, z: centre {}; corners {}",
        show(report.sigma_centre_mm),
        show(report.sigma_corner_mm)
    );
    if let Some(moved) = report.moved_mm {
        println!("a corner moves by at most {moved:.1} mm against the rig file's");
    }
}
