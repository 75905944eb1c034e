//! `netcord rig`: checks a rig file and shows what it says; imports and exports calibrations.

use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
};

use clap::Subcommand;
use netcord_capture::synthetic::truth_domain;
use netcord_common::{
    CameraName, DomainName, PixelFormat,
    bus::DomainRemains,
    rig::{
        Rig, RigCamera, RigEdit,
        exchange::{self, Format, ImportDefaults},
    },
    wire::WorldFrame,
};

use crate::{
    exit::{CommandResult, Outcome},
    output::Plan,
};

/// Arguments of `netcord rig`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Check a rig file and show what it says.
    Show {
        /// The rig file.
        rig: PathBuf,
    },
    /// Make a rig file from a calibration of OpenCV, ROS, Kalibr, the original rig, or from JSON.
    Import(ImportArgs),
    /// Remove what is left of a rig in shared memory when its processes have ended; `netcord up` does so itself.
    Clean(super::RigArgs),
    /// Write a rig's calibration for OpenCV, ROS, Kalibr, the original rig's programs, or as JSON.
    Export(ExportArgs),
}

#[derive(Debug, clap::Args)]
struct ImportArgs {
    /// The calibration: OpenCV YAML, ROS camera_info YAML, Kalibr camera chain YAML, the original rig's
    /// YAML, or JSON {"cameras": [{"name", "width", "height", "K", "D", "R", "t"}]}, camera from table.
    file: PathBuf,

    /// The rig file to write. One that is there is kept as <RIG>.bak, .bak2, ….
    #[arg(long, value_name = "RIG.toml")]
    out: PathBuf,

    /// Set the calibration of the cameras in the rig file that is there, and keep all else that it says.
    #[arg(long)]
    update: bool,

    /// The format: opencv, ros, kalibr, parameters or json [default: told from the file].
    #[arg(long)]
    format: Option<Format>,

    /// The rig's name [default: that of the file to write].
    #[arg(long)]
    name: Option<DomainName>,

    /// The camera's name, for files of one camera [default: as the file says, or its own name].
    #[arg(long)]
    camera: Option<CameraName>,

    /// The image size, where the file does not say it.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size_of)]
    size: Option<(u32, u32)>,

    /// The mosaic of the cameras.
    #[arg(long, default_value = "BayerRG8")]
    pixel_format: PixelFormat,

    /// The exposure of the cameras, in microseconds.
    #[arg(long, default_value_t = 1000.0, value_name = "US", allow_negative_numbers = true,
          value_parser = super::between(1.0, 1e6, "microseconds"))]
    exposure_us: f64,
}

#[derive(Debug, clap::Args)]
struct ExportArgs {
    /// The rig file.
    rig: PathBuf,

    /// The format: opencv, ros, kalibr, parameters or json.
    #[arg(long)]
    format: Format,

    /// The camera, for formats that hold one.
    #[arg(long)]
    camera: Option<CameraName>,

    /// The file to write [default: standard output].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn size_of(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once(['x', '×']).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    parsed.ok_or_else(|| format!("{text:?} is no image size; give it as 1920x1200"))
}

/// Runs `netcord rig`.
pub fn run(args: &Args) -> CommandResult {
    match &args.action {
        Action::Show { rig } => show(&Rig::load(rig)?),
        Action::Import(args) => import(args)?,
        Action::Export(args) => export(args)?,
        Action::Clean(rig) => clean(&rig.load_for_pictures()?.1)?,
    }
    Ok(Outcome::Good)
}

/// The domain, and that in which a synthetic source tells the truth.
fn clean(domain: &DomainName) -> Result<(), Box<dyn Error>> {
    let remains = [domain.clone(), truth_domain(domain)?].map(|domain| DomainRemains::of(&domain));
    for remains in &remains {
        let alive = remains.inhabitants()?;
        if !alive.is_empty() {
            return Err(
                format!("the domain {domain} is in use by {}: stop it first", alive.join(", ")).into()
            );
        }
    }
    let mut removed = 0;
    for remains in &remains {
        removed += remains.remove()?;
    }
    println!("{domain}: {removed} files removed from shared memory");
    Ok(())
}

fn show(rig: &Rig) {
    println!(
        "{}: {} cameras at {} Hz, results in the {} frame",
        rig.name,
        rig.cameras.len(),
        rig.rate_hz,
        rig.world
    );
    for camera in &rig.cameras {
        let centre = camera.camera_from_world.origin().coords;
        println!(
            "  {:<12} {} × {} {}  f {:.1} × {:.1} px  at ({:+.3}, {:+.3}, {:+.3}) m",
            camera.name.as_str(),
            camera.model.width,
            camera.model.height,
            camera.pixel_format,
            camera.model.fx,
            camera.model.fy,
            centre.x,
            centre.y,
            centre.z
        );
        if let Some(ball) = &camera.ball {
            let [least, most] = ball.diameter_px;
            println!("  {:<12} knows the ball's colour, learnt from balls of {least:.0} to {most:.0} px", "");
        }
    }
    println!("  ball: {:.1} mm, {:?}", rig.ball.diameter_m * 1e3, rig.ball.colour);
    if rig.world == WorldFrame::Table {
        println!("  table: its frame is that of results");
    } else {
        println!("  table: not calibrated (`netcord calib table`)");
    }
    for doubt in doubts(rig) {
        tracing::warn!("{doubt}");
    }
}

/// What is valid, but can hardly be meant.
fn doubts(rig: &Rig) -> Vec<String> {
    let mut doubts = Vec::new();
    let interval_ns = rig.interval_ns();
    for (place, camera) in rig.cameras.iter().enumerate() {
        let name = &camera.name;
        if camera.exposure_ns >= interval_ns {
            doubts.push(format!(
                "camera {name}: an exposure of {} µs does not fit into the {} µs between two frames at {} Hz",
                camera.exposure_ns / 1000,
                interval_ns / 1000,
                rig.rate_hz
            ));
        }
        let (width, height) = (camera.model.width, camera.model.height);
        if camera.pixel_format != PixelFormat::Mono8 && (width % 2 == 1 || height % 2 == 1) {
            doubts
                .push(format!("camera {name}: {width} × {height} px cut the cells of a Bayer mosaic apart"));
        }
        let centre = camera.camera_from_world.origin();
        let near =
            |other: &&RigCamera| (other.camera_from_world.origin().coords - centre.coords).norm() < 1e-3;
        if let Some(other) = rig.cameras[..place].iter().find(near) {
            doubts.push(format!("cameras {} and {name} stand at one place: they give no depth", other.name));
        }
    }
    doubts
}

fn import(args: &ImportArgs) -> Result<(), Box<dyn Error>> {
    let text =
        fs::read_to_string(&args.file).map_err(|e| format!("cannot read {}: {e}", args.file.display()))?;
    let mut set = exchange::read(&text, &args.file, args.format, args.size)?;
    if let Some(name) = &args.camera {
        let [camera] = &mut set.cameras[..] else {
            let count = set.cameras.len();
            return Err(
                format!("--camera names one camera, but {} holds {count}", args.file.display()).into()
            );
        };
        camera.name = name.clone();
    }
    let mut edit = if args.update {
        RigEdit::open(&args.out)?
    } else {
        let name = args.name.clone().map_or_else(|| name_of(&args.out), Ok)?;
        RigEdit::create(&args.out, name.as_str())
    };
    set.write_into(
        &mut edit,
        &ImportDefaults { pixel_format: args.pixel_format, exposure_us: args.exposure_us },
    );
    // What has been imported may be a part: the rest may follow with --update.
    match edit.resolve() {
        Ok(rig) => show(&rig),
        Err(e) => println!("not complete yet: {e}"),
    }
    edit.save()?;
    println!("written to {}", args.out.display());
    Ok(())
}

fn name_of(path: &Path) -> Result<DomainName, Box<dyn Error>> {
    let stem = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    DomainName::new(stem).map_err(|e| format!("{e}; give the rig another name with --name").into())
}

fn export(args: &ExportArgs) -> Result<(), Box<dyn Error>> {
    let rig = Rig::load(&args.rig)?;
    let text = exchange::write(&rig, args.format, args.camera.as_ref())?;
    match &args.out {
        Some(path) => Plan::of([&args.rig]).begin(path)?.write(text)?,
        None => print!("{text}"),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_can_hardly_be_meant_is_told() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
        let mut rig = Rig::load(&path).expect("an example rig");
        assert_eq!(doubts(&rig), Vec::<String>::new());
        rig.cameras[0].exposure_ns = 20_000_000;
        rig.cameras[1].model.width += 1;
        rig.cameras[1].camera_from_world = rig.cameras[0].camera_from_world;
        let told = doubts(&rig);
        for (said, part) in told.iter().zip(["20000 µs does not fit", "Bayer mosaic", "at one place"]) {
            assert!(said.contains(part), "{said}");
        }
        assert_eq!(told.len(), 3, "{told:?}");
    }
}
