//! How likely colours are, in the surroundings of a marked box and on the ball in it.

use std::collections::HashMap;

/// Steps of colour in which surroundings are counted: 2⁵ of 8 DN.
const STEP_BITS: u32 = 3;
/// Share of the surroundings that may have any colour, seen or not, 0–1.
const UNSEEN: f64 = 0.02;
/// Standard deviation that a ball's colour has at least, DN: shading, noise.
const LEAST_SPREAD: f64 = 8.0;

/// Colours around a box, counted in coarse steps.
#[derive(Debug, Default)]
pub struct Surroundings {
    counts: HashMap<[i32; 3], f64>,
    total: f64,
}

impl Surroundings {
    /// Counts one more.
    pub fn add(&mut self, rgb: [f64; 3]) {
        *self.counts.entry(Self::step(rgb)).or_default() += 1.0;
        self.total += 1.0;
    }

    fn step(rgb: [f64; 3]) -> [i32; 3] {
        rgb.map(|level| (level as i32) >> STEP_BITS)
    }

    /// Density per DN³, smoothed over neighbouring steps.
    pub fn density(&self, rgb: [f64; 3]) -> f64 {
        let [r, g, b] = Self::step(rgb);
        let mut sum = 0.0;
        for (dr, dg, db) in
            (-1..=1).flat_map(|r| (-1..=1).flat_map(move |g| (-1..=1).map(move |b| (r, g, b))))
        {
            sum += self.counts.get(&[r + dr, g + dg, b + db]).copied().unwrap_or(0.0);
        }
        let volume = f64::from(3_u32 << STEP_BITS).powi(3);
        // A colour that was never seen may occur, anywhere in the cube.
        (sum / volume + UNSEEN * self.total.max(1.0) / 256.0_f64.powi(3)) / self.total.max(1.0)
    }
}

/// A normal distribution of colours, without correlations.
#[derive(Debug, Clone, Copy)]
pub struct Normal {
    mean: [f64; 3],
    variance: [f64; 3],
}

impl Normal {
    /// Of some colours; none where there are none.
    pub fn of(colours: impl Iterator<Item = [f64; 3]> + Clone) -> Option<Self> {
        let n = colours.clone().count() as f64;
        if n < 1.0 {
            return None;
        }
        let mean = [0, 1, 2].map(|c| colours.clone().map(|rgb| rgb[c]).sum::<f64>() / n);
        let variance = [0, 1, 2].map(|c| {
            colours.clone().map(|rgb| (rgb[c] - mean[c]).powi(2)).sum::<f64>() / n
                + LEAST_SPREAD * LEAST_SPREAD
        });
        Some(Self { mean, variance })
    }

    /// Density per DN³.
    pub fn density(&self, rgb: [f64; 3]) -> f64 {
        let mut exponent = 0.0;
        let mut scale = 1.0;
        for c in 0..3 {
            exponent += (rgb[c] - self.mean[c]).powi(2) / (2.0 * self.variance[c]);
            scale *= (std::f64::consts::TAU * self.variance[c]).sqrt();
        }
        (-exponent).exp() / scale
    }
}
