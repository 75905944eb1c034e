use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use netcord_common::{
    rig::CameraIndex,
    wire::{ALL_CAMERAS, ControlCommand, ControlRequest, ControlResponse, ControlStatus},
};

use crate::source::{SourceControl, response};

/// What requests to a synthetic source change and ask for. Every order is relaxed: each value stands for itself.
#[derive(Debug)]
pub struct Control {
    running: AtomicBool,
    last_trigger: AtomicU64,
    cameras: Vec<Setting>,
    /// A camera cannot expose for longer than there is between two triggers.
    longest_ns: u64,
    /// Frames were rendered beforehand: nothing about them can be changed.
    fixed: bool,
}

#[derive(Debug)]
struct Setting {
    exposure_ns: AtomicU64,
    /// Bits of an f64, dB.
    gain_db: AtomicU64,
}

/// Shortest exposure, ns: no camera does less.
const SHORTEST_NS: u64 = 1000;
/// Gains that cameras have, dB.
const GAINS_DB: std::ops::RangeInclusive<f64> = 0.0..=48.0;

impl Control {
    /// For cameras with these exposures (ns) and gains (dB).
    pub fn new(settings: impl Iterator<Item = (u64, f64)>, longest_ns: u64, fixed: bool) -> Self {
        let cameras = settings
            .map(|(exposure_ns, gain_db)| Setting {
                exposure_ns: AtomicU64::new(exposure_ns),
                gain_db: AtomicU64::new(gain_db.to_bits()),
            })
            .collect();
        Self { running: AtomicBool::new(true), last_trigger: AtomicU64::new(0), cameras, longest_ns, fixed }
    }

    /// Whether frames are to be delivered.
    pub fn is_running(&self) -> bool {
        self.running.load(Ordering::Relaxed)
    }

    /// Takes note of a trigger.
    pub fn triggered(&self, trigger_id: u64) {
        self.last_trigger.fetch_max(trigger_id, Ordering::Relaxed);
    }

    /// Exposure, ns, and gain, dB, that are wanted of a camera.
    pub fn settings(&self, camera: CameraIndex) -> (u64, f64) {
        let setting = &self.cameras[camera.get()];
        let gain_db = f64::from_bits(setting.gain_db.load(Ordering::Relaxed));
        (setting.exposure_ns.load(Ordering::Relaxed), gain_db)
    }

    /// Carries `change` out for the cameras that a request speaks to; answers with `now`, what is then in force.
    fn change(&self, request: &ControlRequest, now: f64, change: impl Fn(&Setting)) -> ControlResponse {
        let cameras = match usize::try_from(request.camera) {
            _ if request.camera == ALL_CAMERAS => &self.cameras[..],
            Ok(place) if place < self.cameras.len() => &self.cameras[place..=place],
            _ => {
                let valid = self.cameras.len() - 1;
                let text = format!("there is no camera {}; valid are 0 to {valid}", request.camera);
                return response(ControlStatus::Invalid, &text);
            }
        };
        if self.fixed {
            let text = "the frames were rendered beforehand: start capture without --prerendered";
            return response(ControlStatus::NotSupported, text);
        }
        cameras.iter().for_each(change);
        let mut answer = response(ControlStatus::Done, "");
        answer.values[0] = now;
        answer
    }

    fn expose(&self, request: &ControlRequest) -> ControlResponse {
        let wanted = request.values[0];
        if !(SHORTEST_NS as f64..=self.longest_ns as f64).contains(&wanted) {
            let us = |ns: f64| ns * 1e-3;
            let text = format!(
                "an exposure of {} µs; valid are {} to {} µs",
                us(wanted),
                us(SHORTEST_NS as f64),
                us(self.longest_ns as f64)
            );
            return response(ControlStatus::Invalid, &text);
        }
        let exposure_ns = wanted.round() as u64;
        self.change(request, exposure_ns as f64, |s| s.exposure_ns.store(exposure_ns, Ordering::Relaxed))
    }

    fn amplify(&self, request: &ControlRequest) -> ControlResponse {
        let wanted = request.values[0];
        if !GAINS_DB.contains(&wanted) {
            let (least, most) = (GAINS_DB.start(), GAINS_DB.end());
            let text = format!("a gain of {wanted} dB; valid are {least} to {most}");
            return response(ControlStatus::Invalid, &text);
        }
        self.change(request, wanted, |s| s.gain_db.store(wanted.to_bits(), Ordering::Relaxed))
    }
}

impl SourceControl for Control {
    fn control(&self, request: &ControlRequest) -> ControlResponse {
        let mut answer = match ControlCommand::from_code(request.command) {
            Some(ControlCommand::Start) => {
                self.running.store(true, Ordering::Relaxed);
                response(ControlStatus::Done, "")
            }
            Some(ControlCommand::Stop) => {
                self.running.store(false, Ordering::Relaxed);
                response(ControlStatus::Done, "")
            }
            Some(ControlCommand::Status) => response(ControlStatus::Done, "a synthetic scene"),
            Some(ControlCommand::SetExposure) => self.expose(request),
            Some(ControlCommand::SetGain) => self.amplify(request),
            Some(_) => response(
                ControlStatus::NotSupported,
                "a synthetic scene knows start, stop, status, exposure and gain; its rate is an option of `netcord capture`",
            ),
            None => response(ControlStatus::Invalid, "this command is not known to this version"),
        };
        answer.running = u32::from(self.is_running());
        answer.trigger_id = self.last_trigger.load(Ordering::Relaxed);
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(command: ControlCommand, camera: u32, value: f64) -> ControlRequest {
        ControlRequest { command: command.code(), camera, values: [value, 0.0, 0.0, 0.0] }
    }

    #[test]
    fn exposure_and_gain_are_set_for_one_or_all_cameras_within_bounds() {
        let control = Control::new([(1_000_000, 0.0), (1_000_000, 3.0)].into_iter(), 9_000_000, false);
        let camera = |place: usize| control.settings(CameraIndex::new(place).expect("few"));
        let ask = |command, camera, value| {
            let answer = control.control(&request(command, camera, value));
            (ControlStatus::from_code(answer.status).expect("known"), answer)
        };
        let (status, answer) = ask(ControlCommand::SetExposure, 1, 2e6);
        assert_eq!((status, answer.values[0], answer.running), (ControlStatus::Done, 2e6, 1));
        assert_eq!((camera(0), camera(1)), ((1_000_000, 0.0), (2_000_000, 3.0)));
        ask(ControlCommand::SetGain, ALL_CAMERAS, 6.0);
        assert_eq!((camera(0).1, camera(1).1), (6.0, 6.0));
        for (command, place, value) in [
            (ControlCommand::SetExposure, 0, 1e7),
            (ControlCommand::SetExposure, 0, f64::NAN),
            (ControlCommand::SetExposure, 2, 1e6),
            (ControlCommand::SetGain, 0, -1.0),
        ] {
            let (status, answer) = ask(command, place, value);
            assert_eq!(status, ControlStatus::Invalid);
            assert!(answer.text.as_str().contains("valid are"), "{}", answer.text.as_str());
        }
        assert_eq!(camera(0), (1_000_000, 6.0), "nothing of it was done");
        let fixed = Control::new([(1_000_000, 0.0)].into_iter(), 9_000_000, true);
        let answer = fixed.control(&request(ControlCommand::SetGain, 0, 6.0));
        assert_eq!(ControlStatus::from_code(answer.status), Some(ControlStatus::NotSupported));
    }
}
