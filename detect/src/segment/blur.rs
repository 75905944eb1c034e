//! How long the image of a ball in play can be swept during one exposure.

use netcord_common::wire::{Detection, DetectionFlags, SearchWindow};

use super::sweep::Sweep;

/// Faster than any ball in play, m/s: the fastest smashes that were measured leave the racket with 32 m/s.
const TOP_SPEED_M_S: f64 = 40.0;

/// Balls found where they were expected after which their blur tells how long the exposures last.
const CONFIDENT: u32 = 8;

/// Shortest way during 10 ms that tells anything of the exposure, px.
const LEAST_WAY_PX: f64 = 4.0;

/// Share of a new ball in what is learnt, at least: a running mean over about 50 balls.
const LEAST_SHARE: f64 = 0.02;

/// The longest sweep that a ball's image can have: its length against the ball's diameter is the way in diameters
/// that the ball flies during the exposure. Limbs and paddles are longer.
#[derive(Debug, Clone)]
pub struct BlurLimit {
    ball_m: f64,
    /// What the frame's header says, s; none where it does not say.
    told_s: Option<f64>,
    /// From the blur of balls whose speed was known, s, and their number.
    learnt_s: f64,
    learnt: u32,
}

impl BlurLimit {
    /// How much longer than a ball's sweep a first guess may be, which blobs give roughly.
    pub const OF_A_START: (f32, f32) = (1.6, 6.0);
    /// … and a fitted one.
    pub const OF_A_FIT: (f32, f32) = (1.15, 3.0);

    /// For a ball of this diameter, m.
    pub const fn new(ball_m: f64) -> Self {
        Self { ball_m, told_s: None, learnt_s: 0.0, learnt: 0 }
    }

    /// Takes the length of a frame's exposure, ns; 0 where it is not known.
    pub fn expose(&mut self, exposure_ns: u64) {
        self.told_s = (exposure_ns > 0).then_some(exposure_ns as f64 * 1e-9);
    }

    /// Length of the exposure as far as it is known, s; 0 where it is not.
    pub fn exposure_s(&self) -> f64 {
        self.known_s().unwrap_or(0.0)
    }

    fn known_s(&self) -> Option<f64> {
        self.told_s.or((self.learnt >= CONFIDENT).then_some(self.learnt_s))
    }

    /// Whether a ball in play can look like this; `(factor, px)` is by how much the sweep's length may be wrong.
    pub fn allows(&self, sweep: &Sweep, (factor, px): (f32, f32)) -> bool {
        self.known_s().is_none_or(|exposure_s| {
            let diameters = (TOP_SPEED_M_S * exposure_s / self.ball_m) as f32;
            sweep.length <= factor * diameters * 2.0 * sweep.radius + px
        })
    }

    /// Learns the length of the exposure, where nobody tells it, from a ball found where `window` expected it.
    pub fn learn(&mut self, ball: &Detection, window: &SearchWindow) {
        let [u, v] = window.velocity_px_s;
        let speed = u.hypot(v);
        if self.told_s.is_some() || speed * 0.01 < LEAST_WAY_PX {
            return;
        }
        let measured = ball.flags & DetectionFlags::BLUR_MEASURED != 0;
        let blur = if measured { ball.blur_u_px.hypot(ball.blur_v_px) } else { 0.0 };
        self.learnt += 1;
        let share = (1.0 / f64::from(self.learnt)).max(LEAST_SHARE);
        self.learnt_s += share * (blur / speed - self.learnt_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sweep(diameter: f32, length: f32) -> Sweep {
        Sweep { centre: [0.0; 2], radius: 0.5 * diameter, length, angle: 0.0 }
    }

    #[test]
    fn no_ball_flies_two_diameters_in_a_millisecond() {
        let mut limit = BlurLimit::new(0.040);
        assert!(limit.allows(&sweep(20.0, 200.0), BlurLimit::OF_A_FIT), "nothing is known of the exposure");
        limit.expose(1_000_000);
        // 30 m/s: three quarters of a diameter.
        assert!(limit.allows(&sweep(20.0, 15.0), BlurLimit::OF_A_FIT));
        assert!(!limit.allows(&sweep(20.0, 40.0), BlurLimit::OF_A_FIT));
        limit.expose(6_000_000);
        assert!(limit.allows(&sweep(20.0, 90.0), BlurLimit::OF_A_FIT));
    }

    #[test]
    fn the_exposure_is_learnt_from_balls_of_known_speed_where_nobody_tells_it() {
        let mut limit = BlurLimit::new(0.040);
        let window = SearchWindow { velocity_px_s: [3000.0, 4000.0], ..SearchWindow::default() };
        let ball = |blur: f64| Detection {
            blur_u_px: 0.6 * blur,
            blur_v_px: 0.8 * blur,
            flags: DetectionFlags::BLUR_MEASURED,
            ..Detection::default()
        };
        for n in 0..20 {
            limit.learn(&ball(if n % 2 == 0 { 9.5 } else { 10.5 }), &window);
        }
        assert!((limit.exposure_s() - 0.002).abs() < 1e-4, "{}", limit.exposure_s());
        assert!(!limit.allows(&sweep(20.0, 100.0), BlurLimit::OF_A_FIT));
        limit.expose(500_000);
        assert_eq!(limit.exposure_s(), 0.0005, "what is told counts");
    }
}
