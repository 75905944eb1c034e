//! One file a subcommand: its `Args`, and `run`.

pub mod bench;
pub mod calib;
pub mod cameras;
pub mod capture;
pub mod compare;
pub mod control;
pub mod demo;
pub mod doctor;
pub mod import;
pub mod latency;
pub mod listen;
pub mod plot;
pub mod predict;
pub mod process;
pub mod record;
pub mod recover;
pub mod rig;
pub mod segment;
pub mod triangulate;
pub mod up;
pub mod view;

use std::path::PathBuf;

use netcord_common::{
    CameraName, DomainName,
    rig::{Rig, RigEdit, RigError},
};

/// A length of time on the command line, in seconds.
///
/// # Errors
/// What is valid.
pub fn seconds(text: &str) -> Result<f64, String> {
    let valid = |s: &f64| (0.0..=LONGEST_S).contains(s);
    text.parse()
        .ok()
        .filter(valid)
        .ok_or_else(|| format!("valid are 0 to {LONGEST_S} seconds, such as 10 or 0.5"))
}

/// A parser of numbers on the command line, from `low` to `high`, in the option's own unit.
pub fn between(
    low: f64,
    high: f64,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number = text.parse().ok().filter(|number| (low..=high).contains(number));
        number.ok_or_else(|| format!("valid are {low} to {high} {unit}"))
    }
}

/// A month.
const LONGEST_S: f64 = 31.0 * 86_400.0;

/// A file to be written on the command line: its folder is there, so that no long work is done in vain.
///
/// # Errors
/// The folder that is missing, or where a folder was given itself.
pub fn file_to_write(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    if path.is_dir() || path.file_name().is_none() {
        return Err("this is a folder; give the name of a file".to_owned());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder.filter(|folder| !folder.is_dir()) {
        Some(folder) => Err(format!("there is no folder {}; make it first", folder.display())),
        None => Ok(path),
    }
}

/// The options of every subcommand that touches a live rig.
#[derive(Debug, Clone, clap::Args)]
pub struct RigArgs {
    /// The rig file.
    #[arg(long, env = "NETCORD_RIG", value_name = "RIG.toml")]
    pub rig: PathBuf,

    /// The domain in which the rig's processes meet; default: the rig's name.
    #[arg(long, env = "NETCORD_DOMAIN", value_name = "NAME")]
    pub domain: Option<DomainName>,
}

/// The options of those that serve or mean one camera of a live rig, or all.
#[derive(Debug, Clone, clap::Args)]
pub struct CameraArgs {
    #[command(flatten)]
    pub rig: RigArgs,

    /// This camera only, by its name in the rig file; default: all of them.
    #[arg(long, value_name = "NAME")]
    pub camera: Option<CameraName>,
}

impl RigArgs {
    /// Loads the rig file, and settles the domain.
    ///
    /// # Errors
    /// As [`Rig::load`].
    pub fn load(&self) -> Result<(Rig, DomainName), RigError> {
        let rig = Rig::load(&self.rig)?;
        let domain = self.domain.clone().unwrap_or_else(|| rig.name.clone());
        Ok((rig, domain))
    }

    /// As [`Self::load`], but for taking pictures only: cameras that are not calibrated yet get a nominal lens and
    /// place.
    ///
    /// # Errors
    /// As [`Rig::load`], for all that has nothing to do with calibration.
    pub fn load_for_pictures(&self) -> Result<(Rig, DomainName), RigError> {
        let rig = RigEdit::open(&self.rig)?.with_nominal_calibration().resolve()?;
        let domain = self.domain.clone().unwrap_or_else(|| rig.name.clone());
        Ok((rig, domain))
    }
}
