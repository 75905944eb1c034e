//! What the rig file says of a camera, set on the device and read back.

use netcord_common::{
    PixelFormat,
    rig::{RigCamera, TriggerEdge, TriggerRole},
};

use super::{CameraError, access::FeatureAccess, genapi::FeatureError};

/// What is in force on the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InForce {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// PFNC code that the device gives its frames.
    pub device_format: u32,
    /// What the mosaic truly is.
    pub true_format: PixelFormat,
    /// Length of the exposure, ns.
    pub exposure_ns: u64,
    /// Gain, dB.
    pub gain_db: f64,
}

/// Whether the host's command makes this camera expose: by role, or as the master of a rig whose other
/// cameras wait for its strobe.
pub const fn is_host_triggered(camera: &RigCamera) -> bool {
    matches!(camera.trigger, TriggerRole::Software)
        || (matches!(camera.trigger, TriggerRole::Hardware) && camera.master)
}

/// Ignores that a camera lacks a feature, or has it locked at the value that it has.
fn optional(result: Result<(), FeatureError>) -> Result<(), FeatureError> {
    match result {
        Err(e) if e.is_absent() || matches!(e, FeatureError::ReadOnly(_)) => Ok(()),
        other => other,
    }
}

/// Sets everything that the rig file says of `wanted`, and reads back what is in force.
///
/// # Errors
/// [`CameraError`]; a camera that cannot do what the rig needs is an error that says what is missing.
pub fn apply(camera: &mut impl FeatureAccess, wanted: &RigCamera) -> Result<InForce, CameraError> {
    let device_format = set_format(camera, wanted)?;
    // Offsets first, so that the full width is allowed.
    optional(camera.set("OffsetX", "0"))?;
    optional(camera.set("OffsetY", "0"))?;
    for (name, value) in [("Width", wanted.model.width), ("Height", wanted.model.height)] {
        camera.set(name, &value.to_string())?;
    }
    optional(camera.set("AcquisitionMode", "Continuous"))?;
    optional(camera.set("ExposureAuto", "Off"))?;
    optional(camera.set("GainAuto", "Off"))?;
    set_gain(camera, wanted.gain_db)?;
    set_trigger(camera, wanted)?;
    let exposure_ns = set_exposure(camera, wanted.exposure_ns)?;
    let width = u32::try_from(camera.get_int("Width")?).unwrap_or(0);
    let height = u32::try_from(camera.get_int("Height")?).unwrap_or(0);
    if (width, height) != (wanted.model.width, wanted.model.height) {
        return Err(CameraError::Setup(format!(
            "the rig says {} × {} px, but the camera stays at {width} × {height} px",
            wanted.model.width, wanted.model.height
        )));
    }
    let gain_db = camera.get_float("Gain").unwrap_or(wanted.gain_db);
    Ok(InForce { width, height, device_format, true_format: wanted.pixel_format, exposure_ns, gain_db })
}

/// Sets the rig's pixel format, or the one that stands for it on this device; gives its PFNC code.
fn set_format(camera: &mut impl FeatureAccess, wanted: &RigCamera) -> Result<u32, CameraError> {
    let format = wanted.device_format.unwrap_or(wanted.pixel_format);
    let cannot = |has: &str| {
        CameraError::Setup(format!(
            "the camera cannot deliver {format}: {has}. Frames are taken with 8 bits a pixel, not with 10 or 12, packed or \
             not; a camera that calls this mosaic otherwise needs device_format in the rig file"
        ))
    };
    match camera.set("PixelFormat", format.name()) {
        Ok(()) => Ok(format.pfnc()),
        Err(FeatureError::NoEntry { valid, .. }) => Err(cannot(&format!("it offers {}", valid.join(", ")))),
        // Fixed, which is well if it is the right one.
        Err(FeatureError::ReadOnly(_)) => match camera.get("PixelFormat")?.to_string() {
            name if name == format.name() => Ok(format.pfnc()),
            other => Err(cannot(&format!("it is fixed at {other}"))),
        },
        Err(e) => Err(e.into()),
    }
}

/// Sets the exposure, ns; gives what is in force.
///
/// # Errors
/// [`FeatureError`].
pub fn set_exposure(camera: &mut impl FeatureAccess, ns: u64) -> Result<u64, FeatureError> {
    let us = ns as f64 / 1000.0;
    // Older cameras call it ExposureTimeAbs.
    let name = if camera.has("ExposureTime") { "ExposureTime" } else { "ExposureTimeAbs" };
    camera.set(name, &format!("{us:?}"))?;
    Ok((camera.get_float(name)? * 1000.0).round() as u64)
}

/// Sets the gain, dB; gives what is in force.
///
/// # Errors
/// [`FeatureError`].
pub fn set_gain(camera: &mut impl FeatureAccess, db: f64) -> Result<f64, FeatureError> {
    optional(camera.set("GainSelector", "All"))
        .or_else(|e| if matches!(e, FeatureError::NoEntry { .. }) { Ok(()) } else { Err(e) })?;
    match camera.set("Gain", &format!("{db:?}")) {
        // A camera whose gain is a whole number.
        Err(FeatureError::Type { .. }) => camera.set("Gain", &format!("{}", db.round() as i64))?,
        other => optional(other)?,
    }
    Ok(camera.get_float("Gain").unwrap_or(db))
}

/// Sets the factors of red and blue against green.
///
/// # Errors
/// [`FeatureError`].
pub fn set_white_balance(camera: &mut impl FeatureAccess, red: f64, blue: f64) -> Result<(), FeatureError> {
    optional(camera.set("BalanceWhiteAuto", "Off"))?;
    for (channel, factor) in [("Red", red), ("Blue", blue)] {
        camera.set("BalanceRatioSelector", channel)?;
        camera.set("BalanceRatio", &format!("{factor:?}"))?;
    }
    Ok(())
}

/// Sets the rate of a camera that exposes by itself, Hz.
///
/// # Errors
/// [`FeatureError`].
pub fn set_rate(camera: &mut impl FeatureAccess, hz: f64) -> Result<(), FeatureError> {
    optional(camera.set("AcquisitionFrameRateEnable", "true"))?;
    camera.set("AcquisitionFrameRate", &format!("{hz:?}"))
}

/// Sets a feature, and wants to read the same.
fn set_and_check(camera: &mut impl FeatureAccess, name: &str, value: &str) -> Result<(), CameraError> {
    camera.set(name, value)?;
    let got = camera.get(name)?.to_string();
    if got == value {
        return Ok(());
    }
    Err(CameraError::Setup(format!("{name} was set to {value}, but reads back as {got}")))
}

/// The same for a feature that may be missing where the rig wants what is usual anyway.
fn set_or_usual(
    camera: &mut impl FeatureAccess,
    name: &str,
    value: &str,
    usual: bool,
) -> Result<(), CameraError> {
    match set_and_check(camera, name, value) {
        Err(CameraError::Feature(e))
            if usual && (e.is_absent() || matches!(e, FeatureError::ReadOnly(_))) =>
        {
            Ok(())
        }
        other => other,
    }
}

/// Sets role, line, polarity and delay of the trigger, and of the strobe.
fn set_trigger(camera: &mut impl FeatureAccess, wanted: &RigCamera) -> Result<(), CameraError> {
    optional(camera.set("TriggerSelector", "FrameStart"))?;
    // Some cameras let the source be changed only while the trigger is off.
    set_or_usual(camera, "TriggerMode", "Off", wanted.trigger == TriggerRole::FreeRun)?;
    if is_host_triggered(wanted) {
        set_and_check(camera, "TriggerSource", "Software")?;
    } else if wanted.trigger == TriggerRole::Hardware {
        let line = wanted.line.as_deref().unwrap_or("Line0");
        optional(camera.set("LineSelector", line))?;
        optional(camera.set("LineMode", "Input"))?;
        set_and_check(camera, "TriggerSource", line)?;
        let (edge, usual) = match wanted.wiring.edge {
            TriggerEdge::Rising => ("RisingEdge", true),
            TriggerEdge::Falling => ("FallingEdge", false),
        };
        set_or_usual(camera, "TriggerActivation", edge, usual)?;
    }
    if wanted.trigger != TriggerRole::FreeRun {
        set_delay(camera, wanted.wiring.delay_ns)?;
        set_and_check(camera, "TriggerMode", "On")?;
    }
    if wanted.master {
        let line = wanted.line.as_deref().unwrap_or("Line1");
        set_and_check(camera, "LineSelector", line)?;
        optional(camera.set("LineMode", "Output"))?;
        set_and_check(camera, "LineSource", "ExposureActive")?;
        let falls = wanted.wiring.edge == TriggerEdge::Falling;
        set_or_usual(camera, "LineInverter", if falls { "true" } else { "false" }, !falls)?;
    }
    Ok(())
}

/// Sets the delay between trigger and exposure, and reads back that it is in force.
fn set_delay(camera: &mut impl FeatureAccess, ns: u64) -> Result<(), CameraError> {
    let us = ns as f64 / 1e3;
    match camera.set("TriggerDelay", &format!("{us:?}")) {
        Err(e) if ns == 0 && (e.is_absent() || matches!(e, FeatureError::ReadOnly(_))) => return Ok(()),
        other => other?,
    }
    let got = camera.get_float("TriggerDelay")?;
    // Cameras count in units of their own, of a few µs at most.
    if (got - us).abs() <= 10.0 {
        return Ok(());
    }
    Err(CameraError::Setup(format!("TriggerDelay was set to {us} µs, but reads back as {got} µs")))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use netcord_common::rig::{Rig, Wiring};
    use netcord_emulator::CameraConfig;

    use super::*;
    use crate::usb::testing::BenchFeatures;

    fn wanted() -> RigCamera {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
        Rig::load(&path).expect("the example is valid").cameras[0].clone()
    }

    fn camera() -> BenchFeatures {
        BenchFeatures::of(CameraConfig::default())
    }

    fn read(camera: &mut BenchFeatures, names: &[&str]) -> Vec<String> {
        names.iter().map(|n| camera.get(n).expect("it can be read").to_string()).collect()
    }

    const WIRING: Wiring = Wiring {
        edge: TriggerEdge::Falling,
        delay_ns: 250_000,
        stamp: netcord_common::rig::StampMeaning::ExposureStart,
    };

    #[test]
    fn a_slave_waits_for_its_line_with_the_polarity_and_delay_of_the_rig_file() {
        let mut slave = camera();
        let rig = RigCamera {
            trigger: TriggerRole::Hardware,
            master: false,
            line: Some("Line2".into()),
            wiring: WIRING,
            ..wanted()
        };
        apply(&mut slave, &rig).expect("it can do this");
        let names = ["TriggerMode", "TriggerSource", "TriggerActivation", "TriggerDelay", "LineMode"];
        assert_eq!(read(&mut slave, &names), ["On", "Line2", "FallingEdge", "250", "Input"]);
    }

    #[test]
    fn a_master_is_triggered_by_the_host_and_strobes_its_exposure() {
        let mut master = camera();
        let rig = RigCamera {
            trigger: TriggerRole::Hardware,
            master: true,
            line: None,
            wiring: WIRING,
            ..wanted()
        };
        apply(&mut master, &rig).expect("it can do this");
        let names =
            ["TriggerSource", "TriggerMode", "LineSelector", "LineMode", "LineSource", "LineInverter"];
        assert_eq!(
            read(&mut master, &names),
            ["Software", "On", "Line1", "Output", "ExposureActive", "true"]
        );
    }

    #[test]
    fn exposure_gain_and_size_are_what_the_camera_says_afterwards() {
        let mut one = camera();
        let rig =
            RigCamera { exposure_ns: 1_234_560, gain_db: 3.217, trigger: TriggerRole::FreeRun, ..wanted() };
        let in_force = apply(&mut one, &rig).expect("it can do this");
        // The camera counts in 0.1 µs and 0.01 dB.
        assert!(in_force.exposure_ns.abs_diff(1_234_560) <= 100, "{in_force:?}");
        assert!((in_force.gain_db - 3.217).abs() < 0.011, "{in_force:?}");
        assert_eq!((in_force.width, in_force.height, in_force.device_format), (1920, 1200, 0x0108_0009));
        assert_eq!(read(&mut one, &["TriggerMode"]), ["Off"]);
        let mut small = camera();
        let config = CameraConfig { sensor: (640, 480), ..CameraConfig::default() };
        let error = apply(&mut BenchFeatures::of(config), &rig).expect_err("too small a sensor").to_string();
        assert!(error.contains("1920") && error.contains("Width"), "{error}");
        assert!(set_exposure(&mut small, 1_000_000_000_000).is_err());
    }

    #[test]
    fn a_mosaic_that_the_device_calls_otherwise_is_taken_as_the_rig_file_says() {
        let mut lying = camera();
        let rig = RigCamera {
            pixel_format: PixelFormat::BayerBG8,
            device_format: Some(PixelFormat::BayerRG8),
            ..wanted()
        };
        let in_force = apply(&mut lying, &rig).expect("it has this format");
        assert_eq!((in_force.device_format, in_force.true_format), (0x0108_0009, PixelFormat::BayerBG8));
        assert_eq!(read(&mut lying, &["PixelFormat"]), ["BayerRG8"]);
    }

    #[test]
    fn formats_of_more_than_8_bits_are_refused_by_name() {
        let config = CameraConfig { deep_only: true, pixel_format: 0x010C_0059, ..CameraConfig::default() };
        let error = apply(&mut BenchFeatures::of(config), &wanted()).expect_err("12 bits").to_string();
        assert!(error.contains("it offers BayerRG12p") && error.contains("BayerRG8"), "{error}");
    }
}
