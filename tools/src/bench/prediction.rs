use std::{hint::black_box, time::Instant};

use netcord_capture::synthetic::scene::{Scene, SceneError, SceneOptions};
use netcord_common::{
    rig::Rig,
    wire::{BallPosition, NoPosition},
};
use netcord_detect::flight::{PredictOptions, Predictor};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use serde::Serialize;

/// Triggers of the rally: two minutes of play at 100 Hz.
const TRIGGERS: u64 = 12_000;
/// The rally is predicted so often, and the least time of each trigger counts: what the machine does beside it is
/// no property of the predictor.
const ROUNDS: usize = 5;
/// Half width of the positions' errors, m.
const ERROR_M: f64 = 0.002;

/// Time from a position to the trajectory and the search windows of the next trigger, µs.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct PredictTimes {
    /// Median.
    pub p50: f64,
    /// 99 %.
    pub p99: f64,
    /// The longest.
    pub worst: f64,
    /// Triggers with a trajectory.
    pub trajectories: usize,
}

/// Predicts a synthetic rally with strokes, bounces and pauses, one position in fifty missing and one in a hundred
/// far off.
///
/// # Errors
/// [`SceneError`] where there is no scene around the rig.
pub fn measure_prediction(rig: &Rig) -> Result<Option<PredictTimes>, SceneError> {
    let positions = rally(rig)?;
    let mut least = vec![f64::INFINITY; positions.len()];
    let mut trajectories = 0;
    for _ in 0..ROUNDS {
        let mut predictor = Predictor::new(rig, PredictOptions::default());
        trajectories = 0;
        for (position, least) in positions.iter().zip(&mut least) {
            let start = Instant::now();
            let trajectory = black_box(predictor.update(black_box(position)));
            trajectories += usize::from(!trajectory.path().is_empty());
            let next_ns = position.stamps.mid_exposure_ns + rig.interval_ns();
            black_box(predictor.windows(next_ns).count());
            *least = least.min(start.elapsed().as_secs_f64() * 1e6);
        }
    }
    least.sort_by(f64::total_cmp);
    let at = |share: f64| least.get((share * (least.len() - 1) as f64) as usize).copied();
    let times = || Some(PredictTimes { p50: at(0.5)?, p99: at(0.99)?, worst: at(1.0)?, trajectories });
    Ok(times())
}

fn rally(rig: &Rig) -> Result<Vec<BallPosition>, SceneError> {
    let mut track = Scene::new(rig, &SceneOptions { seed: 2, ..SceneOptions::default() })?.track();
    let mut random = Pcg64::seed_from_u64(7);
    let positions = (1..=TRIGGERS)
        .map(|trigger_id| {
            let t_ns = trigger_id * rig.interval_ns();
            let mut message = BallPosition { trigger_id, sequence: trigger_id, ..BallPosition::default() };
            message.stamps.mid_exposure_ns = t_ns;
            let variance = ERROR_M * ERROR_M / 3.0;
            message.covariance_m2 = [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance];
            match track.at(t_ns as f64 * 1e-9) {
                Some(ball) if !random.random_bool(0.02) => {
                    let far = if random.random_bool(0.01) { 0.3 } else { 0.0 };
                    let p = ball.state.position;
                    let mut error = || random.random_range(-ERROR_M..ERROR_M);
                    message.position_m = [p.x + far + error(), p.y + error(), p.z + error()];
                }
                _ => message.reason = NoPosition::NoDetection.code(),
            }
            message
        })
        .collect();
    Ok(positions)
}
