//! `netcord rig`: checks a rig file and shows what it says.

use std::path::PathBuf;

use clap::Subcommand;
use netcord_common::rig::Rig;

use crate::exit::{CommandResult, Outcome};

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
}

/// Runs `netcord rig`.
pub fn run(args: &Args) -> CommandResult {
    match &args.action {
        Action::Show { rig } => {
            let rig = Rig::load(rig)?;
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
            }
            Ok(Outcome::Good)
        }
    }
}
