use netcord_common::{
    DomainName,
    camera::{CameraModel, Distortion},
    geometry::{Camera, Transform, World},
    rig::{
        Ball, CameraIndex, FlightConstants, HittingPlane, ProcessSpec, Rig, RigCamera, TriggerRole, Wiring,
    },
    wire::{MAX_CAMERAS, WorldFrame},
};

use super::{FilmedCamera, Footage, RecordingError, footage::camera_topic};

/// Where no camera has two frames, nothing tells the rate.
const DEFAULT_INTERVAL_NS: u64 = 10_000_000;

impl Footage {
    /// The rig that the recording itself describes: its cameras with their calibration and poses, the
    /// interval of its frames, half of it as tolerance; of the rest the defaults (ball of 40 mm, orange
    /// and white both tried). One camera alone gives no positions, and so needs no calibration: without one it is
    /// taken for a lens of ordinary width, which is enough to find a ball's image.
    ///
    /// # Errors
    /// [`RecordingError::Content`] when a camera has no calibration or no pose.
    pub fn rig(&self) -> Result<Rig, RecordingError> {
        let interval_ns = self.interval_ns().unwrap_or(DEFAULT_INTERVAL_NS);
        let mut poses = Vec::new();
        for camera in &self.cameras {
            poses.push(self.pose(camera)?);
        }
        let identical = poses.iter().filter(|(_, given)| !given).count();
        if identical > 1 || (identical == 1 && self.cameras.iter().any(|c| c.table_from_camera.is_some())) {
            let without = poses.iter().zip(&self.cameras).filter(|((_, given), _)| !given);
            let names = without.map(|(_, c)| c.name.as_str()).collect::<Vec<_>>().join(", ");
            return Err(self.content(format!(
                "it does not say where the cameras stand ({names}): /tf needs a foxglove.FrameTransform from \
                 \"table\" to each camera's name, or the calibration a P = K [R|t] from the table frame; or give \
                 a rig file with --rig"
            )));
        }
        // Without a table, the one camera whose pose is the identity is the frame of results.
        let world = if identical == 1 { WorldFrame::FirstCamera } else { WorldFrame::Table };
        let cameras = self
            .cameras
            .iter()
            .zip(poses)
            .enumerate()
            .map(|(place, (filmed, (pose, _)))| self.camera(place, filmed, pose))
            .collect::<Result<_, _>>()?;
        Ok(Rig {
            name: DomainName::new("recording").expect("valid"),
            rate_hz: 1e9 / interval_ns as f64,
            tolerance_ns: interval_ns / 2,
            ball: Ball::default(),
            world,
            cameras,
            flight: FlightConstants::default(),
            hitting_plane: HittingPlane::default(),
            processes: ProcessSpec::stages(),
        })
    }

    /// Checks that the recording's cameras are the rig's, of the same size.
    ///
    /// # Errors
    /// [`RecordingError::Content`] names the camera, and what the rig knows.
    pub fn check_against(&self, rig: &Rig) -> Result<(), RecordingError> {
        let known = rig.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
        if let Some(stranger) = self.cameras.iter().find(|filmed| rig.camera(&filmed.name).is_none()) {
            return Err(self.content(format!(
                "{} is of a camera that the rig {} does not know; it has {known}",
                camera_topic(&stranger.name, "image"),
                rig.name
            )));
        }
        for filmed in &self.cameras {
            let Some(camera) = rig.camera(&filmed.name) else { continue };
            let Some(frame) = filmed.frames.first() else { continue };
            let model = &camera.model;
            if (frame.width, frame.height) != (model.width, model.height) {
                return Err(self.content(format!(
                    "{} has images of {} × {}, but in the rig {} the camera has {} × {}",
                    camera_topic(&filmed.name, "image"),
                    frame.width,
                    frame.height,
                    rig.name,
                    model.width,
                    model.height
                )));
            }
        }
        Ok(())
    }

    /// The pose, and whether the recording gives one: P = [K|0] says only that R = I, as Foxglove and ROS
    /// write every calibration.
    fn pose(&self, camera: &FilmedCamera) -> Result<(Transform<Camera, World>, bool), RecordingError> {
        if let Some(pose) = &camera.table_from_camera {
            return Ok((pose.inverse(), true));
        }
        let topic = camera_topic(&camera.name, "calibration");
        let Some(calibration) = &camera.calibration else {
            return if self.is_alone() {
                Ok((Transform::identity(), false))
            } else {
                Err(self.no_calibration(camera))
            };
        };
        match &calibration.camera_from_world {
            Ok(Some(pose)) => Ok((*pose, !is_identity(pose))),
            Ok(None) => Ok((Transform::identity(), false)),
            Err(why) => Err(self.content(format!(
                "/tf has no pose of {} in the frame \"table\", and {topic} does not help: {why}",
                camera.name
            ))),
        }
    }

    fn camera(
        &self,
        place: usize,
        filmed: &FilmedCamera,
        camera_from_world: Transform<Camera, World>,
    ) -> Result<RigCamera, RecordingError> {
        let index = CameraIndex::new(place)
            .ok_or_else(|| self.content(format!("it has more than {MAX_CAMERAS} cameras")))?;
        let first = filmed.frames.first();
        let model = match (&filmed.calibration, first) {
            (Some(calibration), _) => calibration.model,
            (None, Some(frame)) if self.is_alone() => {
                tracing::warn!(
                    "{}: camera {} has no calibration: detections are found, positions are not",
                    self.file().path().display(),
                    filmed.name
                );
                ordinary_lens(frame.width, frame.height).ok_or_else(|| self.no_calibration(filmed))?
            }
            (None, _) => return Err(self.no_calibration(filmed)),
        };
        let header = first.and_then(|f| f.header.as_ref());
        Ok(RigCamera {
            name: filmed.name.clone(),
            index,
            serial: String::new(),
            pixel_format: first.map_or(netcord_common::PixelFormat::Mono8, |f| f.format),
            device_format: None,
            // Recordings of others do not say; 0 = not known.
            exposure_ns: header.map_or(0, |h| h.exposure_ns),
            gain_db: header.map_or(0.0, |h| h.gain_db),
            trigger: TriggerRole::default(),
            master: false,
            line: None,
            line_delay_ns: 0,
            wiring: Wiring::default(),
            clock_delay: None,
            model,
            intrinsics_sigma: None,
            ball: None,
            camera_from_world,
        })
    }

    fn is_alone(&self) -> bool {
        self.cameras.len() == 1
    }

    fn no_calibration(&self, camera: &FilmedCamera) -> RecordingError {
        self.content(format!(
            "it has no calibration of camera {}: a foxglove.CameraCalibration on {} is needed, or a rig file with --rig",
            camera.name,
            camera_topic(&camera.name, "calibration")
        ))
    }

    fn content(&self, why: String) -> RecordingError {
        RecordingError::Content { path: self.file().path().to_owned(), why }
    }
}

/// A pinhole that sees 53° of its width.
fn ordinary_lens(width: u32, height: u32) -> Option<CameraModel> {
    let (w, h) = (f64::from(width), f64::from(height));
    CameraModel::new((width, height), (w, w), (0.5 * (w - 1.0), 0.5 * (h - 1.0)), Distortion::default()).ok()
}

fn is_identity(pose: &Transform<Camera, World>) -> bool {
    let turned = (pose.rotation.matrix() - nalgebra::Matrix3::identity()).amax();
    turned.max(pose.translation.amax()) < 1e-9
}
