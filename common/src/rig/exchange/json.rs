//! `{"cameras": [{"name", "width", "height", "K": [9], "D": [5], "R": [9], "t": [3]}]}`, camera from table.
//! Matrices may be lists of their rows, as numpy writes them.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{
    CameraSet, ExchangedCamera,
    parts::{Read, camera_matrix, model, pose, rows},
};
use crate::{name::CameraName, rig::Rig, wire::WorldFrame};

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File<C> {
    cameras: Vec<C>,
}

#[derive(Serialize)]
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
    let file: File<Map<String, Value>> = serde_json::from_str(text).map_err(|e| e.to_string())?;
    let cameras = file
        .cameras
        .iter()
        .enumerate()
        .map(|(place, c)| {
            let name = c.get("name").and_then(Value::as_str);
            let name =
                name.ok_or_else(|| format!("camera {} of the list: \"name\" must be a text", place + 1))?;
            let who = format!("camera {name:?}");
            let size = (pixels(&who, c, "width")?, pixels(&who, c, "height")?);
            let [k, d, r, t] = ["K", "D", "R", "t"].map(|key| numbers(&who, c, key));
            Ok(ExchangedCamera {
                name: CameraName::new(name).map_err(|e| e.to_string())?,
                model: model(&who, size, &k?, &d?)?,
                camera_from_world: Some(pose(&who, &r?, &t?)?),
            })
        })
        .collect::<Read<Vec<_>>>()?;
    Ok(CameraSet { cameras, world: WorldFrame::Table })
}

fn pixels(who: &str, camera: &Map<String, Value>, key: &str) -> Read<u32> {
    let count = camera.get(key).and_then(Value::as_u64).and_then(|n| u32::try_from(n).ok());
    count.ok_or_else(|| format!("{who}: {key:?} must be a whole number of pixels"))
}

/// A list of numbers, or one of rows of numbers, row by row.
fn numbers(who: &str, camera: &Map<String, Value>, key: &str) -> Read<Vec<f64>> {
    fn flatten(value: &Value, into: &mut Vec<f64>) -> Option<()> {
        match value {
            Value::Array(items) => items.iter().try_for_each(|item| flatten(item, into)),
            other => other.as_f64().map(|number| into.push(number)),
        }
    }
    let mut flat = Vec::new();
    let value = camera.get(key).filter(|value| value.is_array());
    value
        .and_then(|value| flatten(value, &mut flat))
        .map(|()| flat)
        .ok_or_else(|| format!("{who}: {key:?} must be a list of numbers, or of rows of numbers"))
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

#[cfg(test)]
mod tests {
    use super::read;

    const FLAT: &str = r#"{"cameras": [{"name": "left", "width": 640, "height": 480,
        "K": [500, 0, 320, 0, 501, 240, 0, 0, 1], "D": [0.1, 0, 0, 0, 0],
        "R": [1, 0, 0, 0, 1, 0, 0, 0, 1], "t": [0, 0, 2]}]}"#;

    #[test]
    fn matrices_may_be_lists_of_rows() {
        let rows = FLAT
            .replace("[500, 0, 320, 0, 501, 240, 0, 0, 1]", "[[500, 0, 320], [0, 501, 240], [0, 0, 1]]")
            .replace("[1, 0, 0, 0, 1, 0, 0, 0, 1]", "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]");
        let [flat, rows] = [FLAT, &rows].map(|text| read(text).expect("valid"));
        assert_eq!(flat.cameras[0].model, rows.cameras[0].model);
        assert_eq!(flat.cameras[0].camera_from_world, rows.cameras[0].camera_from_world);
    }

    #[test]
    fn what_is_wrong_is_named_with_camera_and_key() {
        for (from, to, said) in [
            ("\"K\": [500,", "\"K\": [\"wide\",", "camera \"left\": \"K\""),
            ("\"t\": [0, 0, 2]", "\"T\": [0, 0, 2]", "camera \"left\": \"t\""),
            ("\"width\": 640", "\"width\": -1", "camera \"left\": \"width\""),
            ("\"name\": \"left\"", "\"name\": 3", "camera 1 of the list: \"name\""),
        ] {
            let text = FLAT.replace(from, to);
            assert_ne!(text, FLAT);
            let error = read(&text).map(|set| set.cameras.len()).expect_err(to);
            assert!(error.contains(said), "{error}");
        }
    }
}
