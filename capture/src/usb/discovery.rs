use std::{fmt, path::Path, time::Duration};

use rusb::{Context, Device, Direction, Speed, TransferType, UsbContext};
use serde::Serialize;
use thiserror::Error;

/// Where a camera's interfaces and endpoints are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Endpoints {
    /// Number of the control interface.
    pub control_interface: u8,
    /// Number of the stream interface.
    pub stream_interface: u8,
    /// For commands.
    pub control_out: u8,
    /// For acknowledges.
    pub control_in: u8,
    /// For frames.
    pub stream: u8,
    /// Bytes of a packet on it.
    pub stream_packet: u16,
}

/// A USB3 Vision camera that is plugged in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FoundCamera {
    /// Maker, as the device says.
    pub vendor: String,
    /// Model.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Version of the device.
    pub version: String,
    /// The device's GUID: vendor and serial.
    pub guid: String,
    /// USB vendor and product.
    pub usb_id: (u16, u16),
    /// Bus and address.
    pub place: (u8, u8),
    /// Speed of the link, Mb/s.
    pub speed_mbps: u32,
    /// What hinders opening it, if anything does.
    pub access: Result<(), String>,
    /// Where its endpoints are.
    #[serde(skip)]
    pub endpoints: Endpoints,
}

/// A device of a known camera vendor that is no USB3 Vision camera, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NotVision {
    /// Whose it is.
    pub vendor: &'static str,
    /// USB vendor and product.
    pub usb_id: (u16, u16),
    /// Bus and address.
    pub place: (u8, u8),
    /// Why it cannot be used.
    pub reason: String,
}

/// What is plugged in.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Discovery {
    /// Cameras.
    pub cameras: Vec<FoundCamera>,
    /// Others that are nearly cameras.
    pub others: Vec<NotVision>,
}

/// USB could not be looked at.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("the USB devices of this machine cannot be listed: {0}")]
pub struct DiscoveryError(String);

/// Begins to use USB.
///
/// # Errors
/// [`DiscoveryError`] where the machine has none, or hides it from this process.
pub fn usb_context() -> Result<Context, DiscoveryError> {
    Context::new().map_err(|e| {
        DiscoveryError(if Path::new("/dev/bus/usb").exists() {
            e.to_string()
        } else {
            "this machine has no USB, or hides it from this process: there is no /dev/bus/usb".to_owned()
        })
    })
}

/// Makers of industrial cameras by their USB vendor ids (usb.ids, udev rules of aravis).
pub const VENDORS: [(u16, &str); 14] = [
    (0x1E10, "FLIR / Point Grey"),
    (0x2676, "Basler"),
    (0x2BDF, "Hikrobot"),
    (0x2BA2, "Daheng Imaging"),
    (0x1AB2, "Allied Vision"),
    (0x199E, "The Imaging Source"),
    (0xF622, "MindVision / Huateng"),
    (0x1409, "IDS"),
    (0x2CAD, "Lucid"),
    (0x04B4, "Cypress (several makers)"),
    (0x28B7, "Ximea"),
    (0x2B90, "Matrix Vision / Balluff"),
    (0x0BAF, "Toshiba Teli"),
    (0x1209, "netcord emulator"),
];

/// The reason for every string that a device gives: some hang on the first request.
const PATIENCE: Duration = Duration::from_millis(500);

/// Lists the cameras of this machine.
///
/// # Errors
/// [`DiscoveryError`].
pub fn discover(context: &Context) -> Result<Discovery, DiscoveryError> {
    let devices = context.devices().map_err(|e| DiscoveryError(e.to_string()))?;
    let mut found = Discovery::default();
    for device in devices.iter() {
        let Ok(descriptor) = device.device_descriptor() else { continue };
        let usb_id = (descriptor.vendor_id(), descriptor.product_id());
        let place = (device.bus_number(), device.address());
        match endpoints_of(&device) {
            Ok((endpoints, info)) => found.cameras.push(describe(&device, endpoints, &info, usb_id, place)),
            Err(reason) => {
                if let Some((_, vendor)) = VENDORS.iter().find(|(id, _)| *id == usb_id.0) {
                    found.others.push(NotVision { vendor, usb_id, place, reason });
                }
            }
        }
    }
    found.cameras.sort_by(|a, b| (&a.serial, a.place).cmp(&(&b.serial, b.place)));
    Ok(found)
}

/// A device's interfaces of class EF/05 (USB3 Vision 3.3), or why it has none.
pub fn endpoints_of(device: &Device<Context>) -> Result<(Endpoints, DeviceInfo), String> {
    let config =
        device.active_config_descriptor().map_err(|e| format!("its configuration cannot be read: {e}"))?;
    let (mut control, mut stream, mut info) = (None, None, DeviceInfo::default());
    let mut classes = Vec::new();
    for interface in config.interfaces() {
        for setting in interface.descriptors() {
            let class = (setting.class_code(), setting.sub_class_code(), setting.protocol_code());
            classes.push(format!("{:02x}/{:02x}/{:02x}", class.0, class.1, class.2));
            let bulk = |direction| {
                setting
                    .endpoint_descriptors()
                    .find(|e| e.transfer_type() == TransferType::Bulk && e.direction() == direction)
                    .map(|e| e.address())
            };
            match class {
                (0xEF, 0x05, 0x00) => {
                    if let (Some(input), Some(output)) = (bulk(Direction::In), bulk(Direction::Out)) {
                        control = Some((setting.interface_number(), output, input));
                        info = DeviceInfo::parse(setting.extra());
                    }
                }
                (0xEF, 0x05, 0x02) if stream.is_none() => {
                    let packet = setting
                        .endpoint_descriptors()
                        .find(|e| Some(e.address()) == bulk(Direction::In))
                        .map_or(1024, |e| e.max_packet_size());
                    stream = bulk(Direction::In).map(|e| (setting.interface_number(), e, packet));
                }
                _ => {}
            }
        }
    }
    match (control, stream) {
        (
            Some((control_interface, control_out, control_in)),
            Some((stream_interface, stream, stream_packet)),
        ) => Ok((
            Endpoints { control_interface, stream_interface, control_out, control_in, stream, stream_packet },
            info,
        )),
        _ => Err(format!(
            "it has no USB3 Vision interfaces (class ef/05/00 and ef/05/02), but {}: it speaks its maker's own protocol",
            if classes.is_empty() { "none".to_owned() } else { classes.join(", ") }
        )),
    }
}

/// String indices of the device-info descriptor (USB3 Vision 3.4.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceInfo {
    guid: u8,
    vendor: u8,
    model: u8,
    version: u8,
    serial: u8,
}

impl DeviceInfo {
    fn parse(extra: &[u8]) -> Self {
        let mut rest = extra;
        while let [length, kind, subkind, ..] = *rest {
            let length = usize::from(length);
            if length < 3 || length > rest.len() {
                break;
            }
            if (kind, subkind) == (0x24, 1) && length >= 20 {
                let d = rest;
                return Self { guid: d[11], vendor: d[12], model: d[13], version: d[15], serial: d[17] };
            }
            rest = &rest[length..];
        }
        Self::default()
    }
}

fn describe(
    device: &Device<Context>,
    endpoints: Endpoints,
    info: &DeviceInfo,
    usb_id: (u16, u16),
    place: (u8, u8),
) -> FoundCamera {
    let opened = device.open();
    let text = |index: u8| {
        let handle = opened.as_ref().ok().filter(|_| index != 0)?;
        let language = handle.read_languages(PATIENCE).ok()?.first().copied()?;
        handle.read_string_descriptor(language, index, PATIENCE).ok()
    };
    let known = VENDORS.iter().find(|(id, _)| *id == usb_id.0).map_or("", |(_, name)| name);
    FoundCamera {
        vendor: text(info.vendor).unwrap_or_else(|| known.to_owned()),
        model: text(info.model).unwrap_or_default(),
        serial: text(info.serial).unwrap_or_default(),
        version: text(info.version).unwrap_or_default(),
        guid: text(info.guid).unwrap_or_default(),
        usb_id,
        place,
        speed_mbps: match device.speed() {
            Speed::Low => 2,
            Speed::Full => 12,
            Speed::High => 480,
            Speed::Super => 5_000,
            Speed::SuperPlus => 10_000,
            _ => 0,
        },
        access: match &opened {
            Ok(_) => Ok(()),
            Err(rusb::Error::Access) => Err(format!(
                "no permission on /dev/bus/usb/{:03}/{:03}: install the udev rule with `netcord cameras udev`",
                place.0, place.1
            )),
            Err(e) => Err(e.to_string()),
        },
        endpoints,
    }
}

impl fmt::Display for FoundCamera {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} (serial {})", self.vendor, self.model, self.serial)
    }
}

#[cfg(test)]
mod tests {
    use netcord_emulator::{CameraConfig, Descriptors};

    use super::*;

    #[test]
    fn the_device_info_is_found_among_other_descriptors() {
        let configuration = Descriptors::new(&CameraConfig::default()).configuration;
        let at = configuration.windows(3).position(|w| w == [20, 0x24, 1]).expect("there");
        let info = DeviceInfo::parse(&configuration[at..]);
        assert_eq!(info, DeviceInfo { guid: 4, vendor: 1, model: 2, version: 6, serial: 3 });
        for cut in 0..20 {
            assert_eq!(DeviceInfo::parse(&configuration[at..at + cut]), DeviceInfo::default());
        }
        assert_eq!(DeviceInfo::parse(&[0; 64]), DeviceInfo::default());
    }
}
