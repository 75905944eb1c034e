//! `netcord cameras`: what is plugged in, and the features of each.

use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use netcord_capture::usb::{
    Camera, FeatureAccess, UDEV_RULE, UDEV_RULE_PATH, UsbOptions, UsbSource, discover,
    genapi::{Access, FeatureInfo, FeatureType},
    usb_context,
};
use netcord_common::{
    CameraName, Channel, Counters, DomainName, FrameView, PixelFormat, Shutdown,
    bus::{Bus, FrameSubscriber, Topic},
    picture::{Effort, Picture},
    rig::Rig,
};

use crate::exit::{CommandResult, Outcome};

/// List USB3 Vision cameras, read and set their features, save and load them, and look through a camera.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// List the cameras: maker, model, serial number, version, speed, and whether they can be opened.
    List {
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
    /// Print the values of features.
    Get {
        #[command(flatten)]
        which: Which,
        /// The features, by their GenICam names.
        #[arg(required = true)]
        names: Vec<String>,
    },
    /// Set features, or carry commands out: `Gain=3 ExposureTime=1000 TriggerSoftware`.
    Set {
        #[command(flatten)]
        which: Which,
        /// What to set.
        #[arg(required = true, value_name = "NAME=VALUE")]
        settings: Vec<String>,
    },
    /// Print all features with type, access, value, range and unit.
    Features {
        #[command(flatten)]
        which: Which,
        /// Only those whose name holds this.
        #[arg(default_value = "")]
        filter: String,
    },
    /// Save all features that can be set to a file of lines NAME=VALUE.
    Save {
        #[command(flatten)]
        which: Which,
        /// The file.
        file: PathBuf,
    },
    /// Set all features that a file names.
    Load {
        #[command(flatten)]
        which: Which,
        /// The file.
        file: PathBuf,
    },
    /// Write one picture of a camera as a PNG file, to see exposure, focus and the true mosaic.
    Preview {
        /// The rig file.
        #[arg(long, env = "NETCORD_RIG", value_name = "RIG.toml")]
        rig: PathBuf,
        /// The camera's name in the rig file.
        #[arg(long, value_name = "NAME")]
        camera: CameraName,
        /// Take the frame from the capture that runs in this domain, in place of opening the camera.
        #[arg(long, env = "NETCORD_DOMAIN", value_name = "NAME")]
        domain: Option<DomainName>,
        /// See the mosaic as this format, in place of what the rig file says: where red and blue look right is
        /// the true one.
        #[arg(long, value_name = "FORMAT")]
        format: Option<PixelFormat>,
        /// The picture.
        #[arg(short, long, value_name = "PNG")]
        output: PathBuf,
    },
    /// Print the shell commands that install the udev rule: `netcord cameras udev | sudo sh`.
    Udev,
}

#[derive(Debug, Clone, clap::Args)]
struct Which {
    /// Serial number or GUID of the camera; not needed where there is only one.
    #[arg(long, default_value = "", value_name = "SERIAL")]
    serial: String,
}

impl Which {
    fn open(&self) -> Result<Camera, Box<dyn Error>> {
        Ok(Camera::open(&usb_context()?, &self.serial)?)
    }
}

/// Runs `netcord cameras`.
pub fn run(args: &Args) -> CommandResult {
    match &args.action {
        Action::List { json } => list(*json),
        Action::Get { which, names } => {
            let mut camera = which.open()?;
            for name in names {
                println!("{name} = {}", camera.get(name)?);
            }
            Ok(Outcome::Good)
        }
        Action::Set { which, settings } => {
            let mut camera = which.open()?;
            settings.iter().try_for_each(|setting| set(&mut camera, setting))?;
            Ok(Outcome::Good)
        }
        Action::Features { which, filter } => features(&mut which.open()?, filter),
        Action::Save { which, file } => save(&mut which.open()?, file),
        Action::Load { which, file } => load(&mut which.open()?, file),
        Action::Preview { rig, camera, domain, format, output } => {
            preview(&Rig::load(rig)?, camera, domain.as_ref(), *format, output)
        }
        Action::Udev => {
            println!("cat > {UDEV_RULE_PATH} <<'END'\n{UDEV_RULE}END");
            println!("udevadm control --reload-rules && udevadm trigger --subsystem-match=usb");
            Ok(Outcome::Good)
        }
    }
}

fn list(json: bool) -> CommandResult {
    let found = discover(&usb_context()?)?;
    if json {
        println!("{}", serde_json::to_string_pretty(&found)?);
        return Ok(Outcome::Good);
    }
    for c in &found.cameras {
        let access = c.access.as_ref().map_or_else(String::as_str, |()| "ready");
        println!(
            "{} {}  serial {}  version {}  {} Mb/s  bus {:03} device {:03}  {access}",
            c.vendor, c.model, c.serial, c.version, c.speed_mbps, c.place.0, c.place.1
        );
    }
    for other in &found.others {
        println!(
            "{} ({:04x}:{:04x}) is no USB3 Vision camera: {}",
            other.vendor, other.usb_id.0, other.usb_id.1, other.reason
        );
    }
    if found.cameras.is_empty() {
        println!("no USB3 Vision camera is plugged in");
        return Ok(Outcome::Missed);
    }
    Ok(Outcome::Good)
}

fn set(camera: &mut Camera, setting: &str) -> Result<(), Box<dyn Error>> {
    match setting.split_once('=') {
        Some((name, value)) => {
            camera.set(name.trim(), value.trim())?;
            let now = camera.get(name.trim()).map_or_else(|_| value.to_owned(), |v| v.to_string());
            println!("{} = {now}", name.trim());
        }
        None => {
            camera.execute(setting.trim())?;
            println!("{} done", setting.trim());
        }
    }
    Ok(())
}

fn describe(info: &FeatureInfo, value: &str) -> String {
    let mut line = format!("{:<32} {:<11} {}", info.name, info.kind.name(), info.access.name());
    if !value.is_empty() {
        line += &format!("  {value}");
    }
    if let Some(unit) = &info.unit {
        line += &format!(" {unit}");
    }
    if let Some(range) = &info.range {
        line += &format!("  [{} … {}", range.min, range.max);
        line += &range.increment.filter(|i| *i > 1).map_or("]".to_owned(), |i| format!(", step {i}]"));
    }
    if !info.entries.is_empty() {
        line += &format!("  {{{}}}", info.entries.join(", "));
    }
    line
}

fn features(camera: &mut Camera, filter: &str) -> CommandResult {
    let filter = filter.to_lowercase();
    for (category, names) in camera.features() {
        let chosen: Vec<&String> = names.iter().filter(|n| n.to_lowercase().contains(&filter)).collect();
        if chosen.is_empty() {
            continue;
        }
        println!("{category}");
        for name in chosen {
            match camera.info(name) {
                Ok(info) => {
                    let value = if info.access.readable() && info.kind != FeatureType::Command {
                        camera.get(name).map_or_else(|e| format!("({e})"), |v| v.to_string())
                    } else {
                        String::new()
                    };
                    println!("  {}", describe(&info, &value));
                }
                Err(e) => println!("  {name:<32} ({e})"),
            }
        }
    }
    Ok(Outcome::Good)
}

fn save(camera: &mut Camera, file: &Path) -> CommandResult {
    let mut lines = vec![format!(
        "# {} {}, serial {}",
        camera.abrm().manufacturer,
        camera.abrm().model,
        camera.abrm().serial
    )];
    for (_, names) in camera.features() {
        for name in names {
            let Ok(info) = camera.info(&name) else { continue };
            let settable = info.access == Access::ReadWrite && info.kind != FeatureType::Command;
            if let (true, Ok(value)) = (settable, camera.get(&name)) {
                lines.push(format!("{name}={value}"));
            }
        }
    }
    crate::output::write(file, lines.join("\n") + "\n")?;
    println!("{} features saved to {}", lines.len() - 1, file.display());
    Ok(Outcome::Good)
}

fn load(camera: &mut Camera, file: &Path) -> CommandResult {
    let text = fs::read_to_string(file).map_err(|e| format!("{} cannot be read: {e}", file.display()))?;
    let (mut done, mut failed) = (0, 0);
    for (number, line) in text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())) {
        let Some((name, value)) = line.split_once('=').filter(|_| !line.starts_with('#')) else { continue };
        match camera.set(name.trim(), value.trim()) {
            Ok(()) => done += 1,
            Err(e) => {
                failed += 1;
                println!("{}:{number}: {e}", file.display());
            }
        }
    }
    println!("{done} features set, {failed} refused");
    Ok(if failed == 0 { Outcome::Good } else { Outcome::Missed })
}

fn preview(
    rig: &Rig,
    camera: &CameraName,
    domain: Option<&DomainName>,
    format: Option<PixelFormat>,
    output: &Path,
) -> CommandResult {
    let known = rig.camera(camera).ok_or_else(|| format!("the rig has no camera {camera}"))?;
    let picture = match domain {
        Some(domain) => next_picture(&Bus::join(domain, "cameras")?, camera, format)?,
        None => {
            let mut alone = rig.clone();
            alone.cameras = vec![known.clone()];
            alone.cameras[0].index = netcord_common::rig::CameraIndex::new(0).ok_or("no camera")?;
            let domain = DomainName::new(format!("preview-{}", std::process::id()))?;
            let bus = Bus::join(&domain, "cameras")?;
            let counters = Counters::new();
            let mut source = UsbSource::new(&alone, UsbOptions::default(), &counters)?;
            let stop = Shutdown::new();
            thread::scope(|scope| {
                let capture =
                    scope.spawn(|| netcord_capture::run(&bus, &alone, &mut source, &stop, &counters));
                let picture = next_picture(&bus, camera, format);
                stop.request();
                match capture.join() {
                    Ok(ended) => ended?,
                    Err(panic) => std::panic::resume_unwind(panic),
                }
                picture
            })?
        }
    };
    picture.write_png(output, Effort::Small)?;
    println!("{} × {} px written to {}", picture.width(), picture.height(), output.display());
    Ok(Outcome::Good)
}

fn next_picture(
    bus: &Bus,
    camera: &CameraName,
    format: Option<PixelFormat>,
) -> Result<Picture, Box<dyn Error>> {
    let reader = FrameSubscriber::open(bus, &Topic::frames(camera), 2)?;
    let until = Instant::now() + Duration::from_secs(10);
    // The first frames are exposed before the settings are in force.
    let mut skipped = 0;
    while Instant::now() < until {
        reader.wait(Duration::from_millis(100))?;
        while let Some(frame) = reader.receive()? {
            skipped += 1;
            if skipped < 4 {
                continue;
            }
            let mut header = *frame.header();
            if let Some(format) = format {
                header.pixel_format = format.pfnc();
            }
            return Ok(binned(&FrameView::of(&header, frame.bytes())?));
        }
    }
    Err(format!("no frame of {camera} came within 10 s").into())
}

/// A colour picture of half the size: each 2 × 2 cell of the mosaic is one pixel.
fn binned(view: &FrameView<'_>) -> Picture {
    Picture::rgb_from((view.width() / 2, view.height() / 2), |x, y| {
        let (mut sum, mut count) = ([0_u32; 3], [0_u32; 3]);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (px, py) = (x * 2 + dx, y * 2 + dy);
            let value = u32::from(view.row(py)[px]);
            let channels: &[usize] = match view.format().channel_at(px, py) {
                Channel::Red => &[0],
                Channel::Green => &[1],
                Channel::Blue => &[2],
                Channel::Luma => &[0, 1, 2],
            };
            for c in channels {
                sum[*c] += value;
                count[*c] += 1;
            }
        }
        [0, 1, 2].map(|c| (sum[c] / count[c].max(1)) as u8)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mosaic_seen_as_the_wrong_format_swaps_red_and_blue() {
        // Red 200, green 100, blue 50.
        let bytes = [200, 100, 200, 100, 100, 50, 100, 50];
        let seen = |format| {
            let view = FrameView::new(&bytes, (4, 2), 4, format).expect("an image");
            binned(&view).pixel(1, 0).to_vec()
        };
        assert_eq!(seen(PixelFormat::BayerRG8), [200, 100, 50]);
        assert_eq!(seen(PixelFormat::BayerBG8), [50, 100, 200]);
    }
}
