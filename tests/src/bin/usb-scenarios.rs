//! Runs the driver against emulated cameras on a real USB stack, one scenario a call, and judges what a
//! reader of the bus sees: `usb-scenarios SCENARIO RIG.toml [--name value …]`. Each row of the output
//! begins with `ok` or `FAILED`.

use std::{collections::BTreeMap, env, error::Error, path::Path, process::ExitCode, thread, time::Duration};

use netcord_capture::{
    FrameSource,
    usb::{Camera, FeatureAccess, UsbOptions, UsbSource, discover},
};
use netcord_common::{
    Clock, Counters, DomainName, MonotonicClock, Shutdown,
    bus::{Bus, FrameSubscriber, Topic},
    rig::Rig,
    wire::{ControlCommand, ControlRequest, ControlStatus, FrameHeader, Verdict},
};
use netcord_emulator::pattern;

type Outcome = Result<String, Box<dyn Error>>;

/// What one camera delivered.
#[derive(Debug, Default, Clone)]
struct Seen {
    headers: Vec<FrameHeader>,
    wrong: Vec<String>,
    arrivals: Vec<u64>,
}

#[derive(Debug, Default)]
struct Run {
    cameras: Vec<Seen>,
    verdicts: BTreeMap<&'static str, u64>,
    counters: BTreeMap<String, u64>,
    answers: Vec<String>,
}

/// Runs capture on `rig` for `ms`; `during` is called every few milliseconds with the time so far.
fn capture(
    rig: &Rig,
    depth: usize,
    ms: u64,
    mut during: impl FnMut(u64, &dyn Fn(&ControlRequest) -> String),
) -> Result<Run, Box<dyn Error>> {
    let domain = DomainName::new(format!("usb-{}", std::process::id()))?;
    let bus = Bus::join(&domain, "usb-scenarios")?;
    let counters = Counters::new();
    let mut source = UsbSource::new(rig, UsbOptions { depth, ..UsbOptions::default() }, &counters)?;
    let control = source.control();
    let stop = Shutdown::new();
    let mut run = Run { cameras: vec![Seen::default(); rig.cameras.len()], ..Run::default() };
    let result = thread::scope(|scope| -> Result<(), Box<dyn Error>> {
        let capture = scope.spawn(|| {
            netcord_capture::run(&bus, rig, &mut source, &stop, &counters).map_err(|e| e.to_string())
        });
        let readers = rig
            .cameras
            .iter()
            .map(|c| FrameSubscriber::open(&bus, &Topic::frames(&c.name), 8))
            .collect::<Result<Vec<_>, _>>()?;
        let framesets = bus.subscriber(&Topic::frameset())?;
        let begin = MonotonicClock.now().as_ns();
        let ask = |request: &ControlRequest| {
            let answer = control.control(request);
            let status = ControlStatus::from_code(answer.status).map_or("?", ControlStatus::name);
            format!("{status} {:?} {}", answer.values, answer.text)
        };
        loop {
            let past = (MonotonicClock.now().as_ns() - begin) / 1_000_000;
            if past >= ms || capture.is_finished() {
                break;
            }
            during(past, &ask);
            for (reader, seen) in readers.iter().zip(&mut run.cameras) {
                while let Some(frame) = reader.receive()? {
                    let h = *frame.header();
                    let picture = &frame.bytes()[..h.stride as usize * h.height as usize];
                    if let Some(place) = pattern::first_wrong(h.block_id, h.stride as usize, picture) {
                        seen.wrong.push(format!("block {} at {place:?}", h.block_id));
                    }
                    seen.arrivals.push(h.stamps.frame_complete_ns);
                    seen.headers.push(h);
                }
            }
            while let Some(frameset) = framesets.receive()? {
                let verdict = Verdict::from_code(frameset.verdict).map_or("?", Verdict::name);
                *run.verdicts.entry(verdict).or_default() += 1;
            }
            thread::sleep(Duration::from_millis(1));
        }
        stop.request();
        Ok(capture.join().map_err(|_| "capture panicked")??)
    });
    result?;
    run.counters = counters.snapshot().into_iter().collect();
    Ok(run)
}

/// The options behind the rig.
struct Options(BTreeMap<String, String>);

impl Options {
    fn read(words: &[String]) -> Self {
        Self(
            words
                .chunks(2)
                .filter_map(|w| Some((w[0].strip_prefix("--")?.to_owned(), w.get(1)?.clone())))
                .collect(),
        )
    }

    fn number(&self, name: &str, default: u64) -> u64 {
        self.0.get(name).and_then(|v| v.parse().ok()).unwrap_or(default)
    }

    fn text(&self, name: &str) -> &str {
        self.0.get(name).map_or("", String::as_str)
    }
}

fn set_faults(rig: &Rig, camera: usize, plan: &str) -> Result<(), Box<dyn Error>> {
    let context = rusb::Context::new()?;
    let mut device = Camera::open(&context, &rig.cameras[camera].serial)?;
    Ok(device.set("FaultPlan", plan)?)
}

fn ensure(holds: bool, what: impl FnOnce() -> String) -> Result<(), Box<dyn Error>> {
    if holds { Ok(()) } else { Err(what().into()) }
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
fn clean(rig: &Rig, o: &Options) -> Outcome {
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
    ensure(skew / 1000 <= limit, || format!("skew {} µs; {detail}", skew / 1000))?;
    Ok(format!("{detail}, largest skew {} µs", skew / 1000))
}

/// A fault loses its frame, or what one restart loses; the other camera does not notice.
fn fault(rig: &Rig, o: &Options) -> Outcome {
    let plan = o.text("plan");
    set_faults(rig, 0, plan)?;
    let ms = o.number("ms", 2600);
    let run = capture(rig, o.number("depth", 4) as usize, ms, |_, _| {})?;
    let detail = counts(&run);
    contents_right(&run).map_err(|e| format!("{e}; {detail}"))?;
    let interval = 1e3 / rig.rate_hz;
    let gap = largest_gap_ms(&run.cameras[0]);
    let limit = interval * 2.0 + o.number("within-ms", 50) as f64;
    ensure(gap <= limit, || {
        format!("{gap:.1} ms without a frame, at most {limit:.1} are allowed; {detail}")
    })?;
    ensure(gap > interval * 1.5, || format!("the fault did not strike: largest gap {gap:.1} ms; {detail}"))?;
    let blocks: Vec<u64> = run.cameras[0].headers.iter().map(|h| h.block_id).collect();
    let lost: u64 = blocks.windows(2).map(|w| w[1].saturating_sub(w[0] + 1)).sum();
    let most = o.number("lost", 2);
    ensure(lost <= most, || format!("{lost} frames lost, at most {most} are allowed; {detail}"))?;
    if let Some(other) = run.cameras.get(1) {
        let gap = largest_gap_ms(other);
        ensure(gap <= interval * 2.2, || format!("the other camera paused {gap:.1} ms; {detail}"))?;
    }
    Ok(format!("{lost} lost, largest gap {gap:.1} ms; {detail}"))
}

/// Unplugged and plugged in again by somebody else: frames again, the other camera undisturbed.
fn replug(rig: &Rig, o: &Options) -> Outcome {
    set_faults(rig, 0, "unplug@12")?;
    let run = capture(rig, 4, o.number("ms", 7000), |_, _| {})?;
    let detail = counts(&run);
    contents_right(&run).map_err(|e| format!("{e}; {detail}"))?;
    let gap = largest_gap_ms(&run.cameras[0]);
    ensure(gap > 200.0, || format!("it was not unplugged; {detail}"))?;
    // Attaching and enumerating are the guest's; its loop looks every 0.2 s and Linux takes 0.5 s.
    ensure(gap < 3500.0, || format!("{gap:.0} ms without frames; {detail}"))?;
    ensure(run.cameras[0].headers.len() > 40, || format!("too few frames; {detail}"))?;
    if let Some(other) = run.cameras.get(1) {
        let pause = largest_gap_ms(other);
        ensure(pause <= 2.5e3 / rig.rate_hz, || format!("the other camera paused {pause:.1} ms; {detail}"))?;
    }
    Ok(format!("frames again after {gap:.0} ms; {detail}"))
}

/// Exposure, gain, rate, white balance and region change while frames flow.
fn control(rig: &Rig, _: &Options) -> Outcome {
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
        (2200, request(ControlCommand::SetRegion, [64.0, 32.0, 640.0, 480.0])),
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
    for seen in &run.cameras {
        let last = seen.headers.last().ok_or_else(|| format!("no frames; {detail}"))?;
        ensure((last.width, last.height) == (640, 480), || {
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
fn acks(rig: &Rig, _: &Options) -> Outcome {
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
fn slow(rig: &Rig, _: &Options) -> Outcome {
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
fn limit(rig: &Rig, _: &Options) -> Outcome {
    let checks = netcord_capture::usb::check_all(Path::new("/sys"), &[2_304_000; 2], 4);
    let memory = checks.iter().find(|c| c.what == "usbfs memory").ok_or("no such check")?;
    ensure(memory.cure.is_some(), || format!("the check found nothing: {memory:?}"))?;
    let run = capture(rig, 7, 1500, |_, _| {})?;
    ensure(run.cameras.iter().all(|c| c.headers.is_empty()), || counts(&run))?;
    Ok(memory.found.clone())
}

fn main() -> ExitCode {
    let words: Vec<String> = env::args().skip(1).collect();
    let [name, path, rest @ ..] = words.as_slice() else {
        println!("FAILED usb-scenarios SCENARIO RIG.toml [--name value …]");
        return ExitCode::from(2);
    };
    let options = Options::read(rest);
    let scenario = match name.as_str() {
        "clean" => clean,
        "fault" => fault,
        "replug" => replug,
        "control" => control,
        "acks" => acks,
        "slow" => slow,
        "limit" => limit,
        _ => {
            println!("FAILED {name}: no such scenario");
            return ExitCode::from(2);
        }
    };
    let outcome = Rig::load(Path::new(path)).map_err(Into::into).and_then(|rig| scenario(&rig, &options));
    let title = format!("{name} {}", rest.join(" "));
    match outcome {
        Ok(detail) => {
            println!("ok {title}: {detail}");
            ExitCode::SUCCESS
        }
        Err(e) => {
            println!("FAILED {title}: {e}");
            ExitCode::from(1)
        }
    }
}
