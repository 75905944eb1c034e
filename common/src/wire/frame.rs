use iceoryx2::prelude::ZeroCopySend;

use super::{Message, Stamps, assert_layout};

/// Header of `camera/<name>/frame`; the payload is the mosaic as it left the sensor, row by row.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.FrameHeader")]
#[repr(C)]
pub struct FrameHeader {
    /// Which exposure of the rig: the same for all cameras of one trigger, only ever growing, over
    /// restarts of capture too.
    pub trigger_id: u64,
    /// Counts this camera's frames from 1, one up for each that capture publishes in this session; a
    /// gap at a reader is a frame that the reader lost.
    pub sequence: u64,
    /// CLOCK_MONOTONIC ns at which this capture process started: a new value begins a new
    /// `sequence`.
    pub session: u64,
    /// When; capture fills the first four.
    pub stamps: Stamps,
    /// Length of the exposure, ns.
    pub exposure_ns: u64,
    /// The device's own block id (frame counter), where it has one.
    pub block_id: u64,
    /// Gain in dB.
    pub gain_db: f64,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from one row to the next; at least `width`.
    pub stride: u32,
    /// PFNC code of the pixel format.
    pub pixel_format: u32,
    /// Place of the camera in the rig file, from 0.
    pub camera: u32,
    #[doc(hidden)]
    pub _reserved: u32,
}

assert_layout!(FrameHeader, size = 152, stamps = 24, exposure_ns = 104, width = 128, camera = 144);

impl Message for FrameHeader {}
