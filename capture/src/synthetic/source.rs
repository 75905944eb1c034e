use std::{sync::Arc, thread};

use netcord_common::{
    Clock, MonotonicClock, Shutdown,
    bus::{BusError, FrameSlot},
    realtime,
    rig::{CameraIndex, Rig, RigCamera},
    wire::{BallTruth, CameraTruth, FrameHeader, Stamps},
};
use thiserror::Error;

use super::{
    control::Control,
    faults::{self, Fault, FaultError, FaultPlan},
    pool::FramePool,
    render::{Exposure, FrameRenderer},
    scene::{Scene, SceneError, SceneOptions},
    truth::{TruthDesk, truth_domain},
};
use crate::{
    pace::{sleep_until, wake_precisely},
    sink::{FrameSink, LossReason},
    source::{FrameSource, SourceControl, SourceError},
};

/// How the synthetic source runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SyntheticOptions {
    /// The scene.
    pub scene: SceneOptions,
    /// Exposures a second, in place of the rig's.
    pub rate_hz: Option<f64>,
    /// Publish this many frames rendered beforehand, round and round, in place of fresh ones.
    pub prerendered: Option<usize>,
    /// Time from the end of the exposure until the frame is complete, ns: what a camera's link takes.
    pub transfer_ns: u64,
    /// Frames of each camera after which the source ends.
    pub frames: Option<u64>,
    /// What goes wrong.
    pub faults: Vec<Fault>,
}

/// Why there is no such source.
#[derive(Debug, Error)]
pub enum SyntheticError {
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A fault.
    #[error(transparent)]
    Fault(#[from] FaultError),
    /// A rate that cannot be.
    #[error("a rate of {0} Hz cannot be kept; valid are 0.1 to 10000")]
    Rate(f64),
}

/// Renders a scene into frames of every camera of a rig: a [`FrameSource`].
#[derive(Debug)]
pub struct SyntheticSource {
    rig: Rig,
    scene: Arc<Scene>,
    options: SyntheticOptions,
    interval_ns: u64,
    cameras: Vec<Stand>,
    control: Arc<Control>,
}

/// One camera with what it needs to render.
#[derive(Debug)]
struct Stand {
    camera: RigCamera,
    /// What is in force.
    exposure_ns: u64,
    /// What the scene's light is made for.
    native_ns: u64,
    native_gain_db: f64,
    renderer: FrameRenderer,
    pool: Option<FramePool>,
    plan: FaultPlan,
}

impl SyntheticSource {
    /// Makes the scene and renders what stands still in it.
    ///
    /// # Errors
    /// [`SyntheticError`].
    pub fn new(rig: &Rig, options: SyntheticOptions) -> Result<Self, SyntheticError> {
        faults::check(&options.faults, rig)?;
        let rate_hz = options.rate_hz.unwrap_or(rig.rate_hz);
        if !(0.1..=10_000.0).contains(&rate_hz) {
            return Err(SyntheticError::Rate(rate_hz));
        }
        let interval_ns = (1e9 / rate_hz).round() as u64;
        let scene = Arc::new(Scene::new(rig, &options.scene)?);
        let cameras: Vec<Stand> = rig
            .cameras
            .iter()
            .map(|camera| {
                let mut renderer = FrameRenderer::new(&scene, camera);
                // A camera cannot expose for longer than there is between two triggers.
                let exposure_ns = scene.exposure_ns.unwrap_or(camera.exposure_ns).min(interval_ns * 9 / 10);
                let pool = options.prerendered.map(|count| {
                    FramePool::new(&mut renderer, count, interval_ns as f64 * 1e-9, exposure_ns as f64 * 1e-9)
                });
                let plan = FaultPlan::of(&options.faults, rig, camera.index, scene.seed);
                let (camera, native_ns) = (camera.clone(), exposure_ns);
                Stand { native_gain_db: camera.gain_db, camera, exposure_ns, native_ns, renderer, pool, plan }
            })
            .collect();
        let settings = cameras.iter().map(|stand| (stand.exposure_ns, stand.camera.gain_db));
        let longest_ns = interval_ns * 9 / 10;
        let control = Arc::new(Control::new(settings, longest_ns, options.prerendered.is_some()));
        Ok(Self { rig: rig.clone(), scene, options, interval_ns, cameras, control })
    }

    /// The scene.
    pub const fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }
}

/// From the start of the source to the first exposure, ns: threads are up by then.
const LEAD_NS: u64 = 20_000_000;

/// Frames held back by faults at a time; a slot held is a slot on loan.
const HELD: usize = 4;

impl FrameSource for SyntheticSource {
    fn slot_bytes(&self, camera: CameraIndex) -> usize {
        let model = &self.rig.cameras[camera.get()].model;
        model.width as usize * model.height as usize
    }

    fn control(&self) -> Arc<dyn SourceControl> {
        Arc::clone(&self.control) as Arc<dyn SourceControl>
    }

    fn run(&mut self, sink: &FrameSink, stop: &Shutdown) -> Result<(), SourceError> {
        let domain = truth_domain(sink.bus().domain()).map_err(SourceError::failed)?;
        let truth = TruthDesk::open(&domain, self.rig.camera_mask())?;
        let shift = Shift {
            sink,
            stop,
            truth: &truth,
            control: &self.control,
            interval_ns: self.interval_ns,
            transfer_ns: self.options.transfer_ns,
            frames: self.options.frames.unwrap_or(u64::MAX),
            begin_ns: MonotonicClock.now().as_ns() + LEAD_NS,
        };
        thread::scope(|scope| {
            let shift = &shift;
            let threads: Vec<_> = self
                .cameras
                .iter_mut()
                .map(|stand| {
                    scope.spawn(move || {
                        // A camera takes no processor from the stages. Stepping back needs no right; were it
                        // refused all the same, frames would be rendered as before.
                        if stand.pool.is_none() {
                            let _ = realtime::step_back(RENDERING_NICENESS);
                        }
                        let ended = stand.work(shift);
                        if ended.is_err() {
                            shift.stop.request();
                        }
                        ended
                    })
                })
                .collect();
            let mut result = Ok(());
            for thread in threads {
                let ended = thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                result = result.and(ended.map_err(SourceError::Bus));
            }
            result
        })
    }
}

/// What the threads of all cameras share.
struct Shift<'a> {
    sink: &'a FrameSink,
    stop: &'a Shutdown,
    truth: &'a TruthDesk,
    control: &'a Control,
    interval_ns: u64,
    transfer_ns: u64,
    frames: u64,
    begin_ns: u64,
}

impl Shift<'_> {
    /// The middle of exposure `n`, ns.
    fn mid_ns(&self, n: u64) -> u64 {
        self.begin_ns + n * self.interval_ns
    }
}

/// The last part of each interval, in which the next frame is rendered.
const RENDERING_PERCENT: u64 = 80;
/// By how much rendering steps back behind the stages.
const RENDERING_NICENESS: i32 = 5;

/// A frame that a fault holds back.
struct Held {
    due_ns: u64,
    slot: FrameSlot,
}

impl Stand {
    /// Delivers frame after frame. Each is rendered before its exposure would end, and handed over on
    /// the instant: so rendering adds nothing to the latency that is measured.
    fn work(&mut self, shift: &Shift<'_>) -> Result<(), BusError> {
        wake_precisely();
        let mut held: Vec<Held> = Vec::with_capacity(HELD);
        let mut n = 0;
        while n < shift.frames && !shift.stop.is_requested() {
            // Triggers that have gone by while the machine was busy are lost, and said to be.
            let late_ns = MonotonicClock.now().as_ns().saturating_sub(shift.mid_ns(n));
            for _ in 0..late_ns / shift.interval_ns {
                if shift.stop.is_requested() {
                    break;
                }
                self.miss(n, shift)?;
                n += 1;
            }
            self.adjust(shift.control);
            self.expose(n, shift, &mut held)?;
            n += 1;
        }
        for Held { slot, .. } in held.drain(..) {
            shift.sink.deliver(self.camera.index, slot)?;
        }
        Ok(())
    }

    /// Takes over what has been asked for.
    fn adjust(&mut self, control: &Control) {
        let (exposure_ns, gain_db) = control.settings(self.camera.index);
        if exposure_ns != self.exposure_ns || gain_db != self.camera.gain_db {
            (self.exposure_ns, self.camera.gain_db) = (exposure_ns, gain_db);
            let amplification = 10.0_f64.powf((gain_db - self.native_gain_db) / 20.0);
            self.renderer.set_sensitivity(exposure_ns as f64 / self.native_ns as f64, amplification);
        }
    }

    fn miss(&mut self, n: u64, shift: &Shift<'_>) -> Result<(), BusError> {
        if !shift.control.is_running() {
            return Ok(());
        }
        let exposure = self.exposure(n, 0, shift);
        let seen = match &self.pool {
            Some(pool) => pool.truth(n),
            None => self.renderer.glance(&exposure),
        };
        self.tell(n, seen, shift)?;
        shift.sink.lost(self.camera.index, shift.sink.first_trigger_id() + n, LossReason::Overrun)
    }

    fn expose(&mut self, n: u64, shift: &Shift<'_>, held: &mut Vec<Held>) -> Result<(), BusError> {
        let camera = self.camera.index;
        let trigger_id = shift.sink.first_trigger_id() + n;
        let fate = self.plan.fate(n);
        let mid_ns = shift.mid_ns(n).saturating_add_signed(fate.desync_ns);
        let complete_ns = mid_ns + self.exposure_ns / 2 + shift.transfer_ns;
        if !shift.control.is_running() {
            sleep_until(complete_ns, shift.stop);
            return Ok(());
        }
        shift.control.triggered(trigger_id);
        // Just after a trigger the stages work: a renderer that took their cores then would be measured as latency,
        // which no camera causes. The first frame follows no other, and takes longer: its memory is new.
        let begin_ns = complete_ns.saturating_sub(shift.interval_ns * RENDERING_PERCENT / 100);
        if n > 0 && !sleep_until(begin_ns, shift.stop) {
            return Ok(());
        }

        let exposure = self.exposure(n, fate.desync_ns, shift);
        let bytes = self.camera.model.width as usize * self.camera.model.height as usize;
        let loaned = match fate.truncated {
            Some(_) => None,
            None if fate.dropped => None,
            None => match shift.sink.loan(camera) {
                Ok(slot) => Some(slot),
                Err(BusError::NoSlot { .. }) => None,
                Err(e) => return Err(e),
            },
        };
        let (slot, seen) = match loaned {
            Some(mut slot) => {
                let seen = match &mut self.pool {
                    Some(pool) => pool.write(n, slot.bytes_mut()),
                    None => self.renderer.render(&exposure, slot.bytes_mut()),
                };
                (Some(slot), seen)
            }
            None => (None, self.pool.as_ref().map_or_else(|| self.renderer.truth(&exposure), |p| p.truth(n))),
        };
        self.tell(n, seen, shift)?;

        self.release(complete_ns, shift, held)?;
        if !sleep_until(complete_ns, shift.stop) {
            return Ok(());
        }
        let header = |complete_ns: u64| FrameHeader {
            trigger_id,
            stamps: Stamps {
                mid_exposure_ns: mid_ns,
                mid_exposure_host_ns: mid_ns,
                frame_complete_ns: complete_ns,
                ..Stamps::default()
            },
            exposure_ns: self.exposure_ns,
            block_id: n,
            gain_db: self.camera.gain_db,
            width: self.camera.model.width,
            height: self.camera.model.height,
            stride: self.camera.model.width,
            pixel_format: self.camera.pixel_format.pfnc(),
            ..FrameHeader::default()
        };
        let now = MonotonicClock.now().as_ns();
        match (slot, fate.truncated) {
            (Some(mut slot), _) => {
                *slot.header_mut() = header(now);
                if fate.duplicated {
                    self.duplicate(&slot, shift)?;
                }
                if (fate.delay_ns > 0 || fate.reordered) && held.len() < HELD {
                    // A reordered frame is let go a tenth of an interval after its successor.
                    let reorder_ns = if fate.reordered { shift.interval_ns * 11 / 10 } else { 0 };
                    held.push(Held { due_ns: now + fate.delay_ns.max(reorder_ns), slot });
                    Ok(())
                } else {
                    shift.sink.deliver(camera, slot)
                }
            }
            (None, Some(share)) => {
                let part = ((bytes as f64 * share) as usize).clamp(1, bytes - 1);
                match shift.sink.loan_bytes(camera, part) {
                    Ok(mut slot) => {
                        *slot.header_mut() = header(now);
                        shift.sink.deliver(camera, slot)
                    }
                    Err(BusError::NoSlot { .. }) => shift.sink.lost(camera, trigger_id, LossReason::NoSlot),
                    Err(e) => Err(e),
                }
            }
            (None, None) => {
                let reason = if fate.dropped { LossReason::Dropped } else { LossReason::NoSlot };
                shift.sink.lost(camera, trigger_id, reason)
            }
        }
    }

    fn exposure(&self, n: u64, desync_ns: i64, shift: &Shift<'_>) -> Exposure {
        Exposure {
            frame: n,
            mid_s: (n * shift.interval_ns) as f64 * 1e-9 + desync_ns as f64 * 1e-9,
            length_s: self.exposure_ns as f64 * 1e-9,
        }
    }

    /// Delivers the same frame a second time: a fault, so it may cost a copy.
    fn duplicate(&self, slot: &FrameSlot, shift: &Shift<'_>) -> Result<(), BusError> {
        let Ok(mut twin) = shift.sink.loan(self.camera.index) else { return Ok(()) };
        twin.bytes_mut().copy_from_slice(slot.bytes());
        *twin.header_mut() = *slot.header();
        shift.sink.deliver(self.camera.index, twin)
    }

    /// Delivers held frames that are due before `until_ns`, each at its time.
    fn release(&self, until_ns: u64, shift: &Shift<'_>, held: &mut Vec<Held>) -> Result<(), BusError> {
        while let Some(index) =
            (0..held.len()).filter(|i| held[*i].due_ns <= until_ns).min_by_key(|i| held[*i].due_ns)
        {
            let Held { due_ns, mut slot } = held.swap_remove(index);
            sleep_until(due_ns, shift.stop);
            slot.header_mut().stamps.frame_complete_ns = MonotonicClock.now().as_ns();
            shift.sink.deliver(self.camera.index, slot)?;
        }
        Ok(())
    }

    /// Tells the truth of trigger `n`, as far as this camera sees it.
    fn tell(&mut self, n: u64, seen: CameraTruth, shift: &Shift<'_>) -> Result<(), BusError> {
        let (ball, round) = match &self.pool {
            Some(pool) => pool.ball(n),
            None => (self.renderer.ball_at((n * shift.interval_ns) as f64 * 1e-9), 0),
        };
        /// More flights than are rendered beforehand, so that their ids stay apart from round to round.
        const FLIGHTS_A_ROUND: u64 = 1_000_000;
        let truth = BallTruth {
            trigger_id: shift.sink.first_trigger_id() + n,
            mid_exposure_ns: shift.mid_ns(n),
            flight_id: ball.map_or(0, |b| b.flight_id + round * FLIGHTS_A_ROUND),
            position_m: ball.map_or([0.0; 3], |b| b.state.position.into()),
            velocity_m_s: ball.map_or([0.0; 3], |b| b.state.velocity.into()),
            spin_rad_s: ball.map_or([0.0; 3], |b| b.state.spin.into()),
            present: u32::from(ball.is_some()),
            ..BallTruth::default()
        };
        shift.truth.add(&truth, self.camera.index, seen)
    }
}

#[cfg(test)]
mod tests {
    use std::{
        sync::atomic::{AtomicBool, Ordering},
        time::Duration,
    };

    use netcord_common::{
        Counters, DomainName,
        bus::{Bus, DomainRemains, Topic},
    };

    use super::*;
    use crate::synthetic::test_rig;

    /// Runs 60 frames of two cameras with faults; returns the counters and the truths.
    fn run(name: &str, faults: &[&str], prerendered: Option<usize>) -> (Vec<(String, u64)>, Vec<BallTruth>) {
        let domain = DomainName::new(format!("{name}-{}", std::process::id())).expect("valid");
        let truths = truth_domain(&domain).expect("short");
        let rig = test_rig();
        let options = SyntheticOptions {
            rate_hz: Some(100.0),
            frames: Some(60),
            faults: faults.iter().map(|f| f.parse().expect("valid")).collect(),
            prerendered,
            ..SyntheticOptions::default()
        };
        let mut source = SyntheticSource::new(&rig, options).expect("valid");
        let counters = Counters::new();
        let done = AtomicBool::new(false);
        let heard = thread::scope(|scope| {
            let listening = scope.spawn(|| {
                let bus = Bus::join(&truths, "test").expect("joined");
                let truth = bus.subscriber(&Topic::truth()).expect("opened");
                let mut heard = Vec::new();
                while !done.load(Ordering::Relaxed) {
                    truth.wait(Duration::from_millis(5)).expect("waited");
                    heard.extend(std::iter::from_fn(|| truth.receive().expect("received")));
                }
                heard
            });
            let bus = Bus::join(&domain, "test").expect("joined");
            crate::run(&bus, &rig, &mut source, &Shutdown::new(), &counters).expect("runs to its end");
            done.store(true, Ordering::Relaxed);
            listening.join().expect("listened")
        });
        DomainRemains::of(&domain).remove().expect("removed");
        DomainRemains::of(&truths).remove().expect("removed");
        (counters.snapshot(), heard)
    }

    fn count(counters: &[(String, u64)], name: &str) -> u64 {
        counters.iter().find(|(n, _)| n == name).unwrap_or_else(|| panic!("no counter {name}")).1
    }

    #[test]
    fn faults_are_counted_by_reason_and_every_trigger_gets_a_verdict_and_its_truth() {
        let (c, truths) = run(
            "faults",
            &["drop,camera=left,every=10", "truncate,camera=right,every=15", "duplicate,every=7"],
            None,
        );
        // The last may be gone with their publisher, the first before the listener was there.
        assert!(truths.len() > 40, "{} truths", truths.len());
        assert!(truths.windows(2).all(|w| w[1].trigger_id == w[0].trigger_id + 1));
        let late = count(&c, "lost_overrun");
        assert_eq!(count(&c, "left/frames_published") + count(&c, "left/frames_lost"), 60);
        assert_eq!(count(&c, "right/frames_published") + count(&c, "right/frames_lost"), 60);
        // A busy machine may leave triggers out; those are told apart.
        assert!((6 - late.min(6)..=6).contains(&count(&c, "lost_dropped")));
        assert!((4 - late.min(4)..=4).contains(&count(&c, "lost_truncated")));
        assert!(count(&c, "lost_duplicate") + late >= 10);
        let verdicts =
            ["complete", "incomplete", "unsynchronised"].map(|v| count(&c, &format!("framesets_{v}")));
        assert_eq!(verdicts.iter().sum::<u64>(), 60, "{verdicts:?}");
        assert!(verdicts[1] >= 8);
    }

    #[test]
    fn a_camera_exposed_too_late_is_unsynchronised_and_prerendered_frames_flow() {
        let (c, truths) = run("desync", &["desync,camera=right,us=1500,every=2"], Some(20));
        assert!(truths.len() > 40, "{} truths", truths.len());
        let late = count(&c, "lost_overrun");
        assert!(count(&c, "framesets_unsynchronised") + late >= 30, "{c:?}");
        assert!(count(&c, "framesets_complete") + late >= 30, "{c:?}");
    }
}
