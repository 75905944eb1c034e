use foxglove::messages::{CameraCalibration, FrameTransform, Quaternion, Timestamp, Vector3};
use nalgebra::{Matrix3, Quaternion as NaQuaternion, UnitQuaternion, Vector3 as NaVector3};
use netcord_common::{
    camera::{CameraModel, Distortion},
    geometry::{Camera, Transform, World},
};

/// What a `foxglove.CameraCalibration` says.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCalibration {
    /// Intrinsics.
    pub model: CameraModel,
    /// The camera's frame of reference, as `/tf` may call it.
    pub frame_id: String,
    /// The pose that P = K [R|t] holds, where P is given; identity for P = [K|0]. A P of another kind
    /// matters only where there is no `/tf`: then its error says what is wrong.
    pub camera_from_world: Result<Option<Transform<Camera, World>>, String>,
}

/// The parent of cameras in `/tf`.
pub const TABLE_FRAME: &str = "table";

impl RecordedCalibration {
    /// Checks and reads a message; the sentence of an error says what is wrong and what would be right.
    ///
    /// # Errors
    /// A lens model other than `plumb_bob`, arrays of another length, or impossible intrinsics.
    pub fn parse(message: &CameraCalibration) -> Result<Self, String> {
        if !matches!(message.distortion_model.as_str(), "" | "plumb_bob") {
            return Err(format!(
                "its distortion model is {:?}; valid is plumb_bob",
                message.distortion_model
            ));
        }
        let k: &[f64; 9] = message.k.as_slice().try_into().map_err(|_| {
            format!("its K has {} numbers; the 9 of a 3 × 3 matrix, row by row, are needed", message.k.len())
        })?;
        if k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0 {
            return Err(format!("its K is {k:?}; valid is [fx 0 cx, 0 fy cy, 0 0 1]"));
        }
        let lens = Distortion::from_array(lens(&message.d)?);
        let model = CameraModel::new((message.width, message.height), (k[0], k[4]), (k[2], k[5]), lens)
            .map_err(|e| e.to_string())?;
        Ok(Self { model, frame_id: message.frame_id.clone(), camera_from_world: pose(k, &message.p) })
    }
}

/// k1 k2 p1 p2 k3 of a `plumb_bob` D, which may lack k3, or be empty for a lens without distortion.
fn lens(d: &[f64]) -> Result<[f64; 5], String> {
    let mut lens = [0.0; 5];
    let (known, rest) = d.split_at(d.len().min(5));
    if !matches!(d.len(), 0 | 4 | 5)
        && rest.iter().chain((d.len() < 4).then_some(&f64::NAN)).any(|v| *v != 0.0)
    {
        return Err(format!("its D has {} numbers; plumb_bob has k1 k2 p1 p2 k3 (or none)", d.len()));
    }
    lens[..known.len()].copy_from_slice(known);
    Ok(lens)
}

/// [R|t] = K⁻¹ P, up to the scale that a projection matrix leaves open.
fn pose(k: &[f64; 9], p: &[f64]) -> Result<Option<Transform<Camera, World>>, String> {
    if p.iter().all(|v| *v == 0.0) {
        return Ok(None);
    }
    let p: &[f64; 12] = p.try_into().map_err(|_| {
        format!("its P has {} numbers; the 12 of a 3 × 4 matrix, row by row, are needed", p.len())
    })?;
    let k = Matrix3::from_row_slice(k);
    let k_inverse = k.try_inverse().ok_or("its K has no inverse")?;
    let left = Matrix3::new(p[0], p[1], p[2], p[4], p[5], p[6], p[8], p[9], p[10]);
    let (rotation, translation) = (k_inverse * left, k_inverse * NaVector3::new(p[3], p[7], p[11]));
    let scale = rotation.determinant().cbrt();
    if scale == 0.0 || !scale.is_finite() {
        return Err("its P is singular; P = K [R|t] is needed".into());
    }
    Transform::from_matrix(&(rotation / scale), translation / scale)
        .map(Some)
        .map_err(|e| format!("its P is not K [R|t] with its own K: {e}"))
}

/// Value of a `foxglove.FrameTransform`, which is `parent_from_child`, read as `table_from_camera`.
///
/// # Errors
/// A sentence, when it is no rigid transform.
pub fn table_from_camera(message: &FrameTransform) -> Result<Transform<World, Camera>, String> {
    let t = message.translation.as_ref().map_or_else(NaVector3::zeros, |t| NaVector3::new(t.x, t.y, t.z));
    let q =
        message.rotation.as_ref().map_or(NaQuaternion::identity(), |q| NaQuaternion::new(q.w, q.x, q.y, q.z));
    // Files may give a quaternion to a few digits; one far from unit length is something else.
    if !((q.norm() - 1.0).abs() < 1e-3 && t.iter().all(|v| v.is_finite())) {
        return Err(format!("its rotation has the length {}, not 1, or a number is not finite", q.norm()));
    }
    Ok(Transform::new(UnitQuaternion::from_quaternion(q).to_rotation_matrix(), t))
}

/// The message for a camera's intrinsics, as Foxglove and ROS mean it: R = I, P = [K|0].
pub fn calibration_message(stamp_ns: u64, frame_id: &str, model: &CameraModel) -> CameraCalibration {
    let (fx, fy, cx, cy) = (model.fx, model.fy, model.cx, model.cy);
    CameraCalibration {
        timestamp: timestamp(stamp_ns),
        frame_id: frame_id.to_owned(),
        width: model.width,
        height: model.height,
        distortion_model: "plumb_bob".to_owned(),
        d: model.distortion.to_array().to_vec(),
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

/// The message for a camera's pose in the frame `parent`.
pub fn transform_message(
    stamp_ns: u64,
    parent: &str,
    camera: &str,
    camera_from_world: &Transform<Camera, World>,
) -> FrameTransform {
    let world_from_camera = camera_from_world.inverse();
    let t = world_from_camera.translation;
    let q = UnitQuaternion::from_rotation_matrix(&world_from_camera.rotation);
    FrameTransform {
        timestamp: timestamp(stamp_ns),
        parent_frame_id: parent.to_owned(),
        child_frame_id: camera.to_owned(),
        translation: Some(Vector3 { x: t.x, y: t.y, z: t.z }),
        rotation: Some(Quaternion { x: q.i, y: q.j, z: q.k, w: q.w }),
    }
}

/// A stamp as Foxglove's messages hold it.
pub fn timestamp(ns: u64) -> Option<Timestamp> {
    let seconds = u32::try_from(ns / 1_000_000_000).ok()?;
    Timestamp::new_checked(seconds, u32::try_from(ns % 1_000_000_000).ok()?)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use netcord_common::geometry::Point;

    use super::*;

    fn model() -> CameraModel {
        let lens = Distortion::from_array([-0.1, 0.07, -0.0007, 0.0003, -0.0036]);
        CameraModel::new((1920, 1200), (672.0, 673.0), (984.0, 602.0), lens).expect("valid")
    }

    fn camera_from_table() -> Transform<Camera, World> {
        Transform::from_rodrigues(Vector3::new(2.0, -0.3, 0.4), Vector3::new(0.1, 0.5, 1.7))
    }

    #[test]
    fn a_calibration_comes_back_with_the_pose_by_tf_or_by_the_projection_matrix() {
        let message = calibration_message(5, "left", &model());
        let read = RecordedCalibration::parse(&message).expect("valid");
        assert_eq!(read.model, model());
        assert_eq!(read.camera_from_world, Ok(Some(Transform::identity())), "P = [K|0]");

        let tf = transform_message(5, TABLE_FRAME, "left", &camera_from_table());
        let back = table_from_camera(&tf).expect("valid").inverse();
        let point = Point::new(0.3, -0.7, 0.2);
        assert!((&back * point).distance(&(&camera_from_table() * point)) < 1e-12);

        // P = K [R|t], at any scale.
        let k = Matrix3::from_row_slice(&message.k);
        let pose = camera_from_table();
        let left = k * pose.rotation.matrix() * -2.5;
        let right = k * pose.translation * -2.5;
        let row = |i: usize| [left[(i, 0)], left[(i, 1)], left[(i, 2)], right[i]];
        let by_p = CameraCalibration { p: [row(0), row(1), row(2)].concat(), ..message };
        let read = RecordedCalibration::parse(&by_p).expect("valid").camera_from_world;
        let read = read.expect("K [R|t]").expect("given");
        assert!((&read * point).distance(&(&pose * point)) < 1e-9);
    }

    #[test]
    fn lenses_may_have_no_four_or_five_numbers() {
        let mut message = calibration_message(5, "left", &model());
        for (d, valid) in [
            (vec![], true),
            (vec![0.1, 0.2, 0.3, 0.4], true),
            (vec![0.1, 0.2, 0.3, 0.4, 0.5], true),
            (vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0], true),
            (vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.0, 0.0], false),
            (vec![0.1], false),
        ] {
            message.d.clone_from(&d);
            assert_eq!(RecordedCalibration::parse(&message).is_ok(), valid, "{d:?}");
        }
    }

    #[test]
    fn what_cannot_be_is_named() {
        type Change = fn(&mut CameraCalibration);
        let cases: [(Change, &str); 4] = [
            (|m| m.distortion_model = "kannala_brandt".into(), "valid is plumb_bob"),
            (|m| m.k.truncate(4), "K has 4 numbers"),
            (|m| m.k[0] = -5.0, "fx is -5"),
            (|m| m.width = 0, "width is 0"),
        ];
        for (change, expected) in cases {
            let mut wrong = calibration_message(5, "left", &model());
            change(&mut wrong);
            let error = RecordedCalibration::parse(&wrong).expect_err(expected);
            assert!(error.contains(expected), "{error}");
        }
        let mut rectified = calibration_message(5, "left", &model());
        rectified.p[5] *= 2.0;
        let read = RecordedCalibration::parse(&rectified).expect("its K and D are good");
        let error = read.camera_from_world.expect_err("not with this K");
        assert!(error.contains("P is not K [R|t]"), "{error}");
    }
}
