//! What of this machine would break streaming, and the cure for each: for `netcord doctor`.

use std::{collections::BTreeMap, fs, path::Path};

use super::discovery::{FoundCamera, discover, usb_context};

/// Where the rule belongs.
pub const UDEV_RULE_PATH: &str = "/etc/udev/rules.d/70-netcord-usb3vision.rules";

/// The udev rule: the class of the interfaces tells USB3 Vision cameras of all makers.
pub const UDEV_RULE: &str = include_str!("70-netcord-usb3vision.rules");

/// How a check ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CheckResult {
    /// Nothing to do.
    Good,
    /// It will work, but not as well as it could.
    Warning,
    /// It will not work.
    Bad,
}

/// One check of the machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Check {
    /// What was looked at.
    pub what: &'static str,
    /// How it ended.
    pub result: CheckResult,
    /// What was found.
    pub found: String,
    /// The command or step that cures it.
    pub cure: Option<String>,
}

impl Check {
    fn good(what: &'static str, found: String) -> Self {
        Self { what, result: CheckResult::Good, found, cure: None }
    }
}

/// All checks of USB: `frame_bytes` of each camera of the rig, `depth` frames in flight each. `sys` is
/// `/sys` (tests give a folder of their own).
pub fn check_all(sys: &Path, frame_bytes: &[usize], depth: usize) -> Vec<Check> {
    if !sys.join("bus/usb").exists() {
        return vec![Check::good("USB", "none on this machine".to_owned())];
    }
    let mut checks = vec![usbfs_memory(frame_bytes, depth, sys)];
    match usb_context().and_then(|context| discover(&context)) {
        Ok(found) => {
            checks.push(permissions(&found.cameras));
            checks.push(speeds(&found.cameras));
            checks.push(sharing(&found.cameras, sys));
            checks.extend(found.others.iter().map(|other| Check {
                what: "USB camera",
                result: CheckResult::Warning,
                found: format!(
                    "{} ({:04x}:{:04x}): {}",
                    other.vendor, other.usb_id.0, other.usb_id.1, other.reason
                ),
                cure: Some("give it firmware that speaks USB3 Vision, or use a camera that does".to_owned()),
            }));
        }
        Err(e) => checks.push(Check {
            what: "USB",
            result: CheckResult::Bad,
            found: e.to_string(),
            cure: Some("let this process see /dev/bus/usb".to_owned()),
        }),
    }
    checks
}

fn usbfs_memory(frame_bytes: &[usize], depth: usize, sys: &Path) -> Check {
    let what = "usbfs memory";
    let path = sys.join("module/usbcore/parameters/usbfs_memory_mb");
    let needed: usize = frame_bytes.iter().map(|bytes| (bytes + (64 << 10)) * depth).sum();
    let needed_mb = needed.div_ceil(1 << 20) + 4;
    let limit = fs::read_to_string(&path).ok().and_then(|text| text.trim().parse::<usize>().ok());
    match limit {
        None => Check {
            what,
            result: CheckResult::Warning,
            found: format!("{} cannot be read", path.display()),
            cure: None,
        },
        // 0 means without limit.
        Some(limit) if limit == 0 || limit >= needed_mb => {
            Check::good(what, format!("{limit} MB allowed, {needed_mb} MB needed"))
        }
        Some(limit) => Check {
            what,
            result: CheckResult::Bad,
            found: format!(
                "{limit} MB allowed, {needed_mb} MB needed for {depth} frames in flight of each camera"
            ),
            cure: Some(format!(
                "echo {} | sudo tee {} (for good: usbcore.usbfs_memory_mb={0} on the kernel's command line)",
                needed_mb.next_power_of_two().max(256),
                path.display()
            )),
        },
    }
}

fn permissions(cameras: &[FoundCamera]) -> Check {
    let what = "camera permissions";
    match cameras.iter().find_map(|c| c.access.as_ref().err().map(|e| (c, e))) {
        None => Check::good(what, format!("{} USB3 Vision cameras can be opened", cameras.len())),
        Some((camera, why)) => Check {
            what,
            result: CheckResult::Bad,
            found: format!("{camera}: {why}"),
            cure: Some("netcord cameras udev | sudo sh".to_owned()),
        },
    }
}

fn speeds(cameras: &[FoundCamera]) -> Check {
    let what = "link speed";
    match cameras.iter().find(|c| c.speed_mbps < 5000) {
        None => Check::good(what, "all cameras at 5 Gb/s or more".to_owned()),
        Some(camera) => Check {
            what,
            result: CheckResult::Bad,
            found: format!("{camera} is linked with {} Mb/s", camera.speed_mbps),
            cure: Some("use a blue USB 3 port and a shorter or better cable; plug it in again".to_owned()),
        },
    }
}

/// Cameras behind one root hub share its bandwidth.
fn sharing(cameras: &[FoundCamera], sys: &Path) -> Check {
    let what = "USB buses";
    let mut buses: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for camera in cameras {
        let link = sys.join(format!("bus/usb/devices/usb{}", camera.place.0));
        // The controller, which both root hubs of a USB 3 port belong to.
        let controller = fs::canonicalize(&link)
            .ok()
            .and_then(|p| p.parent().map(|p| p.display().to_string()))
            .unwrap_or_else(|| format!("bus {}", camera.place.0));
        buses.entry(controller).or_default().push(camera.serial.clone());
    }
    match buses.iter().find(|(_, serials)| serials.len() > 1) {
        None => Check::good(what, "no two cameras share a controller".to_owned()),
        Some((controller, serials)) => Check {
            what,
            result: CheckResult::Warning,
            found: format!("cameras {} share {controller}: 350–400 MB/s for all of them", serials.join(", ")),
            cure: Some("move one to a port of another controller, or add a card".to_owned()),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_on_usb_memory_is_compared_with_what_the_rig_needs() {
        let sys = tempfile::tempdir().expect("a folder");
        let folder = sys.path().join("module/usbcore/parameters");
        fs::create_dir_all(&folder).expect("made");
        let check = |limit: &str| {
            fs::write(folder.join("usbfs_memory_mb"), limit).expect("written");
            usbfs_memory(&[2_304_000; 3], 4, sys.path())
        };
        assert_eq!(check("16\n").result, CheckResult::Bad);
        assert!(check("16\n").cure.expect("a cure").starts_with("echo 256"));
        assert_eq!(check("256\n").result, CheckResult::Good);
        assert_eq!(check("0\n").result, CheckResult::Good);
        assert_eq!(usbfs_memory(&[1], 1, Path::new("/nonexistent")).result, CheckResult::Warning);
    }
}
