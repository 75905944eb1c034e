//! OpenCV's FileStorage YAML: one camera as its calibration sample writes it (`camera_matrix`,
//! `distortion_coefficients`), or a pair as its stereo sample does (`M1 D1 M2 D2`, and `R T` with
//! X₂ = R X₁ + T).

use serde::Deserialize;

use super::{
    CameraSet, ExchangedCamera,
    parts::{Read, camera_matrix, list, model, pose, yaml},
};
use crate::{geometry::Transform, name::CameraName, rig::RigCamera, wire::WorldFrame};

#[derive(Deserialize)]
struct File {
    image_width: Option<u32>,
    image_height: Option<u32>,
    #[serde(alias = "Camera_Matrix", alias = "K")]
    camera_matrix: Option<Matrix>,
    #[serde(alias = "Distortion_Coefficients", alias = "dist_coeffs", alias = "D")]
    distortion_coefficients: Option<Matrix>,
    #[serde(rename = "M1")]
    m1: Option<Matrix>,
    #[serde(rename = "D1")]
    d1: Option<Matrix>,
    #[serde(rename = "M2")]
    m2: Option<Matrix>,
    #[serde(rename = "D2")]
    d2: Option<Matrix>,
    #[serde(rename = "R")]
    r: Option<Matrix>,
    #[serde(rename = "T")]
    t: Option<Matrix>,
}

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

pub(super) fn read(text: &str, stem: &str, size: Option<(u32, u32)>) -> Read<CameraSet> {
    // `%YAML:1.0` is no directive that YAML knows.
    let body: String =
        text.lines().map(|l| if l.starts_with("%YAML") { "\n".into() } else { format!("{l}\n") }).collect();
    let file: File = yaml(&body)?;
    let size = match (file.image_width, file.image_height, size) {
        (Some(width), Some(height), _) => (width, height),
        (_, _, Some(size)) => size,
        _ => {
            return Err(
                "it does not say image_width and image_height; give them with --size WIDTHxHEIGHT".into()
            );
        }
    };
    let name = |name: String| CameraName::new(name).map_err(|e| e.to_string());
    let cameras = match (&file.camera_matrix, &file.m1, &file.m2) {
        (Some(k), None, None) => {
            let d = file.distortion_coefficients.ok_or("it has no distortion_coefficients")?;
            let model = model(stem, size, &k.data, &d.data)?;
            vec![ExchangedCamera { name: name(stem.into())?, model, camera_from_world: None }]
        }
        (None, Some(m1), Some(m2)) => {
            let (Some(d1), Some(d2)) = (&file.d1, &file.d2) else {
                return Err("the pair has no D1 and D2".into());
            };
            let (Some(r), Some(t)) = (&file.r, &file.t) else {
                return Err(
                    "the pair has no R and T: put those of OpenCV's extrinsics.yml into the same file".into(),
                );
            };
            vec![
                ExchangedCamera {
                    name: name("left".into())?,
                    model: model("camera 1", size, &m1.data, &d1.data)?,
                    camera_from_world: Some(Transform::identity()),
                },
                ExchangedCamera {
                    name: name("right".into())?,
                    model: model("camera 2", size, &m2.data, &d2.data)?,
                    camera_from_world: Some(pose("camera 2", &r.data, &t.data)?),
                },
            ]
        }
        _ => return Err("it has neither camera_matrix nor the pair M1, M2".into()),
    };
    Ok(CameraSet { cameras, world: WorldFrame::FirstCamera })
}

pub(super) fn write(camera: &RigCamera) -> String {
    let m = &camera.model;
    let matrix = |key: &str, (rows, cols): (u32, u32), data: String| {
        format!("{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: {data}\n")
    };
    format!(
        "%YAML:1.0\n---\nimage_width: {}\nimage_height: {}\n{}{}",
        m.width,
        m.height,
        matrix("camera_matrix", (3, 3), list(camera_matrix(m))),
        matrix("distortion_coefficients", (5, 1), list(m.distortion.to_array())),
    )
}
