//! Positions of an endless rally as the triangulator would give them: strokes to and fro, bounces, gaps, outliers,
//! late positions. Ballistic: what is measured with it is time and memory, not accuracy.

use netcord_common::wire::{BallPosition, NoPosition};

/// Between triggers, ns.
pub const INTERVAL_NS: u64 = 10_000_000;
/// Triggers from one stroke to the next.
const STROKE: u64 = 60;

/// The position of trigger `id`; every 31st is 0.3 m off, every 17th missing.
fn position(id: u64) -> BallPosition {
    let (stroke, k) = (id / STROKE, id % STROKE);
    let sign = if stroke.is_multiple_of(2) { 1.0 } else { -1.0 };
    // Strokes of different speed and direction, all of which bounce on the other side.
    let (speed, aside) = (4.6 + 0.2 * (stroke % 4) as f64, 0.3 * ((stroke % 5) as f64 - 2.0));
    let t = k as f64 * 0.01;
    let (up, start_z) = (1.5, 0.25);
    let lands = (up + f64::sqrt(up * up + 2.0 * 9.81 * (start_z - 0.02))) / 9.81;
    let after = t - lands;
    let z = if after < 0.0 {
        start_z + up * t - 0.5 * 9.81 * t * t
    } else {
        0.02 + 0.9 * (9.81 * lands - up) * after - 0.5 * 9.81 * after * after
    };
    let jitter = |i: u64| ((id * 7919 + i * 104_729) % 997) as f64 / 997.0 - 0.5;
    let off = if id.is_multiple_of(31) { 0.3 } else { 0.0 };
    let mut message = BallPosition { trigger_id: id, sequence: id, ..BallPosition::default() };
    message.stamps.mid_exposure_ns = 1_000_000_000 + id * INTERVAL_NS;
    message.position_m = [
        aside * t + 0.002 * jitter(1) + off,
        sign * (-1.4 + speed * t) + 0.002 * jitter(2),
        z + 0.002 * jitter(3),
    ];
    message.covariance_m2 = [1e-6, 0.0, 0.0, 0.0, 1e-6, 0.0, 0.0, 0.0, 1e-6];
    if id.is_multiple_of(17) {
        message.reason = NoPosition::NoDetection.code();
    }
    message
}

/// Positions in the order in which they come: every 23rd is late by one trigger.
pub fn positions() -> impl Iterator<Item = BallPosition> {
    (1_u64..).map(|id| match id % 23 {
        21 => position(id + 1),
        22 => position(id - 1),
        _ => position(id),
    })
}
