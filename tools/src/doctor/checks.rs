use std::{
    fs,
    path::Path,
    thread,
    time::{Duration, Instant},
};

use netcord_capture::usb::{CheckResult, check_all};
use netcord_common::{bus::Topic, rig::Rig};
use nix::sys::{
    resource::{Resource, getrlimit},
    statvfs::statvfs,
};

use super::{Finding, Grade};

/// Looks at everything. `root` is `/` (tests give a folder of their own); `rig` tells how much memory frames need.
pub fn examine(root: &Path, rig: Option<&Rig>) -> Vec<Finding> {
    let read = |path: &str| fs::read_to_string(root.join(path)).ok().map(|text| text.trim().to_owned());
    let mut findings = vec![
        processors(),
        shared_memory(rig),
        priority(read("proc/sys/kernel/sched_rt_runtime_us")),
        governor(root),
        transparent_huge_pages(read("sys/kernel/mm/transparent_hugepage/enabled")),
        load(read("proc/loadavg")),
        wake_up(),
    ];
    findings.extend(usb(root, rig));
    findings.sort_by_key(|f| std::cmp::Reverse(f.grade));
    findings
}

/// Bytes of shared memory that the frames of `rig` may take at most: every slot of every camera in use at once.
pub fn memory_needed(rig: &Rig) -> u64 {
    rig.cameras
        .iter()
        .map(|camera| {
            let slots = Topic::frames(&camera.name).limits().slots() as u64;
            slots * u64::from(camera.model.width) * u64::from(camera.model.height)
        })
        .sum()
}

fn processors() -> Finding {
    let what = "processors";
    match thread::available_parallelism().map(std::num::NonZero::get) {
        Ok(1) => Finding::bad(
            Grade::Risk,
            what,
            "one",
            "stages wait for each other: use a machine with two or more",
        ),
        Ok(n) => Finding::good(what, n.to_string()),
        Err(e) => Finding::bad(Grade::Risk, what, e.to_string(), "let this process see its processors"),
    }
}

fn shared_memory(rig: Option<&Rig>) -> Finding {
    let what = "shared memory";
    let Ok(stat) = statvfs("/dev/shm") else {
        return Finding::bad(Grade::Broken, what, "/dev/shm is missing", "mount -t tmpfs tmpfs /dev/shm");
    };
    let free = stat.blocks_available() * stat.fragment_size();
    let needed = rig.map_or(0, memory_needed);
    let found = format!("{} MB free in /dev/shm", free >> 20);
    if free < needed {
        let size = (needed + (64 << 20)) >> 20;
        let found = format!("{found}, {} MB may be needed when every reader holds its fill", needed >> 20);
        return Finding::bad(Grade::Risk, what, found, format!("mount -o remount,size={size}m /dev/shm"));
    }
    Finding::good(what, found)
}

fn priority(runtime_us: Option<String>) -> Finding {
    let what = "real-time priority";
    let allowed = getrlimit(Resource::RLIMIT_RTPRIO).map_or(0, |(soft, _)| soft);
    let root = nix::unistd::geteuid().is_root();
    if allowed == 0 && !root {
        let cure =
            "LimitRTPRIO=99 in the systemd unit, `ulimit -r 99`, or rtprio in /etc/security/limits.conf";
        return Finding::bad(Grade::Risk, what, "not allowed", cure);
    }
    match runtime_us.as_deref() {
        Some("-1") | None => Finding::good(what, "allowed"),
        Some(us) => Finding::good(what, format!("allowed, for {us} µs of every second")),
    }
}

fn governor(root: &Path) -> Finding {
    let what = "processor frequency";
    let cpus = fs::read_dir(root.join("sys/devices/system/cpu")).into_iter().flatten().flatten();
    let mut governors: Vec<String> = cpus
        .filter_map(|cpu| fs::read_to_string(cpu.path().join("cpufreq/scaling_governor")).ok())
        .map(|text| text.trim().to_owned())
        .collect();
    governors.sort();
    governors.dedup();
    match governors.as_slice() {
        [] => Finding::good(what, "not governed by this system"),
        [only] if only == "performance" => Finding::good(what, "performance"),
        some => Finding::bad(Grade::Risk, what, some.join(", "), "cpupower frequency-set -g performance"),
    }
}

/// Frames in flight of each camera, as `netcord capture` has them.
const DEPTH: usize = 4;
/// Where no rig is given: two cameras of 1920 × 1200 px.
const USUAL_FRAMES: [usize; 2] = [1920 * 1200; 2];

/// What the driver finds of USB, permissions and cameras.
fn usb(root: &Path, rig: Option<&Rig>) -> impl Iterator<Item = Finding> {
    let frames = rig.map_or_else(
        || USUAL_FRAMES.to_vec(),
        |rig| rig.cameras.iter().map(|c| c.model.width as usize * c.model.height as usize).collect(),
    );
    check_all(&root.join("sys"), &frames, DEPTH).into_iter().map(|check| Finding {
        grade: match check.result {
            CheckResult::Good => Grade::Good,
            CheckResult::Warning => Grade::Risk,
            CheckResult::Bad => Grade::Broken,
        },
        what: check.what,
        found: check.found,
        cure: check.cure.unwrap_or_default(),
    })
}

fn transparent_huge_pages(enabled: Option<String>) -> Finding {
    let what = "transparent huge pages";
    match enabled {
        Some(text) if text.contains("[always]") => Finding::bad(
            Grade::Risk,
            what,
            "always: the kernel may stop a process to compact memory",
            "echo madvise > /sys/kernel/mm/transparent_hugepage/enabled",
        ),
        Some(text) => Finding::good(what, text),
        None => Finding::good(what, "none"),
    }
}

fn load(loadavg: Option<String>) -> Finding {
    let what = "other work";
    let load = loadavg.as_deref().and_then(|t| t.split_whitespace().next()?.parse::<f64>().ok());
    let processors = thread::available_parallelism().map_or(1.0, |n| n.get() as f64);
    match load {
        Some(load) if load > 0.5 * processors => Finding::bad(
            Grade::Risk,
            what,
            format!("a load of {load} on {processors} processors"),
            "stop what else runs, or keep processors free for the rig (affinity in the rig file, isolcpus)",
        ),
        Some(load) => Finding::good(what, format!("a load of {load}")),
        None => Finding::good(what, "not told"),
    }
}

/// Sleeps that are measured, and how long they are.
const SLEEPS: usize = 200;
const SLEEP: Duration = Duration::from_millis(1);
/// A wake-up later than this eats a tenth of the p99 of frame → position.
const LATE: Duration = Duration::from_micros(300);

fn wake_up() -> Finding {
    let what = "wake-up";
    let mut late: Vec<Duration> = (0..SLEEPS)
        .map(|_| {
            let start = Instant::now();
            thread::sleep(SLEEP);
            start.elapsed().saturating_sub(SLEEP)
        })
        .collect();
    late.sort();
    let (median, worst) = (late[SLEEPS / 2], late[SLEEPS * 99 / 100]);
    let found = format!("{} µs late in the median, {} µs in 99 %", median.as_micros(), worst.as_micros());
    if worst > LATE {
        let cure = "a real-time priority for the stages (priority in the rig file), and no deep sleep: idle=halt, or \
                    cpupower idle-set -D 20";
        return Finding::bad(Grade::Risk, what, found, cure);
    }
    Finding::good(what, found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grade_of(root: &Path, what: &str) -> Grade {
        examine(root, None).into_iter().find(|f| f.what == what).expect("it is looked at").grade
    }

    #[test]
    fn settings_that_cost_latency_are_found_with_their_cure() {
        let root = tempfile::tempdir().expect("a folder");
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("a parent")).expect("made");
            fs::write(path, text).expect("written");
        };
        let governor = "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor";
        let usbfs = "sys/module/usbcore/parameters/usbfs_memory_mb";
        write(governor, "powersave\n");
        write(usbfs, "16\n");
        write("sys/bus/usb/drivers_autoprobe", "1\n");
        write("sys/kernel/mm/transparent_hugepage/enabled", "[always] madvise never\n");
        let findings = examine(root.path(), None);
        for (what, grade) in [
            ("processor frequency", Grade::Risk),
            ("usbfs memory", Grade::Broken),
            ("transparent huge pages", Grade::Risk),
        ] {
            let finding = findings.iter().find(|f| f.what == what).expect("it is looked at");
            assert_eq!(finding.grade, grade, "{finding:?}");
            assert!(!finding.cure.is_empty());
        }
        write(governor, "performance\n");
        write(usbfs, "1000\n");
        assert_eq!(grade_of(root.path(), "processor frequency"), Grade::Good);
        assert_eq!(grade_of(root.path(), "usbfs memory"), Grade::Good);
    }

    #[test]
    fn the_frames_of_two_cameras_fit_half_a_gigabyte_and_a_bit() {
        let rig = crate::trial::example_rig(2).expect("an example");
        // 2 cameras × 137 slots × 2.3 MB.
        assert_eq!(memory_needed(&rig), 2 * 137 * 1920 * 1200);
    }
}
