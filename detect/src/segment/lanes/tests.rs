use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;

/// All operations, on one pair of vectors.
#[inline(always)]
fn all_of<L: Lanes>(level: L::Level, a: &[f32], b: &[f32]) -> Vec<u32> {
    let (a, b) = (L::load(level, a, 0), L::load(level, b, 0));
    let results = [
        a + b,
        a - b,
        a * b,
        a.times_plus(b, a),
        a.max(b),
        a.min(b),
        a.recip(),
        a.positive(),
        a.positive().sqrt(),
        a.where_positive(b),
        a.unless_positive(b),
        L::all(level, b.sum()),
    ];
    // Which of the many NaNs it is, no rule says.
    let bits = |number: f32| if number.is_nan() { f32::NAN.to_bits() } else { number.to_bits() };
    results.iter().flat_map(|r| r.to_array()).map(bits).collect()
}

fn gives_the_bits_of_plain_rust<L: Lanes>(level: L::Level) {
    let mut rng = Pcg64Mcg::seed_from_u64(4);
    for _ in 0..2000 {
        let [a, b] = [(); 2].map(|()| {
            (0..LANES)
                .map(|_| match rng.random_range(0..8) {
                    0 => 0.0,
                    1 => -0.0,
                    2 => 1.0,
                    3 => -0.5,
                    // Everything there is: subnormal numbers, infinities, NaN.
                    4 => f32::from_bits(rng.random()),
                    _ => rng.random_range(-300.0..300.0),
                })
                .collect::<Vec<_>>()
        });
        assert_eq!(all_of::<L>(level, &a, &b), all_of::<PlainLanes>(Plain, &a, &b), "{a:?} {b:?}");
    }
}

#[test]
#[cfg(target_arch = "x86_64")]
fn every_instruction_gives_the_bits_of_plain_rust() {
    match Avx2::detect() {
        Some(level) => gives_the_bits_of_plain_rust::<Avx2Lanes>(level),
        None => println!("SKIPPED: this machine has no AVX2"),
    }
}

#[test]
#[cfg(target_arch = "aarch64")]
fn every_instruction_gives_the_bits_of_plain_rust() {
    match Neon::detect() {
        Some(level) => gives_the_bits_of_plain_rust::<NeonLanes>(level),
        None => println!("SKIPPED: this machine has no NEON"),
    }
}
