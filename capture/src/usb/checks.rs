//! What of this machine would break streaming, and the cure for each: for `netcord doctor`.

use std::{collections::BTreeMap, fs, path::Path};

use super::discovery::{FoundCamera, NotVision, discover, usb_context};

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
            checks.extend(found.others.iter().map(other_protocol));
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

fn other_protocol(device: &NotVision) -> Check {
    Check {
        what: "USB camera",
        result: CheckResult::Warning,
        found: format!(
            "{} ({:04x}:{:04x}): {}",
            device.vendor, device.usb_id.0, device.usb_id.1, device.reason
        ),
        cure: Some("give it firmware that speaks USB3 Vision, or use a camera that does".to_owned()),
    }
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
    use crate::usb::discovery::Endpoints;

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

    fn camera(serial: &str, bus: u8) -> FoundCamera {
        FoundCamera {
            vendor: "netcord".into(),
            model: "EmulatedU3V".into(),
            serial: serial.into(),
            version: "1.0".into(),
            guid: format!("1209{serial}"),
            usb_id: (0x1209, 0xE301),
            place: (bus, 2),
            speed_mbps: 5000,
            access: Ok(()),
            endpoints: Endpoints {
                control_interface: 0,
                stream_interface: 1,
                control_out: 0x01,
                control_in: 0x81,
                stream: 0x82,
                stream_packet: 1024,
            },
        }
    }

    #[test]
    fn cameras_that_cannot_be_opened_are_named_with_the_command_that_opens_them() {
        let shut =
            FoundCamera { access: Err("no permission on /dev/bus/usb/002/002".into()), ..camera("7", 2) };
        let check = permissions(&[camera("6", 2), shut]);
        assert_eq!(check.result, CheckResult::Bad);
        assert!(check.found.contains("serial 7") && check.found.contains("no permission"), "{}", check.found);
        assert_eq!(check.cure.as_deref(), Some("netcord cameras udev | sudo sh"));
        assert_eq!(permissions(&[camera("6", 2)]).result, CheckResult::Good);
    }

    #[test]
    fn a_slow_link_is_named_with_its_speed() {
        let check = speeds(&[camera("6", 2), FoundCamera { speed_mbps: 480, ..camera("7", 1) }]);
        assert_eq!(check.result, CheckResult::Bad);
        assert!(check.found.contains("serial 7") && check.found.contains("480 Mb/s"), "{}", check.found);
        assert!(check.cure.is_some());
        let fast = FoundCamera { speed_mbps: 10_000, ..camera("7", 1) };
        assert_eq!(speeds(&[camera("6", 2), fast]).result, CheckResult::Good);
    }

    #[test]
    fn cameras_of_one_controller_are_named_also_on_its_two_root_hubs() {
        let sys = tempfile::tempdir().expect("a folder");
        let devices = sys.path().join("bus/usb/devices");
        fs::create_dir_all(&devices).expect("made");
        // Buses 1 and 2 are the root hubs of one controller, bus 3 is another's.
        for (bus, controller) in [(1, "0000:00:14.0"), (2, "0000:00:14.0"), (3, "0000:03:00.0")] {
            let hub = sys.path().join(format!("devices/pci0000:00/{controller}/usb{bus}"));
            fs::create_dir_all(&hub).expect("made");
            std::os::unix::fs::symlink(&hub, devices.join(format!("usb{bus}"))).expect("linked");
        }
        let check = sharing(&[camera("6", 1), camera("7", 2), camera("8", 3)], sys.path());
        assert_eq!(check.result, CheckResult::Warning);
        assert!(
            check.found.contains("6, 7 share") && check.found.contains("0000:00:14.0"),
            "{}",
            check.found
        );
        assert!(check.cure.is_some());
        assert_eq!(sharing(&[camera("6", 1), camera("8", 3)], sys.path()).result, CheckResult::Good);
    }

    #[test]
    fn a_device_of_its_makers_own_protocol_is_a_warning_with_a_cure() {
        let device = NotVision {
            vendor: "MindVision / Huateng",
            usb_id: (0xF622, 1),
            place: (1, 3),
            reason: "it has no USB3 Vision interfaces".into(),
        };
        let check = other_protocol(&device);
        assert_eq!(check.result, CheckResult::Warning);
        assert!(check.found.contains("MindVision") && check.found.contains("f622:0001"), "{}", check.found);
        assert!(check.cure.is_some());
    }
}
