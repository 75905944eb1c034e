//! What the driver costs beside the kernel's copy.

use std::{error::Error, fs, process::Command, thread, time::Duration};

use netcord_common::{
    Clock, DomainName, MonotonicClock,
    bus::{Bus, FrameSubscriber, Topic},
    rig::Rig,
};
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use crate::{Options, Outcome, ensure};

/// CPU time of all threads of a process so far, ns (`Documentation/scheduler/sched-stats`).
fn cpu_ns(pid: u32) -> Result<u64, Box<dyn Error>> {
    let mut sum = 0;
    for task in fs::read_dir(format!("/proc/{pid}/task"))? {
        let text = fs::read_to_string(task?.path().join("schedstat"))?;
        sum += text.split_whitespace().next().ok_or("an empty schedstat")?.parse::<u64>()?;
    }
    Ok(sum)
}

/// CPU time of `netcord capture` for one frame of the first camera, ns.
fn per_frame(rig: &Rig, path: &str) -> Result<(f64, u64), Box<dyn Error>> {
    let domain = format!("cost-{}-{}", std::process::id(), rig.cameras[0].model.height);
    let bus = Bus::join(&DomainName::new(domain.clone())?, "usb-scenarios")?;
    let reader = FrameSubscriber::open(&bus, &Topic::frames(&rig.cameras[0].name), 8)?;
    let mut child = Command::new("netcord")
        .args(["capture", "--source", "usb", "--rig", path, "--domain", &domain])
        .spawn()?;
    let limit = MonotonicClock.now().as_ns() + 15_000_000_000;
    let (mut frames, mut begin) = (0_u64, None);
    // The first frames are those of a start.
    const SKIPPED: u64 = 10;
    const COUNTED: u64 = 60;
    while frames < SKIPPED + COUNTED && MonotonicClock.now().as_ns() < limit {
        while reader.receive()?.is_some() {
            frames += 1;
            if frames == SKIPPED {
                begin = Some(cpu_ns(child.id())?);
            }
        }
        thread::sleep(Duration::from_millis(1));
    }
    let end = cpu_ns(child.id())?;
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGTERM)?;
    child.wait()?;
    let begin = begin.ok_or("no frames came")?;
    ensure(frames >= SKIPPED + COUNTED, || format!("only {frames} frames came"))?;
    Ok(((end - begin) as f64 / COUNTED as f64, frames))
}

/// Frames of two sizes, cut into as many transfers: what does not grow with the size is the driver's.
pub(crate) fn cost(small: &Rig, o: &Options) -> Outcome {
    let large = Rig::load(std::path::Path::new(o.text("large")))?;
    let bytes = |rig: &Rig| f64::from(rig.cameras[0].model.width) * f64::from(rig.cameras[0].model.height);
    let (a, _) = per_frame(small, o.text("rig"))?;
    let (b, _) = per_frame(&large, o.text("large"))?;
    let slope = (b - a) / (bytes(&large) - bytes(small));
    let fixed = a - slope * bytes(small);
    Ok(format!(
        "{:.0} µs of CPU for a frame of {:.0} kB, {:.0} µs for {:.0} kB: {:.0} µs beside the copy, which takes {:.3} \
         ns a byte ({} instructions are 1 µs)",
        a / 1e3,
        bytes(small) / 1e3,
        b / 1e3,
        bytes(&large) / 1e3,
        fixed / 1e3,
        slope,
        o.number("mips", 500)
    ))
}
