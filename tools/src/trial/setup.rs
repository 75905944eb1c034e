use std::{
    fs,
    path::{Path, PathBuf},
};

use clap::ValueEnum;
use netcord_common::{
    DomainName,
    rig::{Rig, RigEdit},
};
use toml_edit::{Array, ArrayOfTables, Item, Table, value};

use super::TrialError;

/// The example rigs, so that a trial needs no file.
const TWO_CAMERAS: &str = include_str!("../../../common/rigs/example-2cam.toml");
const FOUR_CAMERAS: &str = include_str!("../../../common/rigs/example-4cam.toml");
const EIGHT_CAMERAS: &str = include_str!("../../../common/rigs/example-8cam.toml");

/// How hard the scene makes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Scene {
    /// Table and ball only.
    Clean,
    /// Cluttered background, moving distractors, flicker.
    Normal,
    /// Look-alike balls, colour cast, changing light.
    Hard,
}

impl Scene {
    /// Its name on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Normal => "normal",
            Self::Hard => "hard",
        }
    }
}

/// What a trial runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Cameras, 2 to 8: the example rig of that many, or the first of the example rig of eight.
    pub cameras: usize,
    /// Exposures a second.
    pub rate_hz: f64,
    /// Seconds that are judged.
    pub seconds: f64,
    /// Seconds before that, in which backgrounds are learned.
    pub warm_up_s: f64,
    /// Seed of the scene and the rally.
    pub seed: u64,
    /// The scene.
    pub scene: Scene,
    /// So many frames are rendered beforehand and published round and round, so that the pipeline is measured
    /// and not the renderer.
    pub prerendered: Option<usize>,
    /// More arguments of `netcord capture`, such as its fault switches.
    pub capture_args: Vec<String>,
    /// Attach `netcord record` with this file.
    pub record: Option<PathBuf>,
    /// Attach `netcord view` on this port of this machine.
    pub view: Option<u16>,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            cameras: 2,
            rate_hz: 100.0,
            seconds: 20.0,
            warm_up_s: 2.0,
            seed: 1,
            scene: Scene::Normal,
            prerendered: None,
            capture_args: Vec::new(),
            record: None,
            view: None,
        }
    }
}

/// The text of the smallest example rig that has `cameras` cameras.
fn example(cameras: usize) -> Result<&'static str, TrialError> {
    match cameras {
        2 => Ok(TWO_CAMERAS),
        3 | 4 => Ok(FOUR_CAMERAS),
        5..=8 => Ok(EIGHT_CAMERAS),
        other => Err(TrialError::Setup(format!("{other} cameras: there are example rigs of 2 to 8"))),
    }
}

/// The example rig of `cameras` cameras: 2, 4 or 8.
///
/// # Errors
/// [`TrialError::Setup`] for other numbers.
pub fn example_rig(cameras: usize) -> Result<Rig, TrialError> {
    Ok(Rig::parse(example(cameras)?, Path::new("example rig"))?)
}

impl Setup {
    /// Writes the rig file of this trial into `folder`.
    ///
    /// # Errors
    /// [`TrialError`] when it cannot be written, or the setup fits no example rig.
    pub(super) fn write_rig(&self, folder: &Path, domain: &DomainName) -> Result<PathBuf, TrialError> {
        let text = example(self.cameras)?;
        let path = folder.join("rig.toml");
        fs::write(&path, text).map_err(|e| TrialError::file(&path, e))?;
        let mut edit = RigEdit::open(&path)?;
        let document = edit.document_mut();
        document["name"] = value(domain.as_str());
        document["rate_hz"] = value(self.rate_hz);
        // The examples' tolerance is too wide for very high rates; without the key it is half an interval.
        let tolerance_us = document.get("tolerance_us").and_then(Item::as_float).unwrap_or(0.0);
        if tolerance_us > 0.5e6 / self.rate_hz {
            document.remove("tolerance_us");
        }
        if let Some(cameras) = document.get_mut("camera").and_then(Item::as_array_of_tables_mut) {
            while cameras.len() > self.cameras {
                cameras.remove(cameras.len() - 1);
            }
        }
        document["process"] = Item::ArrayOfTables(self.processes());
        edit.save()?;
        Ok(path)
    }

    fn processes(&self) -> ArrayOfTables {
        let mut capture = vec!["--source".to_owned(), "synthetic".into()];
        capture.extend(["--seed".into(), self.seed.to_string()]);
        capture.extend(["--scene".into(), self.scene.name().into()]);
        if let Some(frames) = self.prerendered {
            capture.extend(["--prerendered".into(), frames.to_string()]);
        }
        capture.extend(self.capture_args.iter().cloned());
        let mut processes = ArrayOfTables::new();
        processes.push(process("capture", capture));
        for stage in ["segment", "triangulate", "predict"] {
            processes.push(process(stage, Vec::new()));
        }
        if let Some(file) = &self.record {
            processes.push(process("record", vec![file.display().to_string()]));
        }
        if let Some(port) = self.view {
            processes.push(process("view", vec!["--port".into(), port.to_string()]));
        }
        processes
    }
}

fn process(command: &str, arguments: Vec<String>) -> Table {
    let mut table = Table::new();
    table["command"] = value(command);
    table["args"] = value(Array::from_iter(arguments));
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_size_and_rate_gives_a_valid_rig() {
        let folder = tempfile::tempdir().expect("a folder");
        let domain = DomainName::new("trial").expect("valid");
        for (cameras, rate_hz) in [(2, 100.0), (3, 50.0), (6, 800.0), (8, 250.0)] {
            let setup = Setup { cameras, rate_hz, ..Setup::default() };
            let rig = Rig::load(&setup.write_rig(folder.path(), &domain).expect("written")).expect("valid");
            assert_eq!((rig.cameras.len(), rig.rate_hz), (cameras, rate_hz));
            assert!(rig.tolerance_ns * 2 <= rig.interval_ns() + 1);
            assert_eq!(rig.processes[0].args[..4], ["--source", "synthetic", "--seed", "1"]);
        }
        let error =
            Setup { cameras: 9, ..Setup::default() }.write_rig(folder.path(), &domain).expect_err("too many");
        assert!(error.to_string().contains("2 to 8"));
    }
}
