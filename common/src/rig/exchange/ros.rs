//! ROS's `camera_info` YAML, of one camera. Its rectification and projection belong to a rectified pair and
//! say nothing of the raw image.

use serde::Deserialize;

use super::{
    CameraSet, ExchangedCamera,
    parts::{Read, camera_matrix, list, model, yaml},
};
use crate::{name::CameraName, rig::RigCamera, wire::WorldFrame};

#[derive(Deserialize)]
struct File {
    image_width: u32,
    image_height: u32,
    camera_name: Option<String>,
    camera_matrix: Matrix,
    distortion_model: Option<String>,
    distortion_coefficients: Matrix,
}

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

pub(super) fn read(text: &str, stem: &str) -> Read<CameraSet> {
    let file: File = yaml(text)?;
    if let Some(other) = file.distortion_model.as_deref().filter(|m| *m != "plumb_bob") {
        return Err(format!("distortion model {other:?}; only plumb_bob is supported"));
    }
    let given = file.camera_name.as_deref().filter(|n| CameraName::new(*n).is_ok());
    let name = CameraName::new(given.unwrap_or(stem)).map_err(|e| e.to_string())?;
    let size = (file.image_width, file.image_height);
    let model = model(name.as_str(), size, &file.camera_matrix.data, &file.distortion_coefficients.data)?;
    let cameras = vec![ExchangedCamera { name, model, camera_from_world: None }];
    Ok(CameraSet { cameras, world: WorldFrame::FirstCamera })
}

pub(super) fn write(camera: &RigCamera) -> String {
    let m = &camera.model;
    let [fx, _, cx, _, fy, cy, ..] = camera_matrix(m);
    format!(
        "image_width: {}\nimage_height: {}\ncamera_name: {}\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: {}\n\
         distortion_model: plumb_bob\n\
         distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: {}\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: {}\n",
        m.width,
        m.height,
        camera.name,
        list(camera_matrix(m)),
        list(m.distortion.to_array()),
        list([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
    )
}
