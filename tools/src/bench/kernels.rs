use std::{error::Error, hint::black_box, time::Instant};

use netcord_common::{
    FrameView,
    rig::Rig,
    wire::{Scope, SearchWindow},
};
use netcord_detect::segment::{SegmentOptions, Segmenter};

use super::{FrameRing, median, sum_bytes};

/// Times of the segmenter and of the floor beside it, µs, medians.
#[derive(Debug, Clone, Copy)]
pub struct KernelTimes {
    /// Reading a frame once.
    pub read_frame_us: f64,
    /// From a frame to the detections of the whole of it.
    pub segment_full_us: f64,
    /// … until the segmenter has learnt from it, too, and is ready for the next.
    pub segment_all_us: f64,
    /// The median of the ratios of neighbours.
    pub segment_full_over_read: f64,
    /// From the frame to the detections of its search window; absent where no window held the ball.
    pub segment_window_us: Option<f64>,
}

/// Laps over the ring: the first one is for the segmenter to learn its background.
const LAPS: usize = 5;
/// Half the side of the search windows, px: a ball that is well followed is found within less.
const HALF_WINDOW_PX: f64 = 32.0;

/// Times reading and searching in one loop, frame by frame.
///
/// # Errors
/// What the scene and the segmenter refuse.
pub fn measure_kernels(
    rig: &Rig,
    ring: &FrameRing,
    progress: &mut dyn FnMut(f64),
) -> Result<KernelTimes, Box<dyn Error>> {
    let mut segmenter = Segmenter::new(rig, 0, SegmentOptions::default())?;
    let interval_ns = rig.interval_ns();
    let (mut reads, mut searches, mut alls) = (Vec::new(), Vec::new(), Vec::new());
    let (mut ratios, mut windows) = (Vec::new(), Vec::new());
    let total = LAPS * ring.len();
    for n in 0..total {
        progress(n as f64 / total as f64);
        // Each looks at a frame that has left the caches: half a ring lies between them.
        let (_, bytes, _) = ring.frame(n + ring.len() / 2, interval_ns);
        let start = Instant::now();
        black_box(sum_bytes(black_box(bytes)));
        let read_us = start.elapsed().as_secs_f64() * 1e6;

        let (header, bytes, truth) = ring.frame(n, interval_ns);
        let view = FrameView::of(&header, bytes)?;
        // Every other lap is searched with windows, so that both are measured by themselves.
        let window = ((n / ring.len()).is_multiple_of(2) && truth.visible > 0.9).then(|| SearchWindow {
            mid_exposure_ns: header.stamps.mid_exposure_ns,
            x0_px: truth.u_px - HALF_WINDOW_PX,
            y0_px: truth.v_px - HALF_WINDOW_PX,
            x1_px: truth.u_px + HALF_WINDOW_PX,
            y1_px: truth.v_px + HALF_WINDOW_PX,
            u_px: truth.u_px,
            v_px: truth.v_px,
            covariance_px2: [4.0, 0.0, 4.0],
            diameter_px: 14.0,
            present: 1,
            ..SearchWindow::default()
        });
        let start = Instant::now();
        let (mut window_us, mut search_us) = (None, 0.0);
        segmenter.process(&header, &view, window.as_ref(), &mut |message| {
            let us = start.elapsed().as_secs_f64() * 1e6;
            if message.scope == Scope::Window.code() {
                window_us = Some(us);
            } else {
                search_us = us;
            }
            black_box(message);
        })?;
        let all_us = start.elapsed().as_secs_f64() * 1e6;
        if n < ring.len() {
            continue;
        }
        windows.extend(window_us);
        if window.is_none() {
            reads.push(read_us);
            searches.push(search_us);
            alls.push(all_us);
            ratios.push(search_us / read_us);
        }
    }
    let of = |values: &[f64]| median(values).ok_or("too few frames to measure");
    Ok(KernelTimes {
        read_frame_us: of(&reads)?,
        segment_full_us: of(&searches)?,
        segment_all_us: of(&alls)?,
        segment_full_over_read: of(&ratios)?,
        segment_window_us: median(&windows),
    })
}
