//! The rows of the test.

use std::{collections::BTreeMap, error::Error, path::Path};

use netcord_capture::usb::{Camera, FeatureAccess, discover};
use netcord_common::{
    Clock, MonotonicClock,
    rig::Rig,
    wire::{ControlCommand, ControlRequest},
};

use crate::{
    Options, Outcome, ensure,
    harness::{Run, Seen, capture},
};

fn set_faults(rig: &Rig, camera: usize, plan: &str) -> Result<(), Box<dyn Error>> {
    let context = rusb::Context::new()?;
    let mut device = Camera::open(&context, &rig.cameras[camera].serial)?;
    Ok(device.set("FaultPlan", plan)?)
}

fn largest_gap_ms(seen: &Seen) -> f64 {
    seen.arrivals.windows(2).map(|w| w[1].saturating_sub(w[0])).max().unwrap_or(0) as f64 / 1e6
}

fn contents_right(run: &Run) -> Result<(), Box<dyn Error>> {
    for (index, seen) in run.cameras.iter().enumerate() {
        ensure(seen.wrong.is_empty(), || format!("camera {index}: wrong content: {:?}", seen.wrong))?;
        let ids: Vec<u64> = seen.headers.iter().map(|h| h.trigger_id).collect();
        ensure(ids.windows(2).all(|w| w[0] < w[1]), || format!("camera {index}: trigger ids {ids:?}"))?;
    }
    Ok(())
}

fn counts(run: &Run) -> String {
    let frames: Vec<usize> = run.cameras.iter().map(|c| c.headers.len()).collect();
    let some: Vec<String> =
        run.counters.iter().filter(|(_, v)| **v > 0).map(|(k, v)| format!("{k}={v}")).collect();
    format!("frames {frames:?}, framesets {:?}, {}", run.verdicts, some.join(" "))
}

/// Without faults every frame of every trigger arrives, right and matched.
pub(crate) fn clean(rig: &Rig, o: &Options) -> Outcome {
    let ms = o.number("ms", 3000);
    let run = capture(rig, o.number("depth", 4) as usize, ms, |_, _| {})?;
    let detail = counts(&run);
    contents_right(&run).map_err(|e| format!("{e}; {detail}"))?;
    // The cameras open one after the other, and the last trigger may be under way at the end.
    let triggers = (ms as f64 / 1e3 - 0.8) * rig.rate_hz * 0.95;
    for (index, seen) in run.cameras.iter().enumerate() {
        ensure(seen.headers.len() as f64 >= triggers, || format!("camera {index} is short; {detail}"))?;
        let blocks: Vec<u64> = seen.headers.iter().map(|h| h.block_id).collect();
        ensure(blocks.windows(2).all(|w| w[1] == w[0] + 1), || {
            format!("camera {index}: blocks {blocks:?}; {detail}")
        })?;
        let ids: Vec<u64> = seen.headers.iter().map(|h| h.trigger_id).collect();
        ensure(ids.windows(2).all(|w| w[1] == w[0] + 1), || {
            format!("camera {index}: ids {ids:?}; {detail}")
        })?;
    }
    let mut skew = 0_u64;
    let first: BTreeMap<u64, u64> =
        run.cameras[0].headers.iter().map(|h| (h.trigger_id, h.stamps.mid_exposure_ns)).collect();
    for h in run.cameras.iter().skip(1).flat_map(|c| &c.headers) {
        if let Some(mid) = first.get(&h.trigger_id) {
            skew = skew.max(mid.abs_diff(h.stamps.mid_exposure_ns));
        }
    }
    let limit = o.number("skew-us", 5_000);
    let frames = run.cameras.iter().map(|c| c.headers.len() as u64).min().unwrap_or(0);
    ensure(frames >= o.number("frames", 1), || format!("only {frames} frames; {detail}"))?;
    ensure(skew / 1000 <= limit, || format!("skew {} µs; {detail}", skew / 1000))?;
    Ok(format!("{detail}, largest skew {} µs", skew / 1000))
}

fn wanted_lost(o: &Options) -> u64 {
    o.number("lost", 1)
}

/// A fault loses its frame and no other, and is counted once; the other camera does not notice.
pub(crate) fn fault(rig: &Rig, o: &Options) -> Outcome {
    let plan = o.text("plan");
    set_faults(rig, 0, plan)?;
    let ms = o.number("ms", 2600);
    let run = capture(rig, o.number("depth", 4) as usize, ms, |_, _| {})?;
    let detail = counts(&run);
    contents_right(&run).map_err(|e| format!("{e}; {detail}"))?;
    let interval = 1e3 / rig.rate_hz;
    let gap = largest_gap_ms(&run.cameras[0]);
    // The frame is lost, so that two intervals are the least.
    let limit = interval * (1.0 + wanted_lost(o) as f64) + o.number("within-ms", 50) as f64;
    ensure(gap <= limit, || {
        format!("{gap:.1} ms without a frame, at most {limit:.1} are allowed; {detail}")
    })?;
    ensure(gap > interval * 1.5, || format!("the fault did not strike: largest gap {gap:.1} ms; {detail}"))?;
    let blocks: Vec<u64> = run.cameras[0].headers.iter().map(|h| h.block_id).collect();
    let lost: u64 = blocks.windows(2).map(|w| w[1].saturating_sub(w[0] + 1)).sum();
    let wanted = wanted_lost(o);
    ensure(lost == wanted, || format!("{lost} frames lost instead of {wanted}; {detail}"))?;
    let counted = run.counters.get(&format!("{}/frames_lost", rig.cameras[0].name)).copied().unwrap_or(0);
    ensure(counted == lost, || format!("{counted} frames counted as lost; {detail}"))?;
    if let Some(other) = run.cameras.get(1) {
        let gap = largest_gap_ms(other);
        ensure(gap <= interval * 2.2, || format!("the other camera paused {gap:.1} ms; {detail}"))?;
    }
    Ok(format!("{lost} lost, largest gap {gap:.1} ms; {detail}"))
}

/// A slave misses one impulse of its master, and does not count it: its next frame is matched with the right
/// one of the master's again.
pub(crate) fn slip(rig: &Rig, o: &Options) -> Outcome {
    set_faults(rig, 1, "miss-trigger@20")?;
    let run = capture(rig, 4, o.number("ms", 3000), |_, _| {})?;
    let detail = counts(&run);
    contents_right(&run).map_err(|e| format!("{e}; {detail}"))?;
    let by_trigger = |seen: &Seen| -> BTreeMap<u64, (u64, u64)> {
        seen.headers.iter().map(|h| (h.trigger_id, (h.block_id, h.stamps.mid_exposure_ns))).collect()
    };
    let (master, slave) = (by_trigger(&run.cameras[0]), by_trigger(&run.cameras[1]));
    // By how many frames the slave is behind, trigger by trigger.
    let mut behind = Vec::new();
    for (trigger, (block, mid)) in &master {
        let Some((other, other_mid)) = slave.get(trigger) else { continue };
        let skew = mid.abs_diff(*other_mid);
        ensure(skew < 1_000_000, || format!("trigger {trigger}: {skew} ns apart; {detail}"))?;
        behind.push(block.wrapping_sub(*other).cast_signed());
    }
    let steps: Vec<i64> = behind.windows(2).map(|w| w[1] - w[0]).filter(|step| *step != 0).collect();
    ensure(steps == [1], || format!("the slave fell behind by {steps:?}; {detail}"))?;
    let missing = master.keys().filter(|id| !slave.contains_key(id)).filter(|id| {
        slave.keys().next().is_some_and(|first| first < *id)
            && slave.keys().last().is_some_and(|last| *id < last)
    });
    let missing = missing.count();
    ensure(missing == 1, || format!("{missing} frames of the slave are missing; {detail}"))?;
    let slips = run.counters.get("usb_slips").copied().unwrap_or(0);
    ensure(slips == 1, || format!("{slips} slips counted; {detail}"))?;
    Ok(format!("matched again with the next frame; {detail}"))
}

/// Unplugged and plugged in again by somebody else: frames again, the other camera undisturbed.
pub(crate) fn replug(rig: &Rig, o: &Options) -> Outcome {
    set_faults(rig, 0, "unplug@12")?;
    let run = capture(rig, 4, o.number("ms", 7000), |_, _| {})?;
    let detail = counts(&run);
    contents_right(&run).map_err(|e| format!("{e}; {detail}"))?;
    let gap = largest_gap_ms(&run.cameras[0]);
    ensure(gap > 200.0, || format!("it was not unplugged; {detail}"))?;
    // Attaching and enumerating are the guest's; its loop looks every 0.2 s and Linux takes 0.5 s.
    ensure(gap < 3500.0, || format!("{gap:.0} ms without frames; {detail}"))?;
    ensure(run.cameras[0].headers.len() > 40, || format!("too few frames; {detail}"))?;
    let blocks = &run.cameras[0].headers;
    let ids: u64 = blocks.windows(2).map(|w| w[1].trigger_id - w[0].trigger_id - 1).sum();
    let counted = run.counters.get(&format!("{}/frames_lost", rig.cameras[0].name)).copied().unwrap_or(0);
    ensure(counted == ids, || format!("{counted} frames counted as lost of {ids}; {detail}"))?;
    if let Some(other) = run.cameras.get(1) {
        let pause = largest_gap_ms(other);
        ensure(pause <= 2.5e3 / rig.rate_hz, || format!("the other camera paused {pause:.1} ms; {detail}"))?;
    }
    Ok(format!("frames again after {gap:.0} ms; {detail}"))
}

/// Exposure, gain, rate, white balance and region change while frames flow.
pub(crate) fn control(rig: &Rig, _: &Options) -> Outcome {
    let request = |command: ControlCommand, values: [f64; 4]| ControlRequest {
        command: command.code(),
        camera: u32::MAX,
        values,
    };
    let mut plan = vec![
        (1200, request(ControlCommand::SetExposure, [3e6, 0.0, 0.0, 0.0])),
        (1600, request(ControlCommand::SetGain, [6.0, 0.0, 0.0, 0.0])),
        (1800, request(ControlCommand::SetWhiteBalance, [1.5, 2.0, 0.0, 0.0])),
        (2000, request(ControlCommand::SetExposure, [1e12, 0.0, 0.0, 0.0])),
        (2200, request(ControlCommand::SetRegion, [64.0, 32.0, 160.0, 96.0])),
        (3200, request(ControlCommand::SetRate, [5.0, 0.0, 0.0, 0.0])),
    ];
    plan.reverse();
    let mut answers = Vec::new();
    let mut run = capture(rig, 3, 5000, |past, ask| {
        if plan.last().is_some_and(|(at, _)| *at <= past) {
            let (_, request) = plan.pop().unwrap_or_default();
            answers.push(ask(&request));
        }
    })?;
    run.answers = answers;
    let detail = format!("{:?}; {}", run.answers, counts(&run));
    contents_right(&run).map_err(|e| format!("{e}; {detail}"))?;
    let wanted = ["done", "done", "done", "invalid", "done", "done"];
    let got: Vec<&str> = run.answers.iter().map(|a| a.split(' ').next().unwrap_or("")).collect();
    ensure(got == wanted, || format!("answers {detail}"))?;
    ensure(!run.counters.contains_key("lost_duplicate") || run.counters["lost_duplicate"] == 0, || {
        format!("two frames had one trigger; {detail}")
    })?;
    for seen in &run.cameras {
        let last = seen.headers.last().ok_or_else(|| format!("no frames; {detail}"))?;
        ensure((last.width, last.height) == (160, 96), || {
            format!("size {}×{}; {detail}", last.width, last.height)
        })?;
        ensure(last.exposure_ns == 3_000_000, || format!("exposure {}; {detail}", last.exposure_ns))?;
        ensure((last.gain_db - 6.0).abs() < 0.01, || format!("gain {}; {detail}", last.gain_db))?;
        let tail: Vec<u64> = seen.headers.iter().rev().take(3).map(|h| h.stamps.mid_exposure_ns).collect();
        let step = tail.windows(2).map(|w| (w[0] - w[1]) as f64 / 1e6).fold(0.0, f64::max);
        ensure((150.0..260.0).contains(&step), || format!("step {step:.1} ms at 5 Hz; {detail}"))?;
    }
    Ok(detail)
}

/// Commands whose acknowledges are lost, late, stale or pending.
pub(crate) fn acks(rig: &Rig, _: &Options) -> Outcome {
    let context = rusb::Context::new()?;
    let mut rows = Vec::new();
    for plan in ["lose-ack@3", "late-ack@3", "stale-ack@3", "pending-ack@3", "stall-control@3"] {
        let mut camera = Camera::open(&context, &rig.cameras[0].serial)?;
        camera.set("FaultPlan", plan)?;
        let begin = MonotonicClock.now().as_ns();
        for gain in ["1.0", "2.0", "3.0", "4.0"] {
            camera.set("Gain", gain)?;
            let got = camera.get_float("Gain")?;
            ensure((got - gain.parse::<f64>()?).abs() < 1e-9, || {
                format!("{plan}: gain {got} instead of {gain}")
            })?;
        }
        camera.set("FaultPlan", "")?;
        rows.push(format!("{plan} {:.0} ms", (MonotonicClock.now().as_ns() - begin) as f64 / 1e6));
    }
    Ok(rows.join(", "))
}

/// A camera that a dead process left streaming, on a slow link: named, and taken all the same.
pub(crate) fn slow(rig: &Rig, _: &Options) -> Outcome {
    let context = rusb::Context::new()?;
    let found = discover(&context)?;
    let camera =
        found.cameras.iter().find(|c| c.serial == rig.cameras[0].serial).ok_or("it is not listed")?;
    ensure(camera.speed_mbps == 480, || format!("{} Mb/s", camera.speed_mbps))?;
    let run = capture(rig, 3, 2500, |_, _| {})?;
    contents_right(&run)?;
    let detail = counts(&run);
    ensure(run.cameras[0].headers.len() > 8, || format!("too few frames; {detail}"))?;
    Ok(detail)
}

/// More frames in flight than the kernel allows memory for: said clearly, and the process does not end.
pub(crate) fn limit(rig: &Rig, _: &Options) -> Outcome {
    let checks = netcord_capture::usb::check_all(Path::new("/sys"), &[2_304_000; 2], 4);
    let memory = checks.iter().find(|c| c.what == "usbfs memory").ok_or("no such check")?;
    ensure(memory.cure.is_some(), || format!("the check found nothing: {memory:?}"))?;
    let run = capture(rig, 7, 1500, |_, _| {})?;
    ensure(run.cameras.iter().all(|c| c.headers.is_empty()), || counts(&run))?;
    Ok(memory.found.clone())
}

/// A camera of 12-bit formats only: refused by the format's name, again and again, without an end of the
/// process.
pub(crate) fn deep(rig: &Rig, _: &Options) -> Outcome {
    let context = rusb::Context::new()?;
    let mut camera = Camera::open(&context, &rig.cameras[0].serial)?;
    let error =
        netcord_capture::usb::apply(&mut camera, &rig.cameras[0]).err().ok_or("it was taken")?.to_string();
    drop(camera);
    ensure(error.contains("BayerRG12p"), || error.clone())?;
    let run = capture(rig, 2, 700, |_, _| {})?;
    ensure(run.cameras[0].headers.is_empty(), || counts(&run))?;
    Ok(error)
}
