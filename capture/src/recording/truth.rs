use std::collections::BTreeMap;

use nalgebra::Vector2;
use netcord_common::{
    geometry::Point,
    rig::{Rig, RigCamera},
    wire::{BallTruth, CameraTruth},
};
use serde::{Deserialize, Serialize};

/// One message of `/truth/ball`: what the synthetic source knows of one trigger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordedTruth {
    /// The trigger.
    #[serde(default)]
    pub trigger_id: u64,
    /// Middle of the exposure, ns.
    #[serde(alias = "mid_exposure_ns", alias = "timestamp_ns")]
    pub t_ns: u64,
    /// Whether there is a ball in the scene.
    #[serde(default = "yes")]
    pub present: bool,
    /// Counts flights from 1.
    #[serde(default)]
    pub flight_id: u64,
    /// Position in the table frame, m.
    #[serde(alias = "position")]
    pub position_m: [f64; 3],
    /// Velocity, m/s.
    #[serde(default, alias = "velocity")]
    pub velocity_m_s: [f64; 3],
    /// Spin, rad/s.
    #[serde(default, alias = "spin")]
    pub spin_rad_s: [f64; 3],
    /// The ball's image in each camera, by the camera's name.
    #[serde(default)]
    pub cameras: BTreeMap<String, RecordedView>,
}

/// The ball's true image in one camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RecordedView {
    /// Image of the ball's centre, x, px.
    #[serde(alias = "u")]
    pub u_px: f64,
    /// Image of the ball's centre, y, px.
    #[serde(alias = "v")]
    pub v_px: f64,
    /// Share of the ball's image that is to be seen, 0–1.
    pub visible: f64,
}

const fn yes() -> bool {
    true
}

impl RecordedTruth {
    /// The truth of the bus, with the names of `rig`'s cameras.
    pub fn of(truth: &BallTruth, rig: &Rig) -> Self {
        let view = |i: usize| {
            let camera = &truth.cameras[i];
            RecordedView { u_px: camera.u_px, v_px: camera.v_px, visible: camera.visible }
        };
        Self {
            trigger_id: truth.trigger_id,
            t_ns: truth.mid_exposure_ns,
            present: truth.present != 0,
            flight_id: truth.flight_id,
            position_m: truth.position_m,
            velocity_m_s: truth.velocity_m_s,
            spin_rad_s: truth.spin_rad_s,
            cameras: rig.cameras.iter().map(|c| (c.name.to_string(), view(c.index.get()))).collect(),
        }
    }

    /// The truth as it would stand on the bus, for the trigger `trigger_id` of `rig`. Where the recording says
    /// nothing of what cameras saw, a ball whose centre is inside the image counts as seen.
    pub fn on_bus(&self, trigger_id: u64, rig: &Rig) -> BallTruth {
        let mut truth = BallTruth {
            trigger_id,
            mid_exposure_ns: self.t_ns,
            flight_id: self.flight_id,
            position_m: self.position_m,
            velocity_m_s: self.velocity_m_s,
            spin_rad_s: self.spin_rad_s,
            present: u32::from(self.present),
            ..BallTruth::default()
        };
        for camera in &rig.cameras {
            let recorded = self.cameras.get(camera.name.as_str());
            truth.cameras[camera.index.get()] = match recorded {
                Some(view) => CameraTruth { u_px: view.u_px, v_px: view.v_px, visible: view.visible },
                None if self.cameras.is_empty() => self.seen_by(camera),
                None => CameraTruth::default(),
            };
        }
        truth
    }

    fn seen_by(&self, camera: &RigCamera) -> CameraTruth {
        let [x, y, z] = self.position_m;
        let in_camera = &camera.camera_from_world * Point::new(x, y, z);
        let inside = |pixel: &Vector2<f64>| camera.model.contains(pixel);
        camera.model.project(&in_camera).filter(inside).map_or_else(CameraTruth::default, |pixel| {
            CameraTruth { u_px: pixel.x, v_px: pixel.y, visible: 1.0 }
        })
    }
}
