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
    results.iter().flat_map(|r| r.to_array()).map(f32::to_bits).collect()
}

#[test]
fn every_instruction_gives_the_bits_of_plain_rust() {
    #[cfg(target_arch = "x86_64")]
    {
        let Some(level) = Avx2::detect() else {
            println!("SKIPPED: this machine has no AVX2");
            return;
        };
        let mut rng = Pcg64Mcg::seed_from_u64(4);
        for _ in 0..200 {
            let [a, b] = [(); 2].map(|()| {
                (0..LANES)
                    .map(|_| [0.0, 1.0, -0.5, rng.random_range(-300.0..300.0_f32)][rng.random_range(0..4)])
                    .collect::<Vec<_>>()
            });
            assert_eq!(
                all_of::<Avx2Lanes>(level, &a, &b),
                all_of::<PlainLanes>(Plain, &a, &b),
                "{a:?} {b:?}"
            );
        }
    }
}
