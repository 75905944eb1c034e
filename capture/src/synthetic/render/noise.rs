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

/// Samples of the standard normal distribution that rows are cut from at random places.
const TABLE: usize = 1 << 16;
/// Longest row.
const MAX_ROW: usize = 1 << 13;

/// Levels are fixed-point with this many fractions of a grey value: the brightest still fits an i16.
const LEVEL: f32 = 128.0;

/// 255 DN.
const BRIGHTEST: u16 = 255 * 128;

/// The largest deviation of the sensor is this much in a byte of [`Sigmas`].
const LARGEST: f64 = 127.0;

/// Turns mean levels into grey values with noise: the last step of rendering, for whole rows.
#[derive(Debug, Clone)]
pub struct Developer {
    noise: SensorNoise,
    /// Samples, scaled so that a byte of [`Sigmas`] times a sample, shifted right by 8, is in 1/128 DN.
    table: Box<[i16]>,
    full: Brightness,
    seed: u64,
}

/// How bright an exposure is, and the noise that follows.
#[derive(Debug, Clone, Copy)]
pub struct Brightness {
    /// Share of full light in 1/32768: finer than any grey value.
    gain: u16,
    sigmas: Sigmas,
}

/// Standard deviation by mean level in full light: one for every 4 DN below 64, one for every 16 above, where
/// the square root has become flat. It is off by 6 % at most, and a lookup for thirty-two pixels at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Sigmas {
    low: [u8; 16],
    high: [u8; 16],
}

impl Brightness {
    /// Share of full light.
    pub fn gain(&self) -> f32 {
        f32::from(self.gain) / 32768.0
    }
}

impl Sigmas {
    /// Of `noise`, in units of the sensor's own.
    fn new(own: &SensorNoise, noise: &SensorNoise, gain: f64) -> Self {
        let unit = LARGEST / own.sigma_dn(255.0);
        let at = |mean: f64| (noise.sigma_dn(mean * gain) * unit).round().clamp(0.0, LARGEST) as u8;
        Self {
            low: std::array::from_fn(|i| at(4.0 * i as f64 + 1.5)),
            high: std::array::from_fn(|i| if i < 4 { 0 } else { at(16.0 * i as f64 + 7.5) }),
        }
    }

    fn of(&self, mean: u8) -> u8 {
        if mean < 64 { self.low[usize::from(mean >> 2)] } else { self.high[usize::from(mean >> 4)] }
    }
}

impl Developer {
    /// For a sensor; `seed` settles all noise.
    pub fn new(noise: &SensorNoise, seed: u64) -> Self {
        let scale = f64::from(LEVEL) * 256.0 * noise.sigma_dn(255.0) / LARGEST;
        let mut random = Pcg64::seed_from_u64(seed ^ 0x6e_6f69_7365);
        let table = (0..TABLE + MAX_ROW)
            .map(|_| {
                let sample: f64 = StandardNormal.sample(&mut random);
                (sample * scale).round().clamp(-32767.0, 32767.0) as i16
            })
            .collect();
        let full = Brightness { gain: 32768, sigmas: Sigmas::new(noise, noise, 1.0) };
        Self { noise: *noise, table, full, seed }
    }

    /// Full light.
    pub const fn full(&self) -> Brightness {
        self.full
    }

    /// Light that is a share of full light, up to twice of it, `amplification` (1 where there is none) counted in:
    /// the amplifier raises noise as it does the signal.
    pub fn at(&self, gain: f64, amplification: f64) -> Brightness {
        let gain = (gain * 32768.0).round().clamp(0.0, 65535.0);
        let noise = SensorNoise {
            dn_per_electron: self.noise.dn_per_electron * amplification,
            read_dn: self.noise.read_dn * amplification,
        };
        Brightness { gain: gain as u16, sigmas: Sigmas::new(&self.noise, &noise, gain / 32768.0) }
    }

    /// The noise of row `y` in frame `frame`: one sample a column.
    pub fn row_noise(&self, frame: u64, y: usize, width: usize) -> &[i16] {
        let place = hash(self.seed ^ hash(frame ^ hash(y as u64))) as usize % TABLE;
        &self.table[place..place + width.min(MAX_ROW)]
    }

    /// A row of mean levels in full light, in DN, dimmed, with noise.
    pub fn row(&self, light: &Brightness, means: &[u8], noise: &[i16], out: &mut [u8]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2, as was just asked.
            let done = unsafe { avx2::row(light, means, noise, out) };
            row(light, &means[done..], &noise[done..], &mut out[done..]);
            return;
        }
        row(light, means, noise, out);
    }

    /// As [`Self::row`], for means that are no whole grey values, and have been dimmed already.
    pub fn fine_row(&self, means: &[f32], noise: &[i16], out: &mut [u8]) {
        for ((mean, noise), out) in means.iter().zip(noise).zip(out) {
            let level = (mean * LEVEL + 0.5).clamp(0.0, 255.0 * LEVEL) as i16;
            *out = develop(level, self.full.sigmas.of((level >> 7) as u8), *noise);
        }
    }
}

/// SplitMix64's finaliser (Steele, Lea and Flood 2014): neighbouring inputs give unrelated outputs.
pub fn hash(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

fn develop(level: i16, sigma: u8, noise: i16) -> u8 {
    let off = ((i32::from(sigma) * i32::from(noise)) >> 8) as i16;
    ((level + 64).saturating_add(off) >> 7).clamp(0, 255) as u8
}

fn row(light: &Brightness, means: &[u8], noise: &[i16], out: &mut [u8]) {
    for ((mean, noise), out) in means.iter().zip(noise).zip(out) {
        let level = ((u32::from(*mean) << 8) * u32::from(light.gain)) >> 16;
        *out = develop(level.min(BRIGHTEST.into()) as i16, light.sigmas.of(*mean), *noise);
    }
}

/// The same with AVX2, thirty-two pixels at a time.
#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::asm;
    use std::arch::x86_64::{
        __m256i, _mm_loadu_si128, _mm256_add_epi16, _mm256_adds_epi16, _mm256_adds_epu8, _mm256_and_si256,
        _mm256_broadcastsi128_si256, _mm256_loadu_si256, _mm256_min_epu16, _mm256_mulhi_epi16,
        _mm256_or_si256, _mm256_packus_epi16, _mm256_permute4x64_epi64, _mm256_set1_epi8, _mm256_set1_epi16,
        _mm256_setzero_si256, _mm256_shuffle_epi8, _mm256_srai_epi16, _mm256_srli_epi16, _mm256_storeu_si256,
        _mm256_unpackhi_epi8, _mm256_unpacklo_epi8,
    };

    use super::{BRIGHTEST, Brightness};

    /// Pixels that are developed at a time.
    const CHUNK: usize = 32;
    /// Swaps the two middle quarters: unpacking and packing work on each half by itself.
    const SWAP: i32 = 0b11_01_10_00;

    #[target_feature(enable = "avx2")]
    fn table(entries: &[u8; 16]) -> __m256i {
        // SAFETY: an array of sixteen, and the load asks for no alignment.
        _mm256_broadcastsi128_si256(unsafe { _mm_loadu_si128(entries.as_ptr().cast()) })
    }

    /// The upper halves of 16-bit products. Not `_mm256_mulhi_epu16`: where a factor stays the same throughout a loop,
    /// the compiler takes that apart, and makes seven instructions of the one.
    #[target_feature(enable = "avx2")]
    fn mulhi_epu16(a: __m256i, b: __m256i) -> __m256i {
        let product;
        // SAFETY: an AVX2 instruction on registers, where AVX2 is enabled.
        unsafe {
            asm!(
                "vpmulhuw {product}, {a}, {b}",
                product = lateout(ymm_reg) product, a = in(ymm_reg) a, b = in(ymm_reg) b,
                options(pure, nomem, nostack, preserves_flags),
            );
        }
        product
    }

    /// Whole chunks of a row; returns how many pixels they were.
    #[target_feature(enable = "avx2")]
    pub fn row(light: &Brightness, means: &[u8], noise: &[i16], out: &mut [u8]) -> usize {
        let (low, high) = (table(&light.sigmas.low), table(&light.sigmas.high));
        let gain = _mm256_set1_epi16(light.gain.cast_signed());
        let brightest = _mm256_set1_epi16(BRIGHTEST.cast_signed());
        let zero = _mm256_setzero_si256();
        // Of one half of the pixels: means and deviations as the high bytes of 16 bits.
        let developed = |means: __m256i, sigmas: __m256i, noise: &[i16]| {
            let level = _mm256_min_epu16(mulhi_epu16(means, gain), brightest);
            let level = _mm256_add_epi16(level, _mm256_set1_epi16(64));
            // SAFETY: the slice is of sixteen, and the load asks for no alignment.
            let noise = unsafe { _mm256_loadu_si256(noise.as_ptr().cast()) };
            _mm256_srai_epi16::<7>(_mm256_adds_epi16(level, _mm256_mulhi_epi16(sigmas, noise)))
        };
        let chunks = means.as_chunks::<CHUNK>().0.iter().zip(noise.as_chunks::<CHUNK>().0);
        let mut done = 0;
        for ((means, noise), out) in chunks.zip(out.as_chunks_mut::<CHUNK>().0) {
            // SAFETY: an array of thirty-two bytes, and the load asks for no alignment.
            let means = unsafe { _mm256_loadu_si256(means.as_ptr().cast()) };
            let means = _mm256_permute4x64_epi64::<SWAP>(means);
            // A lookup gives zero where its index has the highest bit: an index of 16 or more gets it by adding.
            let fours = _mm256_and_si256(_mm256_srli_epi16::<2>(means), _mm256_set1_epi8(0x3f));
            let fours = _mm256_adds_epu8(fours, _mm256_set1_epi8(0x70));
            let sixteens = _mm256_and_si256(_mm256_srli_epi16::<4>(means), _mm256_set1_epi8(0x0f));
            let sigmas =
                _mm256_or_si256(_mm256_shuffle_epi8(low, fours), _mm256_shuffle_epi8(high, sixteens));
            let first = developed(
                _mm256_unpacklo_epi8(zero, means),
                _mm256_unpacklo_epi8(zero, sigmas),
                &noise[..16],
            );
            let second = developed(
                _mm256_unpackhi_epi8(zero, means),
                _mm256_unpackhi_epi8(zero, sigmas),
                &noise[16..],
            );
            let values = _mm256_permute4x64_epi64::<SWAP>(_mm256_packus_epi16(first, second));
            // SAFETY: an array of thirty-two bytes; the store asks for no alignment.
            unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), values) };
            done += CHUNK;
        }
        done
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
            for (mean, gain) in [(6_u8, 1.0), (20, 1.0), (60, 1.0), (100, 0.5), (200, 0.9), (220, 1.0)] {
                let level = f64::from(mean) * gain;
                let light = developer.at(gain, 1.0);
                let mut values = Vec::new();
                for y in 0..200 {
                    let mut out = [0; 1000];
                    developer.row(&light, &[mean; 1000], developer.row_noise(7, y, 1000), &mut out);
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
        let light = developer.full();
        developer.row(&light, &means, noise, &mut whole);
        let floats: Vec<f32> = means.iter().map(|m| f32::from(*m)).collect();
        developer.fine_row(&floats, noise, &mut fine);
        row(&light, &means, noise, &mut plain);
        assert_eq!(whole, plain);
        assert_eq!(whole, fine);
        for light in [developer.at(0.83, 1.0), developer.at(1.7, 1.3)] {
            developer.row(&light, &means, noise, &mut whole);
            row(&light, &means, noise, &mut plain);
            assert_eq!(whole, plain);
        }
    }

    #[test]
    fn frames_and_rows_have_noise_of_their_own() {
        let developer = Developer::new(&SensorNoise { dn_per_electron: 0.05, read_dn: 0.5 }, 1);
        let (a, b) = (developer.row_noise(1, 4, 1000), developer.row_noise(2, 4, 1000));
        let dot: f64 = a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum();
        let length = |v: &[i16]| v.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
        let correlation = dot / (length(a) * length(b));
        assert!(correlation.abs() < 0.15, "{correlation}");
    }
}
