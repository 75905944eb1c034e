//! Times of the segmenter against the machine's floor: a plain read of the same bytes, in turn with it in one
//! loop, from a ring of frames that no cache holds.
//!
//! `cargo bench -p netcord-detect --bench segment`

use std::{hint::black_box, path::Path, time::Instant};

use netcord_common::{
    FrameView, PixelFormat,
    rig::Rig,
    wire::{FrameHeader, Scope, SearchWindow},
};
use netcord_detect::segment::{SegmentOptions, Segmenter, kernel::Kernel};

const WIDTH: usize = 1920;
const HEIGHT: usize = 1200;
/// 64 × 2.3 MB = 147 MB.
const FRAMES: usize = 64;

fn main() {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../common/rigs/example-2cam.toml"));
    let rig = Rig::load(path).expect("the example rig is valid");
    let frames = (0..FRAMES).map(frame).collect::<Vec<_>>();
    let kernel = Kernel::detect();
    let mut segmenter = Segmenter::new(&rig, 0, SegmentOptions::default()).expect("valid");
    let (mut reads, mut fulls, mut windows, mut with_windows, mut found) =
        (vec![], vec![], vec![], vec![], 0);
    for round in 0..8 {
        for (i, bytes) in frames.iter().enumerate() {
            let started = Instant::now();
            black_box(kernel.sum(bytes));
            let read = started.elapsed().as_secs_f64() * 1e6;

            // Another frame, for the one just read is in the caches now.
            let next = (i + FRAMES / 2) % FRAMES;
            let view =
                FrameView::new(&frames[next], (WIDTH, HEIGHT), WIDTH, PixelFormat::BayerRG8).expect("fits");
            let n = (round * FRAMES + i) as u64;
            let header = FrameHeader { trigger_id: n, sequence: n, ..FrameHeader::default() };
            let [x, y] = place(next);
            let window = SearchWindow {
                x0_px: x - 40.0,
                y0_px: y - 40.0,
                x1_px: x + 40.0,
                y1_px: y + 40.0,
                u_px: x,
                v_px: y,
                diameter_px: 2.0 * RADIUS,
                present: 1,
                ..SearchWindow::default()
            };
            let with_window = round % 2 == 1;
            let started = Instant::now();
            let (mut at_window, mut candidates) = (None, 0);
            segmenter
                .process(&header, &view, with_window.then_some(&window), &mut |message| {
                    if message.scope == Scope::Window.code() {
                        at_window = Some(started.elapsed().as_secs_f64() * 1e6);
                    } else {
                        candidates = message.count;
                    }
                })
                .expect("the frame fits");
            let full = started.elapsed().as_secs_f64() * 1e6;
            if round < 2 {
                continue;
            }
            reads.push(read);
            if with_window {
                with_windows.push(full)
            } else {
                fulls.push(full)
            }
            windows.extend(at_window);
            found += candidates;
        }
    }
    println!("read_frame_us          {}", line(&mut reads));
    println!("segment_full_us        {}", line(&mut fulls));
    println!("segment_window_us      {}", line(&mut windows));
    println!("window, then full, us  {}", line(&mut with_windows));
    println!(
        "segment_full_over_read {:.2} (medians), {:.2} (minima)",
        fulls[fulls.len() / 2] / reads[reads.len() / 2],
        fulls[0] / reads[0]
    );
    println!(
        "candidates a frame     {:.2}, found in window {} of {}",
        f64::from(found) / reads.len() as f64,
        windows.len(),
        with_windows.len()
    );
}

fn line(values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    let at = |q: f64| values.get((q * values.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    format!("least {:.1}, median {:.1}, p90 {:.1}", at(0.0), at(0.5), at(0.9))
}

const RADIUS: f64 = 8.0;

fn place(i: usize) -> [f64; 2] {
    let t = i as f64 / FRAMES as f64;
    [300.0 + 1200.0 * t, 700.0 - 900.0 * t * (1.0 - t)]
}

/// A hall with a ball in flight: patches of many colours, noise of about 2 DN.
fn frame(i: usize) -> Vec<u8> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(i as u64 + 1);
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let [cx, cy] = place(i);
    let mut bytes = Vec::with_capacity(WIDTH * HEIGHT);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let channel = PixelFormat::BayerRG8.channel_at(x, y) as usize;
            let patch = (x / 37 * 7919 + y / 29 * 104_729 + channel * 31) % 97;
            let background = 25.0 + patch as f64;
            let (dx, dy) = (x as f64 - cx, y as f64 - cy);
            let alpha = (RADIUS - dx.hypot(dy) + 0.5).clamp(0.0, 1.0);
            let light = 0.45 - 0.4 * dy / RADIUS;
            let ball = [230.0, 120.0, 35.0][channel] * light.max(0.15);
            let bits = random();
            // Four uniform numbers make a near-normal one.
            let noise = (0..4).map(|k| ((bits >> (16 * k)) & 0xffff) as f64 / 65_536.0 - 0.5).sum::<f64>();
            bytes.push(
                (background + alpha * (ball - background) + 3.4 * noise).round().clamp(0.0, 255.0) as u8
            );
        }
    }
    bytes
}
