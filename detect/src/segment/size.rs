use netcord_common::{
    rig::{Rig, RigCamera},
    wire::WorldFrame,
};

/// Smallest diameter that is looked for, px.
pub const LEAST_DIAMETER_PX: f32 = 3.0;

/// The largest diameter that is looked for, px: this one in every camera; where a long lens or a large ball makes
/// the usual one large, [`NEAR`] times as much, up to the second one, beyond which a blurred ball is half a picture.
const MOST_DIAMETER_PX: (f32, f32) = (75.0, 120.0);

/// How much larger than over the table's middle the ball may look: at half the distance.
const NEAR: f32 = 2.0;

/// Usual diameter where no table is known, px: that of rigs with wide lenses around a table.
const USUAL_DIAMETER_PX: f32 = 18.0;

/// How large the ball looks in a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallSize {
    /// Its diameter over the middle of the table, px.
    pub usual_px: f32,
    /// Its diameter at most, px.
    pub most_px: f32,
}

impl BallSize {
    /// In a camera of a rig.
    pub fn of(rig: &Rig, camera: &RigCamera) -> Self {
        let focal = (camera.model.fx * camera.model.fy).sqrt();
        let usual_px = match rig.world {
            WorldFrame::Table => {
                // Where the camera sees the table's middle.
                let distance = camera.camera_from_world.translation.norm();
                (focal * rig.ball.diameter_m / distance.max(rig.ball.diameter_m)) as f32
            }
            WorldFrame::FirstCamera => USUAL_DIAMETER_PX,
        };
        let (least, most) = MOST_DIAMETER_PX;
        Self { usual_px, most_px: (NEAR * usual_px).clamp(least, most) }
    }
}

impl Default for BallSize {
    fn default() -> Self {
        Self { usual_px: USUAL_DIAMETER_PX, most_px: MOST_DIAMETER_PX.0 }
    }
}
