/// Steps of brightness that noise is watched in.
const BINS: usize = 16;

/// How far one look moves a bin's estimate: by this factor up or down, so that it settles at the median.
const STEP: f32 = 1.01;

/// Smallest standard deviation of a difference to the background, DN: rounding to whole levels alone gives
/// 0.29 in each of the two.
const LEAST_SIGMA: f32 = 0.6;

/// The noise of differences between a frame and the background, by brightness; learnt while running.
///
/// Shot noise and read noise together give a variance that is a straight line in brightness (EMVA 1288); the
/// line is fitted to what the frames show, so that it holds for any gain, and for any renderer.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    /// Median over looks of the mean absolute difference in each bin, DN.
    deviation: [f32; BINS],
    looks: [u32; BINS],
    /// Variance at level 0, DN², and its slope, DN.
    line: [f32; 2],
}

impl Noise {
    /// What is assumed before anything has been seen: more than any usable camera has.
    pub fn new() -> Self {
        let line = [4.0, 0.12];
        let deviation = std::array::from_fn(|i| {
            (line[0] + line[1] * (16 * i + 8) as f32).sqrt() / MEAN_ABSOLUTE_TO_SIGMA
        });
        Self { deviation, looks: [0; BINS], line }
    }

    /// Takes note of the mean absolute difference of a small stretch of mean brightness `level`.
    pub fn look(&mut self, level: f32, mean_absolute_difference: f32) {
        let bin = ((level / 16.0) as usize).min(BINS - 1);
        self.looks[bin] = (self.looks[bin] + 1).min(1 << 20);
        let d = &mut self.deviation[bin];
        // Faster at first: what is assumed may be far off.
        let step = if self.looks[bin] < 200 { STEP * STEP * STEP } else { STEP };
        *d = if mean_absolute_difference > *d { *d * step } else { (*d / step).max(0.2) };
    }

    /// Fits the line anew to what has been seen.
    pub fn refit(&mut self) {
        let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (i, (deviation, looks)) in self.deviation.iter().zip(self.looks).enumerate() {
            if looks < 60 {
                continue;
            }
            let x = (16 * i + 8) as f32;
            let y = (deviation * MEAN_ABSOLUTE_TO_SIGMA).powi(2);
            // Relative errors of variances are alike: weigh by 1 / y².
            let weight = (looks.min(2000) as f32) / (y * y);
            n += weight;
            sx += weight * x;
            sy += weight * y;
            sxx += weight * x * x;
            sxy += weight * x * y;
        }
        if n <= 0.0 {
            return;
        }
        let spread = sxx - sx * sx / n;
        let slope = if spread > n * 100.0 { ((sxy - sx * sy / n) / spread).max(0.0) } else { 0.0 };
        let offset = (sy - slope * sx) / n;
        self.line = if offset > 0.0 { [offset, slope] } else { [0.0, (sxy / sxx.max(1.0)).max(0.0)] };
    }

    /// Standard deviation of a pixel's difference to the background at `level`, DN.
    pub fn sigma(&self, level: f32) -> f32 {
        (self.line[0] + self.line[1] * level).sqrt().max(LEAST_SIGMA)
    }
}

/// σ of a normal distribution over its mean absolute value: √(π / 2).
const MEAN_ABSOLUTE_TO_SIGMA: f32 = 1.253_314_1;

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn the_line_is_found_although_a_third_of_the_looks_see_something_else() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let (read2, gain) = (1.5_f32, 0.05);
        let mut noise = Noise::new();
        for look in 0..20_000 {
            let level = (look * 37 % 200) as f32 + 5.0;
            let normal = Normal::new(0.0, (read2 + gain * level).sqrt()).expect("valid");
            let mean = (0..64).map(|_| normal.sample(&mut rng).abs()).sum::<f32>() / 64.0;
            noise.look(level, if look % 3 == 0 { 40.0 } else { mean });
        }
        noise.refit();
        for level in [10.0, 60.0, 180.0] {
            let expected = (read2 + gain * level).sqrt();
            assert!((noise.sigma(level) / expected - 1.0).abs() < 0.15, "{level}: {}", noise.sigma(level));
        }
    }
}
