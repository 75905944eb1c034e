use std::{fs, path::Path};

use super::{
    Ball, FlightConstants, HittingPlane, ProcessSpec, RigCamera, RigError, file::RigFile, resolve::Source,
};
use crate::{
    name::{CameraName, DomainName},
    wire::WorldFrame,
};

/// A complete and consistent system.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// The rig's name, and the default domain of its processes.
    pub name: DomainName,
    /// Exposures a second.
    pub rate_hz: f64,
    /// Largest difference between the exposures of one trigger, ns.
    pub tolerance_ns: u64,
    /// The ball.
    pub ball: Ball,
    /// What the world frame is: the table's where a table pose is known.
    pub world: WorldFrame,
    /// The cameras, in the file's order.
    pub cameras: Vec<RigCamera>,
    /// Constants of the flight.
    pub flight: FlightConstants,
    /// Where the ball can be hit.
    pub hitting_plane: HittingPlane,
    /// What `netcord up` starts.
    pub processes: Vec<ProcessSpec>,
}

impl Rig {
    /// Reads and checks a rig file.
    ///
    /// # Errors
    /// [`RigError`] names file, line and key.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        let text = fs::read_to_string(path).map_err(|cause| RigError::File {
            doing: "read",
            path: path.to_owned(),
            cause,
        })?;
        Self::parse(&text, path)
    }

    /// Checks the text of a rig file; `path` is what errors call it.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, RigError> {
        let source = Source { text, path };
        let file: RigFile = toml::from_str(text)
            .map_err(|e| source.error(e.span().unwrap_or_default(), e.message().trim()))?;
        source.resolve(&file)
    }

    /// The camera called `name`.
    pub fn camera(&self, name: &CameraName) -> Option<&RigCamera> {
        self.cameras.iter().find(|c| c.name == *name)
    }

    /// Bits of all cameras, as in messages.
    pub fn camera_mask(&self) -> u32 {
        self.cameras.iter().fold(0, |mask, c| mask | c.index.bit())
    }

    /// Time from one trigger to the next, ns.
    pub fn interval_ns(&self) -> u64 {
        interval_ns(self.rate_hz)
    }
}

/// Time between two of so many triggers a second, ns.
pub(super) fn interval_ns(rate_hz: f64) -> u64 {
    (1e9 / rate_hz).round() as u64
}
