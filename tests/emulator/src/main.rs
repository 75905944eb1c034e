//! Emulated USB3 Vision cameras over USB/IP: `usbip attach -r HOST -b 1-1`.

use std::{env, net::TcpListener, path::Path, process::ExitCode};

use netcord_emulator::{
    Camera, CameraConfig, FaultPlan, ImageSource, LinkSpeed, PatternImages, Rig, StampAt, Wire,
    footage::Footage, usbip,
};

const USAGE: &str = "netcord-emulator [--cameras N] [--size WxH] [--port P] [--wires] [--high-speed] \
                     [--left-enabled] [--stamp-end] [--deep-only] [--not-vision] [--faults PLAN] [--footage FILE]\n\
                     --wires: camera 0 strobes line 1, which is line 0 of all others";

struct Options {
    cameras: usize,
    config: CameraConfig,
    port: u16,
    wires: bool,
    footage: Option<Footage>,
}

fn options(mut words: impl Iterator<Item = String>) -> Result<Options, String> {
    let mut o =
        Options { cameras: 1, config: CameraConfig::default(), port: 3240, wires: false, footage: None };
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or(format!("{word} wants a value\n{USAGE}"));
        match word.as_str() {
            "--cameras" => o.cameras = value()?.parse().map_err(|e| format!("--cameras: {e}"))?,
            "--port" => o.port = value()?.parse().map_err(|e| format!("--port: {e}"))?,
            "--size" => {
                let size = value()?;
                let parsed = size.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
                o.config.sensor = parsed.ok_or(format!("--size: {size:?} is not of the form 640x480"))?;
            }
            "--faults" => o.config.faults = value()?.parse::<FaultPlan>().map_err(|e| e.to_string())?,
            "--footage" => {
                let path = value()?;
                o.footage =
                    Some(Footage::open(Path::new(&path)).map_err(|e| format!("--footage: {path}: {e}"))?);
            }
            "--deep-only" => {
                o.config.deep_only = true;
                // BayerRG12p.
                o.config.pixel_format = 0x010C_0059;
            }
            "--not-vision" => {
                o.config.is_vision = false;
                // A maker whose older cameras speak a protocol of their own.
                o.config.usb_id = (0xF622, 0x0001);
            }
            "--wires" => o.wires = true,
            "--high-speed" => o.config.speed = LinkSpeed::High,
            "--left-enabled" => o.config.left_enabled = true,
            "--stamp-end" => o.config.stamp_at = StampAt::End,
            _ => return Err(format!("{word:?} is not known\n{USAGE}")),
        }
    }
    Ok(o)
}

fn run() -> Result<(), String> {
    let o = options(env::args().skip(1))?;
    let cameras = (0..o.cameras)
        .map(|index| {
            let config = CameraConfig {
                serial: format!("{:04}", index + 1),
                // Clocks of different cameras have nothing to do with each other.
                clock_offset_ns: 5_000_000_000 * (index as u64 + 1),
                clock_ppm: 20.0 - 45.0 * index as f64,
                ..o.config.clone()
            };
            let images: Box<dyn ImageSource> = match &o.footage {
                Some(footage) => footage.images(index as u32),
                None => Box::new(PatternImages),
            };
            Camera::new(config, images)
        })
        .collect();
    let wires = if o.wires {
        (1..o.cameras).map(|slave| Wire { from: (0, 1), to: (slave, 0) }).collect()
    } else {
        Vec::new()
    };
    let listener = TcpListener::bind(("127.0.0.1", o.port)).map_err(|e| format!("port {}: {e}", o.port))?;
    usbip::Server::new(Rig { cameras, wires }).serve(&listener).map_err(|e| e.to_string())
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::from(2)
        }
    }
}
