use std::f64::consts::TAU;

use nalgebra::Vector3;

/// The light of a hall: lamps above, light from all sides, and what the mains and the day do to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Direction to each lamp, of unit length, in the world frame, and its strength.
    pub lamps: [(Vector3<f64>, f64); 2],
    /// Light from above without direction.
    pub sky: f64,
    /// Light from below, which floor and table throw back: what a ball's underside gets.
    pub ground: f64,
    /// Flicker of the lamps.
    pub flicker: Flicker,
    /// Slow change.
    pub dimming: Dimming,
}

/// Lamps on mains shine with twice its frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flicker {
    /// Frequency of the light, Hz: 100 or 120.
    pub light_hz: f64,
    /// Half the swing as a share of the brightest, 0–0.5.
    pub depth: f64,
    /// Phase at the time zero, rad.
    pub phase: f64,
}

/// Clouds, or somebody at the switch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dimming {
    /// From bright to dark and back, s.
    pub period_s: f64,
    /// What is lost at the darkest, 0–1.
    pub depth: f64,
}

impl Light {
    /// The brightness of an exposure of `length_s` about `mid_s`, as a share of the brightest, 0–1.
    pub fn gain(&self, mid_s: f64, length_s: f64) -> f64 {
        let Flicker { light_hz, depth, phase } = self.flicker;
        // The mean of the cosine over the exposure.
        let half = 0.5 * TAU * light_hz * length_s;
        let blurred = if half > 1e-9 { half.sin() / half } else { 1.0 };
        let flicker = (1.0 - depth) + depth * blurred * (TAU * light_hz * mid_s + phase).cos();
        let Dimming { period_s, depth } = self.dimming;
        flicker * (1.0 - depth * (0.5 - 0.5 * (TAU * mid_s / period_s).cos()))
    }

    /// Irradiance of a surface with this unit normal (world frame).
    pub fn on(&self, normal: &Vector3<f64>) -> f64 {
        let lamps: f64 = self.lamps.iter().map(|(to, strength)| strength * to.dot(normal).max(0.0)).sum();
        lamps + self.sky * (0.5 + 0.5 * normal.z) + self.ground * (0.5 - 0.5 * normal.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_is_the_mean_over_the_exposure_and_never_above_one() {
        let light = Light {
            lamps: [(Vector3::z(), 0.6), (Vector3::x(), 0.0)],
            sky: 0.3,
            ground: 0.1,
            flicker: Flicker { light_hz: 100.0, depth: 0.2, phase: 0.4 },
            dimming: Dimming { period_s: 30.0, depth: 0.3 },
        };
        for i in 0..50 {
            let (mid, length) = (f64::from(i) * 0.137, 0.003);
            let samples = 2000;
            let mean = (0..samples)
                .map(|k| light.gain(mid + length * ((f64::from(k) + 0.5) / f64::from(samples) - 0.5), 0.0))
                .sum::<f64>()
                / f64::from(samples);
            assert!((light.gain(mid, length) - mean).abs() < 1e-5);
            assert!(light.gain(mid, length) <= 1.0);
        }
        assert!(light.on(&Vector3::z()) > light.on(&-Vector3::z()), "the underside is dark");
    }
}
