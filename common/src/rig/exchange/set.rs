use nalgebra::Rotation3;

use super::parts::Read;
use crate::{
    camera::CameraModel,
    geometry::{Camera, Transform, World},
    name::CameraName,
    pixel::PixelFormat,
    rig::RigEdit,
    wire::{MAX_CAMERAS, WorldFrame},
};

/// One camera as another program's file gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct ExchangedCamera {
    /// Its name, or one made from its number or file.
    pub name: CameraName,
    /// Intrinsics.
    pub model: CameraModel,
    /// Pose in the world of its [`CameraSet`]; `None` where the format has none.
    pub camera_from_world: Option<Transform<Camera, World>>,
}

/// The cameras of one file.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSet {
    /// The cameras, in the file's order.
    pub cameras: Vec<ExchangedCamera>,
    /// What the world of the poses is: the table, or the first camera.
    pub world: WorldFrame,
}

/// What a rig file needs beyond a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImportDefaults {
    /// The mosaic.
    pub pixel_format: PixelFormat,
    /// Length of the exposure, µs.
    pub exposure_us: f64,
}

impl Default for ImportDefaults {
    fn default() -> Self {
        Self { pixel_format: PixelFormat::BayerRG8, exposure_us: 1000.0 }
    }
}

impl CameraSet {
    /// Refuses two cameras of one name, none, and more than a rig holds.
    pub(super) fn checked(set: Self) -> Read<Self> {
        if set.cameras.is_empty() {
            return Err("it holds no camera".into());
        }
        if set.cameras.len() > MAX_CAMERAS {
            return Err(format!("it holds {} cameras; a rig has at most {MAX_CAMERAS}", set.cameras.len()));
        }
        for (i, camera) in set.cameras.iter().enumerate() {
            if set.cameras[..i].iter().any(|other| other.name == camera.name) {
                return Err(format!("two cameras are called {}; names must differ", camera.name));
            }
        }
        Ok(set)
    }

    /// Puts the cameras into a rig file: intrinsics, poses and, where they are from the table, its pose.
    /// What the file already says beside that stays.
    pub fn write_into(&self, edit: &mut RigEdit, defaults: &ImportDefaults) {
        for camera in &self.cameras {
            edit.set_intrinsics(&camera.name, &camera.model, None, None);
            let table = edit.camera(&camera.name);
            if !table.contains_key("pixel_format") {
                table["pixel_format"] = toml_edit::value(defaults.pixel_format.to_string());
            }
            if !table.contains_key("exposure_us") {
                table["exposure_us"] = toml_edit::value(defaults.exposure_us);
            }
        }
        let Some(first_from_world) = self.cameras[0].camera_from_world else { return };
        if self.world == WorldFrame::Table {
            let Transform { rotation, translation, .. } = first_from_world;
            edit.set_table(rotation.matrix(), &translation, None, None);
        }
        for camera in &self.cameras[1..] {
            let Some(camera_from_world) = &camera.camera_from_world else { continue };
            let rotation: Rotation3<f64> = camera_from_world.rotation * first_from_world.rotation.inverse();
            let translation = camera_from_world.translation - rotation * first_from_world.translation;
            edit.set_pose(&camera.name, rotation.matrix(), &translation, None, None);
        }
    }
}
