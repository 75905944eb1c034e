use std::{fmt, marker::PhantomData};

use nalgebra::{Vector2, Vector3};
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{MapAccess, Visitor},
    ser::SerializeMap,
};

use super::{error::CalibrationError, looks::looks_around};

/// One picture's corners: points of the object in metres and their raw pixels, pair by pair.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Name; views of one name in several cameras are simultaneous.
    pub name: String,
    /// Points in the object's own frame, in metres.
    pub object: Vec<Vector3<f64>>,
    /// Raw pixels.
    pub image: Vec<Vector2<f64>>,
    /// Middle of the exposure, ns, as the camera's clock has it; where it is known.
    pub stamp_ns: Option<u64>,
    /// How each corner moves in the picture: of all corners, or of none.
    pub motion: Vec<PixelMotion>,
}

/// How a corner moves in the picture about the instant of its view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelMotion {
    /// px/s.
    pub velocity: Vector2<f64>,
    /// px/s².
    pub acceleration: Vector2<f64>,
}

impl PixelMotion {
    /// Where a corner seen at `pixel` was `ago_s` before.
    pub fn before(&self, pixel: &Vector2<f64>, ago_s: f64) -> Vector2<f64> {
        pixel - self.velocity * ago_s + self.acceleration * (0.5 * ago_s * ago_s)
    }
}

impl View {
    /// A view of which no instant is known.
    pub const fn new(name: String, object: Vec<Vector3<f64>>, image: Vec<Vector2<f64>>) -> Self {
        Self { name, object, image, stamp_ns: None, motion: Vec::new() }
    }
}

/// All views of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraViews {
    /// Name.
    pub name: String,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Views, in the order of the file.
    pub views: Vec<View>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct RawFile {
    cameras: Ordered<RawCamera>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct RawCamera {
    size: [u32; 2],
    views: Ordered<RawView>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct RawView {
    object: Vec<[f64; 3]>,
    image: Vec<[f64; 2]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    stamp_ns: Option<u64>,
    /// Velocity (px/s) and acceleration (px/s²) of each corner.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    motion: Vec<[f64; 4]>,
}

/// A JSON object whose order counts: the first camera is the one that the others refer to.
struct Ordered<T>(Vec<(String, T)>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Ordered<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Entries<T> {
            type Value = Ordered<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object with a name for each entry")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
                let mut entries: Vec<(String, T)> = Vec::new();
                while let Some((name, value)) = map.next_entry::<String, T>()? {
                    if entries.iter().any(|(n, _)| *n == name) {
                        return Err(serde::de::Error::custom(format!("{name:?} is there twice")));
                    }
                    entries.push((name, value));
                }
                Ok(Ordered(entries))
            }
        }
        deserializer.deserialize_map(Entries(PhantomData))
    }
}

impl<T: Serialize> Serialize for Ordered<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (name, value) in &self.0 {
            map.serialize_entry(name, value)?;
        }
        map.end()
    }
}

/// Reads a corner file: `{"cameras": {NAME: {"size": [w, h], "views": {VIEW: {"object": [[x,y,z]…],
/// "image": [[u,v]…]}}}}}`, metres and pixels. A view may have a `stamp_ns` beside them, the middle of its exposure:
/// where the board moves, stamps show clocks that are off. How corners move then follows from the camera's views
/// before and after, or stands in `motion`, `[[du/dt, dv/dt, d²u/dt², d²v/dt²]…]`.
///
/// # Errors
/// [`CalibrationError`] names the entry that does not fit.
pub fn read_corners(json: &str) -> Result<Vec<CameraViews>, CalibrationError> {
    let raw: RawFile = serde_json::from_str(json).map_err(CalibrationError::CornerFile)?;
    if raw.cameras.0.is_empty() {
        return Err(CalibrationError::NoCameras);
    }
    raw.cameras
        .0
        .into_iter()
        .map(|(camera, c)| {
            if c.size.contains(&0) {
                return Err(CalibrationError::EmptyImage { camera });
            }
            let views = c
                .views
                .0
                .into_iter()
                .map(|(name, v)| {
                    if v.object.len() != v.image.len() {
                        return Err(CalibrationError::Unpaired {
                            camera: camera.clone(),
                            view: name,
                            object: v.object.len(),
                            image: v.image.len(),
                        });
                    }
                    if !v.motion.is_empty() && v.motion.len() != v.image.len() {
                        return Err(CalibrationError::UnpairedMotion {
                            camera: camera.clone(),
                            view: name,
                            motion: v.motion.len(),
                            image: v.image.len(),
                        });
                    }
                    let motion = v.motion.into_iter().map(|[u, v, uu, vv]| PixelMotion {
                        velocity: Vector2::new(u, v),
                        acceleration: Vector2::new(uu, vv),
                    });
                    Ok(View {
                        name,
                        object: v.object.into_iter().map(Vector3::from).collect(),
                        image: v.image.into_iter().map(Vector2::from).collect(),
                        stamp_ns: v.stamp_ns,
                        motion: motion.collect(),
                    })
                })
                .collect::<Result<Vec<View>, _>>()?;
            let mut camera = CameraViews { name: camera, size: (c.size[0], c.size[1]), views };
            let looks = camera.views.clone();
            looks_around(&mut camera.views, &looks);
            Ok(camera)
        })
        .collect()
}

/// Writes a corner file that [`read_corners`] reads back.
pub fn write_corners(cameras: &[CameraViews]) -> String {
    let raw = RawFile {
        cameras: Ordered(
            cameras
                .iter()
                .map(|c| {
                    let views = c.views.iter().map(|v| {
                        let raw = RawView {
                            object: v.object.iter().map(|p| (*p).into()).collect(),
                            image: v.image.iter().map(|p| (*p).into()).collect(),
                            stamp_ns: v.stamp_ns,
                            motion: v
                                .motion
                                .iter()
                                .map(|m| [m.velocity.x, m.velocity.y, m.acceleration.x, m.acceleration.y])
                                .collect(),
                        };
                        (v.name.clone(), raw)
                    });
                    (
                        c.name.clone(),
                        RawCamera { size: [c.size.0, c.size.1], views: Ordered(views.collect()) },
                    )
                })
                .collect(),
        ),
    };
    serde_json::to_string(&raw).expect("names and numbers always have a JSON form")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_file_keeps_its_order_and_names_what_does_not_fit() {
        let text = r#"{"cameras":{"right":{"size":[640,480],"views":{
            "b":{"object":[[0,0,0]],"image":[[1,2]]},"a":{"object":[],"image":[]}}},
            "left":{"size":[640,480],"views":{}}}}"#;
        let cameras = read_corners(text).expect("valid");
        assert_eq!(cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["right", "left"]);
        assert_eq!(cameras[0].views[0].name, "b");
        assert_eq!(read_corners(&write_corners(&cameras)).expect("round trip"), cameras);

        let unpaired = text.replace("[[1,2]]", "[[1,2],[3,4]]");
        let error = read_corners(&unpaired).expect_err("one object point, two image points").to_string();
        assert!(error.contains("right") && error.contains('b') && error.contains('2'), "{error}");
        let error = read_corners("{\"cameras\": {}}").expect_err("empty").to_string();
        assert!(error.contains("no camera"), "{error}");
        assert!(read_corners("{\"cameras\": {\"a\": {\"sise\": [1,2]}}}").is_err());
    }
}
