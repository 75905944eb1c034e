//! A scene that never ends, rendered into frames: rallies, or recorded flights, in a hall with all that
//! makes a ball hard to find; with the truth, and with faults on demand.

mod control;
mod faults;
pub mod flight;
mod pool;
pub mod render;
pub mod scene;
mod source;
mod truth;

pub use faults::{Fault, FaultError, FaultKind};
pub use pool::FramePool;
pub use source::{SyntheticError, SyntheticOptions, SyntheticSource};
pub use truth::truth_domain;

/// A rig of two small cameras beside the table, for tests.
#[cfg(test)]
fn test_rig() -> netcord_common::rig::Rig {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
    let mut rig = netcord_common::rig::Rig::load(&path).expect("the example is valid");
    for camera in &mut rig.cameras {
        // A third of the pixels in each direction: the same view.
        let [fx, fy, cx, cy, ..] = camera.model.parameters();
        let third = |v: f64| (v + 0.5) / 3.0 - 0.5;
        camera.model = netcord_common::camera::CameraModel::new(
            (640, 400),
            (fx / 3.0, fy / 3.0),
            (third(cx), third(cy)),
            camera.model.distortion,
        )
        .expect("valid");
    }
    rig
}
