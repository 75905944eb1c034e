//! What the rig file says of a camera, set on the device and read back.

use netcord_common::{
    PixelFormat,
    rig::{RigCamera, TriggerRole},
};

use super::{CameraError, device::Camera, genapi::FeatureError};

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
pub fn apply(camera: &mut Camera, wanted: &RigCamera) -> Result<InForce, CameraError> {
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
    let int = |camera: &mut Camera, name| -> Result<u32, CameraError> {
        Ok(u32::try_from(camera.get_int(name)?).unwrap_or(0))
    };
    let (width, height) = (int(camera, "Width")?, int(camera, "Height")?);
    if (width, height) != (wanted.model.width, wanted.model.height) {
        return Err(CameraError::Setup(format!(
            "the rig says {} × {} px, but the camera stays at {width} × {height} px",
            wanted.model.width, wanted.model.height
        )));
    }
    let gain_db = camera.get_float("Gain").unwrap_or(wanted.gain_db);
    Ok(InForce { width, height, device_format, true_format: wanted.pixel_format, exposure_ns, gain_db })
}

/// Sets the rig's pixel format. Where the camera does not know it, it may be one that names its mosaic
/// wrongly: any of its 8-bit formats is then taken as what the rig file says; all others are refused.
fn set_format(camera: &mut Camera, wanted: &RigCamera) -> Result<u32, CameraError> {
    match camera.set("PixelFormat", wanted.pixel_format.name()) {
        Ok(()) => return Ok(wanted.pixel_format.pfnc()),
        Err(FeatureError::NoEntry { .. }) => {}
        Err(e) => return Err(e.into()),
    }
    let mut code = u32::try_from(camera.get_int("PixelFormat")?).unwrap_or(0);
    if PixelFormat::from_pfnc(code).is_err() {
        let offered = camera.info("PixelFormat")?.entries;
        let eight_bit = offered.iter().find(|name| name.parse::<PixelFormat>().is_ok());
        let Some(name) = eight_bit else {
            return Err(CameraError::Setup(format!(
                "the camera offers only {}: formats of 10 and 12 bits are not taken; set one of 8 bits",
                offered.join(", ")
            )));
        };
        camera.set("PixelFormat", name)?;
        code = u32::try_from(camera.get_int("PixelFormat")?).unwrap_or(0);
    }
    tracing::warn!(
        camera = %wanted.name,
        "the camera has no {}: its {code:#010x} is taken as what the rig file says",
        wanted.pixel_format
    );
    Ok(code)
}

/// Sets the exposure, ns; gives what is in force.
///
/// # Errors
/// [`FeatureError`].
pub fn set_exposure(camera: &mut Camera, ns: u64) -> Result<u64, FeatureError> {
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
pub fn set_gain(camera: &mut Camera, db: f64) -> Result<f64, FeatureError> {
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
pub fn set_white_balance(camera: &mut Camera, red: f64, blue: f64) -> Result<(), FeatureError> {
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
pub fn set_rate(camera: &mut Camera, hz: f64) -> Result<(), FeatureError> {
    optional(camera.set("AcquisitionFrameRateEnable", "true"))?;
    camera.set("AcquisitionFrameRate", &format!("{hz:?}"))
}

fn set_trigger(camera: &mut Camera, wanted: &RigCamera) -> Result<(), CameraError> {
    optional(camera.set("TriggerSelector", "FrameStart"))?;
    let set = |camera: &mut Camera, name: &str, value: &str| -> Result<(), CameraError> {
        camera.set(name, value)?;
        let got = camera.get(name)?.to_string();
        if got == value {
            return Ok(());
        }
        Err(CameraError::Setup(format!("{name} was set to {value}, but reads back as {got}")))
    };
    // Some cameras let the source be changed only while the trigger is off.
    set(camera, "TriggerMode", "Off").or_else(|e| match e {
        CameraError::Feature(f) if f.is_absent() && wanted.trigger == TriggerRole::FreeRun => Ok(()),
        other => Err(other),
    })?;
    if is_host_triggered(wanted) {
        set(camera, "TriggerSource", "Software")?;
        set(camera, "TriggerMode", "On")?;
    } else if wanted.trigger == TriggerRole::Hardware {
        let line = wanted.line.as_deref().unwrap_or("Line0");
        optional(camera.set("LineSelector", line))?;
        optional(camera.set("LineMode", "Input"))?;
        set(camera, "TriggerSource", line)?;
        optional(camera.set("TriggerActivation", "RisingEdge"))?;
        optional(camera.set("TriggerDelay", "0"))?;
        set(camera, "TriggerMode", "On")?;
    }
    if wanted.master {
        let line = wanted.line.as_deref().unwrap_or("Line1");
        set(camera, "LineSelector", line)?;
        optional(camera.set("LineMode", "Output"))?;
        set(camera, "LineSource", "ExposureActive")?;
    }
    Ok(())
}
