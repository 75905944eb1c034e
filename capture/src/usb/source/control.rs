use std::sync::{Arc, atomic::Ordering};

use netcord_common::{
    Clock, MonotonicClock,
    rig::{Rig, TriggerRole},
    wire::{ALL_CAMERAS, ControlCommand, ControlRequest, ControlResponse, ControlStatus},
};

use super::{Shared, lock};
use crate::{
    SourceControl, response,
    usb::{
        CameraError, FeatureAccess,
        device::Camera,
        genapi::FeatureError,
        settings::{InForce, is_host_triggered, set_exposure, set_gain, set_rate, set_white_balance},
    },
};

/// Answers `rig/control` for cameras on USB.
#[derive(Debug)]
pub(super) struct UsbControl {
    pub(super) rig: Rig,
    pub(super) shared: Arc<Shared>,
}

impl UsbControl {
    /// Runs `work` on the cameras that a request speaks to.
    fn each(
        &self,
        request: &ControlRequest,
        mut work: impl FnMut(&mut Camera, &mut InForce, usize) -> Result<[f64; 4], CameraError>,
    ) -> ControlResponse {
        let mut values = request.values;
        for (index, state) in self.shared.cameras.iter().enumerate() {
            if request.camera != ALL_CAMERAS && request.camera as usize != index {
                continue;
            }
            let mut device = lock(&state.device);
            let Some(open) = device.as_mut() else {
                let text = format!("camera {} is not there", self.rig.cameras[index].name);
                return self.answer(ControlStatus::Failed, values, &text);
            };
            let mut in_force = *lock(&open.in_force);
            match work(&mut open.camera, &mut in_force, index) {
                Ok(now) => values = now,
                Err(e) => {
                    let status = match &e {
                        CameraError::Feature(
                            FeatureError::OutOfRange { .. } | FeatureError::NoEntry { .. },
                        ) => ControlStatus::Invalid,
                        CameraError::Feature(f) if f.is_absent() => ControlStatus::NotSupported,
                        _ => ControlStatus::Failed,
                    };
                    return self.answer(status, values, &e.to_string());
                }
            }
            *lock(&open.in_force) = in_force;
        }
        self.answer(ControlStatus::Done, values, "")
    }

    fn answer(&self, status: ControlStatus, values: [f64; 4], text: &str) -> ControlResponse {
        let (next, _) = lock(&self.shared.matcher).grid().next(MonotonicClock.now().as_ns());
        ControlResponse {
            running: self.shared.running.load(Ordering::Relaxed).into(),
            values,
            trigger_id: next.saturating_sub(1),
            ..response(status, text)
        }
    }

    fn rate(&self, request: &ControlRequest) -> ControlResponse {
        let hz = request.values[0];
        if !(hz.is_finite() && (0.1..=2000.0).contains(&hz)) {
            return self.answer(ControlStatus::Invalid, request.values, "a rate is 0.1 to 2000 Hz");
        }
        let all = ControlRequest { camera: ALL_CAMERAS, ..*request };
        let answer = self.each(&all, |camera, _, index| {
            if self.rig.cameras[index].trigger == TriggerRole::FreeRun {
                set_rate(camera, hz)?;
            }
            Ok([hz, 0.0, 0.0, 0.0])
        });
        if answer.status == ControlStatus::Done.code() {
            lock(&self.shared.matcher).set_interval(MonotonicClock.now().as_ns(), (1e9 / hz) as u64);
        }
        answer
    }

    fn region(&self, request: &ControlRequest) -> ControlResponse {
        let [x, y, width, height] = request.values.map(|v| v as i64);
        let answer = self.each(request, |camera, in_force, index| {
            let full = &self.rig.cameras[index].model;
            if width < 1 || height < 1 || width > i64::from(full.width) || height > i64::from(full.height) {
                let text =
                    format!("a region has at most {} × {} px, as the rig file says", full.width, full.height);
                return Err(CameraError::Setup(text));
            }
            // While the stream runs, sizes are locked.
            camera.quiet()?;
            for (name, value) in [
                ("OffsetX", 0),
                ("OffsetY", 0),
                ("Width", width),
                ("Height", height),
                ("OffsetX", x),
                ("OffsetY", y),
            ] {
                camera.set(name, &value.to_string())?;
            }
            in_force.width = u32::try_from(camera.get_int("Width")?).unwrap_or(0);
            in_force.height = u32::try_from(camera.get_int("Height")?).unwrap_or(0);
            Ok(request.values)
        });
        // Also after a refusal: the stream has been stopped for it.
        for (index, state) in self.shared.cameras.iter().enumerate() {
            if request.camera == ALL_CAMERAS || request.camera as usize == index {
                state.restart.store(true, Ordering::Relaxed);
            }
        }
        answer
    }
}

impl SourceControl for UsbControl {
    fn control(&self, request: &ControlRequest) -> ControlResponse {
        let known = request.camera == ALL_CAMERAS || (request.camera as usize) < self.rig.cameras.len();
        if !known {
            let text = format!("there is no camera {}", request.camera);
            return self.answer(ControlStatus::Invalid, request.values, &text);
        }
        match ControlCommand::from_code(request.command) {
            Some(ControlCommand::Status) => self.answer(ControlStatus::Done, request.values, ""),
            Some(ControlCommand::Start) => {
                self.shared.running.store(true, Ordering::Relaxed);
                self.answer(ControlStatus::Done, request.values, "")
            }
            Some(ControlCommand::Stop) => {
                self.shared.running.store(false, Ordering::Relaxed);
                self.answer(ControlStatus::Done, request.values, "")
            }
            Some(ControlCommand::Trigger) => self.each(request, |camera, _, index| {
                if is_host_triggered(&self.rig.cameras[index]) {
                    camera.execute("TriggerSoftware")?;
                }
                Ok(request.values)
            }),
            Some(ControlCommand::SetExposure) => self.each(request, |camera, in_force, _| {
                in_force.exposure_ns = set_exposure(camera, request.values[0].max(0.0) as u64)?;
                Ok([in_force.exposure_ns as f64, 0.0, 0.0, 0.0])
            }),
            Some(ControlCommand::SetGain) => self.each(request, |camera, in_force, _| {
                in_force.gain_db = set_gain(camera, request.values[0])?;
                Ok([in_force.gain_db, 0.0, 0.0, 0.0])
            }),
            Some(ControlCommand::SetWhiteBalance) => self.each(request, |camera, _, _| {
                set_white_balance(camera, request.values[0], request.values[1])?;
                Ok(request.values)
            }),
            Some(ControlCommand::SetRate) => self.rate(request),
            Some(ControlCommand::SetRegion) => self.region(request),
            None => self.answer(ControlStatus::NotSupported, request.values, "this command is not known"),
        }
    }
}
