//! Capture in this process, and a reader beside it.

use std::{collections::BTreeMap, error::Error, thread, time::Duration};

use netcord_capture::{
    FrameSource,
    usb::{UsbOptions, UsbSource},
};
use netcord_common::{
    Clock, Counters, DomainName, MonotonicClock, Shutdown,
    bus::{Bus, FrameSubscriber, Topic},
    rig::Rig,
    wire::{ControlRequest, ControlStatus, FrameHeader, Verdict},
};
use netcord_emulator::pattern;

/// What one camera delivered.
#[derive(Debug, Default, Clone)]
pub(crate) struct Seen {
    pub(crate) headers: Vec<FrameHeader>,
    pub(crate) wrong: Vec<String>,
    pub(crate) arrivals: Vec<u64>,
}

#[derive(Debug, Default)]
pub(crate) struct Run {
    pub(crate) cameras: Vec<Seen>,
    pub(crate) verdicts: BTreeMap<&'static str, u64>,
    pub(crate) counters: BTreeMap<String, u64>,
    pub(crate) answers: Vec<String>,
}

/// Runs capture on `rig` for `ms`; `during` is called every few milliseconds with the time so far.
pub(crate) fn capture(
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
