use rand::SeedableRng as _;
use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64;

/// Noise of a linear sensor after EMVA 1288 (release 4, section 2): variance grows linearly with the
/// signal (shot noise), on top of a constant part (read noise); quantisation adds its own by rounding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorNoise {
    /// System gain K: grey values (DN) per electron. Shot noise has the variance K × signal, in DN².
    pub dn_per_electron: f64,
    /// Read noise, DN; at least [`MIN_READ_DN`].
    pub read_dn: f64,
}

/// Below a third of a grey value quantisation hides the read noise.
pub const MIN_READ_DN: f64 = 0.3;

impl SensorNoise {
    /// Standard deviation before quantisation at the mean `level_dn`.
    pub fn sigma_dn(&self, level_dn: f64) -> f64 {
        let read = self.read_dn.max(MIN_READ_DN);
        (self.dn_per_electron * level_dn.max(0.0) + read * read).sqrt()
    }
}

/// Levels are fixed-point with this many fractions of a grey value.
const LEVEL: f64 = 16.0;

/// Samples of the standard normal distribution that rows are cut from at random places.
const TABLE: usize = 1 << 16;
/// Longest row.
const MAX_ROW: usize = 1 << 13;
/// One standard deviation in the table; four of them just fit an i16.
const TABLE_SIGMA: f64 = 8191.0;
/// A deviation in 1/128 DN times a sample in 1/8191, shifted right by 16, is in 1/16 DN.
const SIGMA: f64 = LEVEL * 65536.0 / TABLE_SIGMA;

/// Levels, in DN, at which the noise curve is touched by its tangents.
const TOUCHED: [f64; 4] = [1.0, 10.0, 45.0, 140.0];

/// Turns mean levels into grey values with noise: the last step of rendering, for whole rows.
///
/// The deviation is a square root of the level, which is concave, so the least of four of its tangents
/// stands for it: multiplications only, which the compiler makes vector instructions of. It is too large
/// by at most a few percent.
#[derive(Debug, Clone)]
pub struct Developer {
    tangents: [Tangent; TOUCHED.len()],
    table: Box<[i16]>,
    seed: u64,
}

/// deviation ≤ offset + slope × level, in the fixed-point units above.
#[derive(Debug, Clone, Copy)]
struct Tangent {
    offset: u16,
    slope: u16,
}

impl Developer {
    /// For a sensor; `seed` settles all noise.
    pub fn new(noise: &SensorNoise, seed: u64) -> Self {
        let tangents = TOUCHED.map(|level| {
            let sigma = noise.sigma_dn(level);
            let slope = 0.5 * noise.dn_per_electron / sigma;
            let fixed = |v: f64| v.round().clamp(0.0, 65535.0) as u16;
            Tangent {
                offset: fixed((sigma - slope * level) * SIGMA),
                slope: fixed(slope * SIGMA / LEVEL * 65536.0),
            }
        });
        let mut random = Pcg64::seed_from_u64(seed ^ 0x6e_6f69_7365);
        let table = (0..TABLE + MAX_ROW)
            .map(|_| {
                let sample: f64 = StandardNormal.sample(&mut random);
                (sample * TABLE_SIGMA).round().clamp(-32767.0, 32767.0) as i16
            })
            .collect();
        Self { tangents, table, seed }
    }

    /// The noise of row `y` in frame `frame`: one sample a column.
    pub fn row_noise(&self, frame: u64, y: usize, width: usize) -> &[i16] {
        let place = hash(self.seed ^ hash(frame ^ hash(y as u64))) as usize % TABLE;
        &self.table[place..place + width.min(MAX_ROW)]
    }

    /// A row of mean levels in DN, dimmed by `gain` / 256, with noise.
    pub fn row(&self, means: &[u8], gain: u16, noise: &[i16], out: &mut [u8]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2, as was just asked.
            let done = unsafe { avx2::row(&self.tangents, means, gain, noise, out) };
            row(&self.tangents, &means[done..], gain, &noise[done..], &mut out[done..]);
            return;
        }
        row(&self.tangents, means, gain, noise, out);
    }

    /// As [`Self::row`], for means that are not whole grey values.
    pub fn fine_row(&self, means: &[f32], noise: &[i16], out: &mut [u8]) {
        let rows = means.chunks(CHUNK).zip(noise.chunks(CHUNK)).zip(out.chunks_mut(CHUNK));
        for ((means, noise), out) in rows {
            let mut levels = [0_u16; CHUNK];
            for (level, mean) in levels.iter_mut().zip(means) {
                *level = (mean * LEVEL as f32 + 0.5).clamp(0.0, 4095.0) as i32 as u16;
            }
            #[cfg(target_arch = "x86_64")]
            if let (Ok(noise), Ok(out)) = (noise.try_into(), <&mut [u8; CHUNK]>::try_from(&mut *out))
                && std::arch::is_x86_feature_detected!("avx2")
            {
                // SAFETY: the processor has AVX2, as was just asked.
                unsafe { avx2::levels(&self.tangents, &levels, noise, out) };
                continue;
            }
            for ((level, noise), out) in levels.iter().zip(noise).zip(out) {
                *out = develop(&self.tangents, *level, *noise);
            }
        }
    }
}

/// Pixels that are developed at a time.
const CHUNK: usize = 16;

/// SplitMix64's finaliser (Steele, Lea and Flood 2014): neighbouring inputs give unrelated outputs.
pub fn hash(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[inline]
fn develop(tangents: &[Tangent; TOUCHED.len()], level: u16, noise: i16) -> u8 {
    let mut sigma = u16::MAX;
    for tangent in tangents {
        let rise = ((u32::from(tangent.slope) * u32::from(level)) >> 16) as u16;
        sigma = sigma.min(tangent.offset.wrapping_add(rise));
    }
    // Both factors fit an i16: the largest deviation of interest, 255 DN, is 32640.
    let sigma = sigma.min(i16::MAX as u16) as i16;
    let off = ((i32::from(sigma) * i32::from(noise)) >> 16) as i16;
    let value = (level as i16).wrapping_add(off).wrapping_add(8) >> 4;
    value.clamp(0, 255) as u8
}

fn row(tangents: &[Tangent; TOUCHED.len()], means: &[u8], gain: u16, noise: &[i16], out: &mut [u8]) {
    for ((mean, noise), out) in means.iter().zip(noise).zip(out) {
        let level = u16::from(*mean).wrapping_mul(gain) >> 4;
        *out = develop(tangents, level, *noise);
    }
}

/// The same with AVX2, sixteen pixels at a time: left to itself the compiler widens the products with the
/// slopes to 32 bits, which takes three times as long.
#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::{
        __m128i, __m256i, _mm_loadu_si128, _mm_storeu_si128, _mm256_add_epi16, _mm256_castsi256_si128,
        _mm256_cvtepu8_epi16, _mm256_loadu_si256, _mm256_min_epu16, _mm256_mulhi_epi16, _mm256_mulhi_epu16,
        _mm256_mullo_epi16, _mm256_packus_epi16, _mm256_permute4x64_epi64, _mm256_set1_epi16,
        _mm256_srai_epi16, _mm256_srli_epi16,
    };

    use super::{CHUNK, TOUCHED, Tangent};

    type Lines = [(__m256i, __m256i); TOUCHED.len()];

    #[target_feature(enable = "avx2")]
    fn all(v: u16) -> __m256i {
        _mm256_set1_epi16(v.cast_signed())
    }

    #[target_feature(enable = "avx2")]
    fn lines(tangents: &[Tangent; TOUCHED.len()]) -> Lines {
        let mut lines = [(all(0), all(0)); TOUCHED.len()];
        for (line, t) in lines.iter_mut().zip(tangents) {
            *line = (all(t.offset), all(t.slope));
        }
        lines
    }

    /// [`super::develop`] for sixteen pixels.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn develop(lines: &Lines, level: __m256i, noise: __m256i) -> __m128i {
        let mut sigma = _mm256_set1_epi16(i16::MAX);
        for (offset, slope) in lines {
            let tangent = _mm256_add_epi16(*offset, _mm256_mulhi_epu16(*slope, level));
            sigma = _mm256_min_epu16(sigma, tangent);
        }
        let noisy = _mm256_add_epi16(level, _mm256_mulhi_epi16(sigma, noise));
        let value = _mm256_srai_epi16::<4>(_mm256_add_epi16(noisy, all(8)));
        // Packing works on each half by itself: the two quarters that count are brought together.
        _mm256_castsi256_si128(_mm256_permute4x64_epi64::<0b1000>(_mm256_packus_epi16(value, value)))
    }

    /// Whole chunks of a row; returns how many pixels they were.
    #[target_feature(enable = "avx2")]
    pub fn row(
        tangents: &[Tangent; TOUCHED.len()],
        means: &[u8],
        gain: u16,
        noise: &[i16],
        out: &mut [u8],
    ) -> usize {
        let (gains, lines) = (all(gain), lines(tangents));
        let chunks = means.as_chunks::<CHUNK>().0.iter().zip(noise.as_chunks::<CHUNK>().0);
        let mut done = 0;
        for ((mean, noise), out) in chunks.zip(out.as_chunks_mut::<CHUNK>().0) {
            // SAFETY: both are arrays of sixteen, and the loads ask for no alignment.
            let (mean, noise) =
                unsafe { (_mm_loadu_si128(mean.as_ptr().cast()), _mm256_loadu_si256(noise.as_ptr().cast())) };
            let level = _mm256_srli_epi16::<4>(_mm256_mullo_epi16(_mm256_cvtepu8_epi16(mean), gains));
            // SAFETY: an array of sixteen bytes; the store asks for no alignment.
            unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), develop(&lines, level, noise)) };
            done += CHUNK;
        }
        done
    }

    /// One chunk of levels.
    #[target_feature(enable = "avx2")]
    pub fn levels(
        tangents: &[Tangent; TOUCHED.len()],
        levels: &[u16; CHUNK],
        noise: &[i16; CHUNK],
        out: &mut [u8; CHUNK],
    ) {
        // SAFETY: both are arrays of sixteen, and the loads ask for no alignment.
        let (level, noise) = unsafe {
            (_mm256_loadu_si256(levels.as_ptr().cast()), _mm256_loadu_si256(noise.as_ptr().cast()))
        };
        // SAFETY: an array of sixteen bytes; the store asks for no alignment.
        unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), develop(&lines(tangents), level, noise)) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn statistics(values: &[u8]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
        let variance = values.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (mean, variance)
    }

    #[test]
    fn mean_and_variance_follow_the_standard_at_every_level() {
        for noise in [
            SensorNoise { dn_per_electron: 0.02, read_dn: 0.3 },
            SensorNoise { dn_per_electron: 0.1, read_dn: 0.9 },
        ] {
            let developer = Developer::new(&noise, 3);
            for (mean, gain) in [(6_u8, 256_u16), (20, 256), (60, 256), (100, 128), (200, 230), (220, 256)] {
                let level = f64::from(mean) * f64::from(gain) / 256.0;
                let mut values = Vec::new();
                for y in 0..200 {
                    let mut out = [0; 1000];
                    developer.row(&[mean; 1000], gain, developer.row_noise(7, y, 1000), &mut out);
                    values.extend(out);
                }
                let (got_mean, got_variance) = statistics(&values);
                // Rounding adds a twelfth.
                let variance = noise.sigma_dn(level).powi(2) + 1.0 / 12.0;
                assert!((got_mean - level).abs() < 0.08, "mean {got_mean} at {level}");
                let ratio = (got_variance / variance).sqrt();
                assert!((0.95..1.12).contains(&ratio), "deviation × {ratio} at {level} DN");
            }
        }
    }

    #[test]
    fn fine_and_whole_means_agree_and_all_ways_to_compute_do() {
        let developer = Developer::new(&SensorNoise { dn_per_electron: 0.05, read_dn: 0.5 }, 1);
        let means: Vec<u8> = (0..777).map(|i| (i % 256) as u8).collect();
        let noise = developer.row_noise(5, 9, means.len());
        let (mut whole, mut fine, mut plain) = (vec![0; 777], vec![0; 777], vec![0; 777]);
        developer.row(&means, 256, noise, &mut whole);
        let floats: Vec<f32> = means.iter().map(|m| f32::from(*m)).collect();
        developer.fine_row(&floats, noise, &mut fine);
        row(&developer.tangents, &means, 256, noise, &mut plain);
        assert_eq!(whole, plain);
        assert_eq!(whole, fine);
    }

    #[test]
    fn frames_and_rows_have_noise_of_their_own() {
        let developer = Developer::new(&SensorNoise { dn_per_electron: 0.05, read_dn: 0.5 }, 1);
        let (a, b) = (developer.row_noise(1, 4, 1000), developer.row_noise(2, 4, 1000));
        let dot: f64 = a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum();
        let correlation = dot / (1000.0 * TABLE_SIGMA * TABLE_SIGMA);
        assert!(correlation.abs() < 0.15, "{correlation}");
    }
}
