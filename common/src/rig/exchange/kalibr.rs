//! Kalibr's camera chain: `cam0`, `cam1`, …, each with `T_cn_cnm1`, its pose from the one before.

use std::{collections::BTreeMap, fmt::Write as _};

use nalgebra::Matrix4;
use serde::Deserialize;

use super::{
    CameraSet, ExchangedCamera,
    parts::{Read, lens, list, pose, yaml},
};
use crate::{
    camera::CameraModel,
    geometry::{Transform, World},
    name::CameraName,
    rig::Rig,
    wire::WorldFrame,
};

#[derive(Deserialize)]
struct Entry {
    camera_model: String,
    intrinsics: Vec<f64>,
    distortion_model: String,
    #[serde(default)]
    distortion_coeffs: Vec<f64>,
    resolution: [u32; 2],
    #[serde(rename = "T_cn_cnm1")]
    from_previous: Option<Vec<Vec<f64>>>,
    rostopic: Option<String>,
}

pub(super) fn read(text: &str) -> Read<CameraSet> {
    let file: BTreeMap<String, Entry> = yaml(text)?;
    let mut cameras: Vec<ExchangedCamera> = Vec::new();
    for place in 0..file.len() {
        let who = format!("cam{place}");
        let entry = file.get(&who).ok_or_else(|| format!("{who} is missing: the chain must have no gap"))?;
        if entry.camera_model != "pinhole" {
            return Err(format!("{who}: camera model {:?}; only pinhole is supported", entry.camera_model));
        }
        let distortion = match entry.distortion_model.as_str() {
            "radtan" => lens(&who, &entry.distortion_coeffs)?,
            "none" => lens(&who, &[])?,
            other => {
                return Err(format!("{who}: distortion model {other:?}; only radtan and none are supported"));
            }
        };
        let [fx, fy, cx, cy] = entry.intrinsics[..] else {
            return Err(format!(
                "{who}: {} intrinsics; there must be 4 (fx fy cx cy)",
                entry.intrinsics.len()
            ));
        };
        let model = CameraModel::new(entry.resolution.into(), (fx, fy), (cx, cy), distortion)
            .map_err(|e| format!("{who}: {e}"))?;
        let camera_from_world = match (cameras.last(), &entry.from_previous) {
            (None, _) => Transform::identity(),
            (Some(_), None) => {
                return Err(format!("{who} has no T_cn_cnm1, its pose from the camera before"));
            }
            (Some(previous), Some(rows)) => {
                let numbers: Vec<f64> = rows.iter().flatten().copied().collect();
                if numbers.len() != 16 {
                    return Err(format!("{who}: T_cn_cnm1 has {} numbers; it must be 4 × 4", numbers.len()));
                }
                let m = Matrix4::from_row_slice(&numbers);
                let r = m.fixed_view::<3, 3>(0, 0).transpose();
                let step = pose(&who, r.as_slice(), m.fixed_view::<3, 1>(0, 3).into_owned().as_slice())?;
                let before = previous.camera_from_world.expect("each has one");
                Transform::<_, World>::new(
                    step.rotation * before.rotation,
                    step.rotation * before.translation + step.translation,
                )
            }
        };
        // Kalibr knows a camera by its topic: `/left/image_raw` is `left`.
        let topic = entry.rostopic.as_deref().and_then(|t| t.trim_start_matches('/').split('/').next());
        let name = topic
            .and_then(|t| CameraName::new(t).ok())
            .filter(|n| cameras.iter().all(|c| c.name != *n))
            .map_or_else(|| CameraName::new(who.as_str()), Ok)
            .map_err(|e| e.to_string())?;
        cameras.push(ExchangedCamera { name, model, camera_from_world: Some(camera_from_world) });
    }
    Ok(CameraSet { cameras, world: WorldFrame::FirstCamera })
}

pub(super) fn write(rig: &Rig) -> Result<String, String> {
    let mut text = String::new();
    for (place, camera) in rig.cameras.iter().enumerate() {
        let m = &camera.model;
        let [k1, k2, p1, p2, k3] = m.distortion.to_array();
        if k3 != 0.0 {
            return Err(format!("radtan has no k3, and that of camera {} is {k3}", camera.name));
        }
        let _ = writeln!(
            text,
            "cam{place}:\n  camera_model: pinhole\n  intrinsics: {}\n  distortion_model: radtan\n  \
             distortion_coeffs: {}\n  resolution: [{}, {}]\n  rostopic: /{}/image_raw",
            list([m.fx, m.fy, m.cx, m.cy]),
            list([k1, k2, p1, p2]),
            m.width,
            m.height,
            camera.name
        );
        if place > 0 {
            let before = rig.cameras[place - 1].camera_from_world.inverse();
            let r = camera.camera_from_world.rotation * before.rotation;
            let t =
                camera.camera_from_world.rotation * before.translation + camera.camera_from_world.translation;
            text += "  T_cn_cnm1:\n";
            for i in 0..3 {
                let row = [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]];
                let _ = writeln!(text, "  - {}", list(row));
            }
            text += "  - [0.0, 0.0, 0.0, 1.0]\n";
        }
    }
    Ok(text)
}
