//! What the commands that work on a calibrated rig have in common: its cameras in the first one's frame.

use std::{error::Error, path::Path};

use netcord_calib::table::{Table, TableCamera};
use netcord_common::{
    geometry::{Transform, World},
    rig::{Rig, RigEdit},
    wire::WorldFrame,
};

/// A rig file's cameras in the first one's frame, and the table where the file has one.
pub struct CalibratedRig {
    /// Cameras in the file's order; `World` is the first camera's frame.
    pub cameras: Vec<TableCamera>,
    /// How much later than stamped each camera's frames are exposed, s; 0 where the file says nothing.
    pub later_s: Vec<f64>,
    /// The table, where the file has one.
    pub first_from_table: Option<Transform<World, Table>>,
    /// The ball's radius, m.
    pub ball_radius_m: f64,
}

impl CalibratedRig {
    /// Reads a rig file of which at least the cameras are calibrated.
    pub fn load(path: &Path) -> Result<Self, Box<dyn Error>> {
        let rig = Rig::load(path)?;
        let mut without_table = RigEdit::open(path)?;
        without_table.document_mut().remove("table");
        let in_first = without_table.resolve()?;
        let cameras = in_first
            .cameras
            .iter()
            .map(|c| TableCamera {
                name: c.name.to_string(),
                model: c.model,
                camera_from_first: c.camera_from_world,
            })
            .collect::<Vec<_>>();
        let later_s = rig.cameras.iter().map(|c| c.clock_delay.map_or(0.0, |d| d.delay_s)).collect();
        let first_from_table = (rig.world == WorldFrame::Table).then(|| {
            let (of_first, of_table) =
                (&in_first.cameras[0].camera_from_world, &rig.cameras[0].camera_from_world);
            let both = &of_first.inverse() * of_table;
            Transform::new(both.rotation, both.translation)
        });
        Ok(Self { cameras, later_s, first_from_table, ball_radius_m: rig.ball.radius_m() })
    }

    /// The place of the camera called `name`.
    pub fn place(&self, name: &str) -> Result<usize, String> {
        self.cameras.iter().position(|c| c.name == name).ok_or_else(|| {
            let names: Vec<&str> = self.cameras.iter().map(|c| c.name.as_str()).collect();
            format!("the rig has no camera {name:?}; it has {}", names.join(", "))
        })
    }
}
