//! That no frame is copied between the cable and shared memory.

use std::{env, error::Error, fs, hint::black_box, path::Path, process::Command, thread, time::Duration};

use netcord_common::{
    Clock, DomainName, MonotonicClock,
    bus::{Bus, FrameSubscriber, Topic},
    rig::Rig,
};
use netcord_tests::{Copies, CopyCount};
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use crate::{Options, Outcome, ensure};

/// Frames of the first camera over which copies are counted.
const COUNTED: u64 = 12;

/// Copies of `netcord capture` while frames flow, and how many did.
fn while_streaming(rig: &Rig, path: &str, copies: &Copies) -> Result<(CopyCount, u64), Box<dyn Error>> {
    let domain = format!("copies-{}", std::process::id());
    let bus = Bus::join(&DomainName::new(domain.clone())?, "usb-scenarios")?;
    let reader = FrameSubscriber::open(&bus, &Topic::frames(&rig.cameras[0].name), 8)?;
    let mut command = Command::new("netcord");
    command.args(["capture", "--source", "usb", "--rig", path, "--domain", &domain]);
    let mut child = copies.preload(&mut command).spawn()?;
    let limit = MonotonicClock.now().as_ns() + 30_000_000_000;
    let (mut frames, mut before) = (0_u64, None);
    // What is done once, at the start, is over with the first frames.
    const STARTED: u64 = 5;
    while frames < STARTED + COUNTED && MonotonicClock.now().as_ns() < limit {
        while reader.receive()?.is_some() {
            frames += 1;
            if frames == STARTED {
                before = Some(copies.of(child.id()));
            }
        }
        thread::sleep(Duration::from_millis(1));
    }
    let after = copies.of(child.id());
    kill(Pid::from_raw(child.id().cast_signed()), Signal::SIGTERM)?;
    child.wait()?;
    let before = before.ok_or("no frames came")?;
    Ok((CopyCount { calls: after.calls - before.calls, bytes: after.bytes - before.bytes }, frames - STARTED))
}

/// Counts the copies of at least 64 KiB in `netcord capture`, as the pipeline's own test does.
pub(crate) fn copies(rig: &Rig, o: &Options) -> Outcome {
    let counts = env::temp_dir().join(format!("copies-{}", std::process::id()));
    fs::create_dir(&counts)?;
    let copies = Copies::with(Path::new(o.text("library")), &counts);
    // A process that copies one frame shows that the counter counts.
    let mut command = Command::new(env::current_exe()?);
    let mut known = copies.preload(command.args(["copy-a-frame", o.text("rig")])).spawn()?;
    let pid = known.id();
    known.wait()?;
    let model = &rig.cameras[0].model;
    let frame = u64::from(model.width) * u64::from(model.height);
    let counted = copies.of(pid);
    ensure(counted.bytes >= frame, || format!("the counter does not count: {counted:?}"))?;
    let (during, frames) = while_streaming(rig, o.text("rig"), &copies)?;
    let found =
        format!("{} copies of 64 KiB or more in {frames} frames of {} kB", during.calls, frame / 1000);
    ensure(frames >= COUNTED, || format!("only {frames} frames came; {found}"))?;
    ensure(during == CopyCount::default(), || format!("{found}: {} bytes", during.bytes))?;
    Ok(found)
}

/// Copies one frame of the first camera.
pub(crate) fn copy_a_frame(rig: &Rig, _: &Options) -> Outcome {
    let model = &rig.cameras[0].model;
    let frame = black_box(vec![1_u8; model.width as usize * model.height as usize]);
    let mut copy = vec![0_u8; frame.len()];
    copy.copy_from_slice(&frame);
    Ok(format!("{} bytes", black_box(copy).len()))
}
