//! The original rig's YAML: `parameters: {id: {image_size, camera_matrix, distortion_coefs, rotation,
//! translation}}`; rotation is a Rodrigues vector, both from the first camera.

use std::{collections::BTreeMap, fmt::Write as _};

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::{
    CameraSet, ExchangedCamera,
    parts::{Read, camera_matrix, list, model, yaml},
};
use crate::{geometry::Transform, name::CameraName, rig::Rig, wire::WorldFrame};

#[derive(Deserialize)]
struct File {
    parameters: BTreeMap<String, Entry>,
}

#[derive(Deserialize)]
struct Entry {
    image_size: [u32; 2],
    camera_matrix: Vec<f64>,
    distortion_coefs: Vec<f64>,
    rotation: Option<[f64; 3]>,
    translation: Option<[f64; 3]>,
}

pub(super) fn read(text: &str) -> Read<CameraSet> {
    let file: File = yaml(text)?;
    let mut entries: Vec<_> = file.parameters.into_iter().collect();
    // Ids are numbers as a rule: 2 comes before 10.
    entries.sort_by_key(|(id, _)| (id.parse::<u64>().unwrap_or(u64::MAX), id.clone()));
    let cameras = entries
        .iter()
        .map(|(id, c)| {
            let who = format!("camera {id}");
            let [rotation, translation] = match (c.rotation, c.translation) {
                (Some(r), Some(t)) => [r, t],
                _ => return Err(format!("{who}: rotation and translation are both needed")),
            };
            if !rotation.iter().chain(&translation).all(|v| v.is_finite()) {
                return Err(format!("{who}: rotation and translation must be finite numbers"));
            }
            Ok(ExchangedCamera {
                name: CameraName::new(id.as_str()).map_err(|e| e.to_string())?,
                model: model(&who, c.image_size.into(), &c.camera_matrix, &c.distortion_coefs)?,
                camera_from_world: Some(Transform::from_rodrigues(
                    Vector3::from(rotation),
                    Vector3::from(translation),
                )),
            })
        })
        .collect::<Read<Vec<_>>>()?;
    Ok(CameraSet { cameras, world: WorldFrame::FirstCamera })
}

pub(super) fn write(rig: &Rig) -> String {
    let mut text = String::from("parameters:\n");
    let world_from_first = rig.cameras[0].camera_from_world.inverse();
    for camera in &rig.cameras {
        let m = &camera.model;
        let rotation = camera.camera_from_world.rotation * world_from_first.rotation;
        let translation = camera.camera_from_world.rotation * world_from_first.translation
            + camera.camera_from_world.translation;
        let first = camera.index.get() == 0;
        let exact = |v: Vector3<f64>| if first { Vector3::zeros() } else { v };
        let _ = writeln!(
            text,
            "  {}:\n    image_size: [{}, {}]\n    camera_matrix: {}\n    distortion_coefs: {}\n    rotation: {}\n    \
             translation: {}",
            camera.name,
            m.width,
            m.height,
            list(camera_matrix(m)),
            list(m.distortion.to_array()),
            list(exact(rodrigues(&rotation)).iter().copied()),
            list(exact(translation).iter().copied()),
        );
    }
    text
}

/// Axis times angle, by way of the quaternion: the arc cosine of the trace loses half of the digits near
/// half a turn, and cameras on two sides of a table are nearly that far apart.
fn rodrigues(rotation: &Rotation3<f64>) -> Vector3<f64> {
    UnitQuaternion::from_rotation_matrix(rotation).scaled_axis()
}
