//! `netcord doctor`: what about this machine would break real time, and the cure.

use std::path::{Path, PathBuf};

use netcord_common::rig::{Rig, RigEdit};

use crate::{
    doctor::{Grade, examine, memory_needed},
    exit::{CommandResult, Outcome},
};

/// Arguments of `netcord doctor`.
///
/// Exit codes: 0 nothing stands in the way; 1 something is a risk or broken, with its cure; 2 an error.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig that shall run here, to see whether its frames fit the machine's shared memory.
    #[arg(long, env = "NETCORD_RIG", value_name = "RIG.toml")]
    rig: Option<PathBuf>,
}

/// Runs `netcord doctor`.
pub fn run(args: &Args) -> CommandResult {
    // Machines are looked over before cameras are calibrated.
    let nominal = |path| RigEdit::open(path)?.with_nominal_calibration().resolve();
    let rig: Option<Rig> = args.rig.as_deref().map(nominal).transpose()?;
    if let Some(rig) = &rig {
        println!("{}: frames may take up to {} MB of shared memory", rig.name, memory_needed(rig) >> 20);
    }
    let findings = examine(Path::new("/"), rig.as_ref());
    for finding in &findings {
        println!("{:<7} {:<23} {}", finding.grade.name(), finding.what, finding.found);
        if !finding.cure.is_empty() {
            println!("{:<31} cure: {}", "", finding.cure);
        }
    }
    let good = findings.iter().all(|f| f.grade == Grade::Good);
    Ok(if good { Outcome::Good } else { Outcome::Missed })
}
