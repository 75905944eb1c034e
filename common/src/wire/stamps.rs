use iceoryx2::prelude::ZeroCopySend;

use super::assert_layout;

/// When a frame and all that was derived from it passed each stage, in nanoseconds. A message carries
/// those of its sources unchanged and adds its own; 0 = not reached.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("netcord.Stamps")]
#[repr(C)]
pub struct Stamps {
    /// Middle of the exposure: the instant of the measurement, in which results are reported. For
    /// replayed frames it is the recording's own stamp; else CLOCK_MONOTONIC. Written by capture.
    pub mid_exposure_ns: u64,
    /// Middle of the exposure on this machine's CLOCK_MONOTONIC (a replayed frame's is rebased):
    /// what latencies are computed from. Written by capture.
    pub mid_exposure_host_ns: u64,
    /// The last byte of the frame is in the slot, CLOCK_MONOTONIC. Written by capture.
    pub frame_complete_ns: u64,
    /// Just before the frame is sent, CLOCK_MONOTONIC. Written by capture.
    pub frame_published_ns: u64,
    /// The segmenter holds the frame, CLOCK_MONOTONIC. Written by segment.
    pub segment_start_ns: u64,
    /// Just before the detections are sent, CLOCK_MONOTONIC. Written by segment.
    pub segment_published_ns: u64,
    /// The triangulator holds all detections that it uses, CLOCK_MONOTONIC. Written by triangulate.
    pub triangulate_start_ns: u64,
    /// Just before the position is sent, CLOCK_MONOTONIC. Written by triangulate.
    pub triangulate_published_ns: u64,
    /// The predictor holds the position, CLOCK_MONOTONIC. Written by predict.
    pub predict_start_ns: u64,
    /// Just before the trajectory is sent, CLOCK_MONOTONIC. Written by predict.
    pub predict_published_ns: u64,
}

assert_layout!(Stamps, size = 80, mid_exposure_ns = 0, frame_complete_ns = 16, predict_published_ns = 72);
