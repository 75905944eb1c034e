use nalgebra::{Vector2, Vector3};

use super::{Air, BallState, NET_HALF_WIDTH_M, NET_HEIGHT_M};

/// What a stroke is meant to do.
#[derive(Debug, Clone, Copy)]
pub struct Aim {
    /// Where the racket meets the ball, m.
    pub from: Vector3<f64>,
    /// Where the ball should touch the table, m.
    pub to: Vector2<f64>,
    /// Spin given, rad/s.
    pub spin: Vector3<f64>,
    /// Time until it lands, s.
    pub flight_s: f64,
}

/// Corrections of the velocity: each leaves a few percent of the miss.
const CORRECTIONS: u32 = 12;

/// How near to its target a ball must land, m.
const NEAR_ENOUGH_M: f64 = 0.002;

/// Step of the trial flights, s.
const STEP_S: f64 = 4e-3;

/// The initial state that lands on the target after the given time, or `None` where there is none, or
/// where it would meet the net.
///
/// A shooting method: fly a trial, correct the velocity by the miss over the time.
pub fn solve(air: &Air, radius_m: f64, aim: &Aim) -> Option<BallState> {
    let target = Vector3::new(aim.to.x, aim.to.y, radius_m);
    let fall = Vector3::z() * (0.5 * air.gravity_m_s2 * aim.flight_s);
    let mut velocity = (target - aim.from) / aim.flight_s + fall;
    for _ in 0..CORRECTIONS {
        let start = BallState { position: aim.from, velocity, spin: aim.spin };
        let (end, clears) = trial(air, radius_m, start, aim.flight_s);
        let miss = end - target;
        if miss.norm() < NEAR_ENOUGH_M {
            return clears.then_some(start);
        }
        velocity -= miss / aim.flight_s;
        if !velocity.iter().all(|v| v.is_finite()) || velocity.norm() > 60.0 {
            return None;
        }
    }
    None
}

/// Where the ball is after `seconds`, and whether it passes over the net on the way.
fn trial(air: &Air, radius_m: f64, start: BallState, seconds: f64) -> (Vector3<f64>, bool) {
    let steps = (seconds / STEP_S).ceil().max(1.0);
    let dt = seconds / steps;
    let mut state = start;
    let mut clears = true;
    for _ in 0..steps as usize {
        let next = air.step(&state, dt);
        let (a, b) = (state.position, next.position);
        if a.y * b.y <= 0.0 && a.y != b.y {
            let at = a.lerp(&b, a.y / (a.y - b.y));
            clears &= at.x.abs() > NET_HALF_WIDTH_M || at.z > NET_HEIGHT_M + 1.2 * radius_m;
        }
        state = next;
    }
    (state.position, clears)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ball_lands_where_it_was_aimed() {
        let air = Air::new(0.02, 0.47, 0.12);
        let aim = Aim {
            from: Vector3::new(0.2, -1.6, 0.25),
            to: Vector2::new(-0.4, 0.9),
            spin: Vector3::new(-300.0, 0.0, 80.0),
            flight_s: 0.38,
        };
        let mut state = solve(&air, 0.02, &aim).expect("an ordinary topspin");
        for _ in 0..380 {
            state = air.step(&state, 1e-3);
        }
        assert!((state.position.xy() - aim.to).norm() < 0.003, "{}", state.position);
        assert!((state.position.z - 0.02).abs() < 0.003);
        let flat = Aim { flight_s: 0.10, from: Vector3::new(0.2, -1.6, 0.05), ..aim };
        assert!(solve(&air, 0.02, &flat).is_none(), "a smash from below the net's height meets the net");
    }
}
