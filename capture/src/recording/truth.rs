use std::collections::BTreeMap;

use netcord_common::{rig::Rig, wire::BallTruth};
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
}
