use std::{hint::black_box, time::Instant};

use netcord_common::{
    geometry::Point,
    rig::Rig,
    wire::{Detection, Detections, Stamps},
};
use netcord_detect::triangulate::{TriangulateOptions, Triangulator};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::median;

/// Triggers measured.
const TRIGGERS: u64 = 4000;

/// Time for one position by the default method from one candidate in every view that sees the ball, µs, median.
pub fn measure_triangulation(rig: &Rig) -> Option<f64> {
    let mut triangulator = Triangulator::new(rig, &TriangulateOptions::default());
    let mut random = Pcg64::seed_from_u64(2);
    let mut times = Vec::new();
    for trigger_id in 1..=TRIGGERS {
        // A ball on its way over the table, seen with a tenth of a pixel's noise.
        let s = trigger_id as f64 * rig.interval_ns() as f64 * 1e-9;
        let phase = s % 0.8 / 0.8;
        let ball = Point::new(0.3 * (s * 1.7).sin(), -1.2 + 2.4 * phase, 0.15 + 0.9 * phase * (1.0 - phase));
        let messages: Vec<Detections> = rig
            .cameras
            .iter()
            .filter_map(|camera| {
                let pixel = camera.model.project(&(&camera.camera_from_world * ball))?;
                if !camera.model.contains(&pixel) {
                    return None;
                }
                let mut message = Detections {
                    trigger_id,
                    sequence: trigger_id,
                    session: 1,
                    camera: camera.index.code(),
                    exposure_ns: camera.exposure_ns,
                    stamps: Stamps { mid_exposure_ns: trigger_id * rig.interval_ns(), ..Stamps::default() },
                    ..Detections::default()
                };
                let mut noise = || random.random_range(-0.15..0.15);
                let (u_px, v_px) = (pixel.x + noise(), pixel.y + noise());
                message.insert(Detection {
                    u_px,
                    v_px,
                    covariance_px2: [0.01, 0.0, 0.01],
                    x0_px: u_px - 7.0,
                    y0_px: v_px - 7.0,
                    x1_px: u_px + 7.0,
                    y1_px: v_px + 7.0,
                    diameter_px: 14.0,
                    area_px2: 154.0,
                    score: 0.9,
                    ..Detection::default()
                });
                Some(message)
            })
            .collect();
        let references: Vec<&Detections> = messages.iter().collect();
        let start = Instant::now();
        let position = black_box(triangulator.process(black_box(&references)));
        let us = start.elapsed().as_secs_f64() * 1e6;
        if position.is_present() {
            times.push(us);
        }
    }
    median(&times)
}
