//! The normal distribution: what a blurred edge looks like.

/// Φ(z) and φ(z): Abramowitz and Stegun 26.2.17, to 7.5e-8.
pub(crate) fn normal_distribution(z: f64) -> (f64, f64) {
    let density = 0.398_942_280_401_432_7 * (-0.5 * z * z).exp();
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let poly = t
        * (0.319_381_530
            + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let upper = density * poly;
    (if z >= 0.0 { 1.0 - upper } else { upper }, density)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distribution_is_what_tables_say() {
        for (z, cumulative) in [(0.0, 0.5), (1.0, 0.841_344_746), (-1.0, 0.158_655_254), (2.5, 0.993_790_335)]
        {
            assert!((normal_distribution(z).0 - cumulative).abs() < 1e-7, "{z}");
        }
    }
}
