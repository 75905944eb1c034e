//! `{"cameras": [{"name", "width", "height", "K": [9], "D": [5], "R": [9], "t": [3]}]}`, camera from table.

use serde::{Deserialize, Serialize};

use super::{
    CameraSet, ExchangedCamera,
    parts::{Read, camera_matrix, model, pose, rows},
};
use crate::{name::CameraName, rig::Rig, wire::WorldFrame};

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    cameras: Vec<Entry>,
}

#[derive(Serialize, Deserialize)]
struct Entry {
    name: String,
    width: u32,
    height: u32,
    #[serde(rename = "K")]
    k: Vec<f64>,
    #[serde(rename = "D")]
    d: Vec<f64>,
    #[serde(rename = "R")]
    r: Vec<f64>,
    t: Vec<f64>,
}

pub(super) fn read(text: &str) -> Read<CameraSet> {
    let file: File = serde_json::from_str(text).map_err(|e| e.to_string())?;
    let cameras = file
        .cameras
        .iter()
        .map(|c| {
            let who = format!("camera {:?}", c.name);
            Ok(ExchangedCamera {
                name: CameraName::new(&c.name).map_err(|e| e.to_string())?,
                model: model(&who, (c.width, c.height), &c.k, &c.d)?,
                camera_from_world: Some(pose(&who, &c.r, &c.t)?),
            })
        })
        .collect::<Read<Vec<_>>>()?;
    Ok(CameraSet { cameras, world: WorldFrame::Table })
}

pub(super) fn write(rig: &Rig) -> String {
    let cameras = rig
        .cameras
        .iter()
        .map(|c| Entry {
            name: c.name.to_string(),
            width: c.model.width,
            height: c.model.height,
            k: camera_matrix(&c.model).into(),
            d: c.model.distortion.to_array().into(),
            r: rows(c.camera_from_world.rotation.matrix()).into(),
            t: c.camera_from_world.translation.as_slice().into(),
        })
        .collect();
    serde_json::to_string_pretty(&File { cameras }).expect("numbers and names are JSON") + "\n"
}
