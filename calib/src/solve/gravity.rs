//! The scale of a rig from balls in flight: they fall with 9.81 m/s², whatever the cameras believe.

use nalgebra::{Matrix4, Vector3, Vector4};

/// Standard gravity, m/s². Between the poles and the equator, and up a mountain, it differs by a quarter of a
/// percent.
pub const STANDARD_GRAVITY: f64 = 9.806_65;

/// Points of a stretch whose parabola gives one acceleration.
const STRETCH: usize = 9;
/// Longest stretch, s, over which drag hardly turns.
const LONGEST_S: f64 = 0.15;
/// Fewest stretches.
const LEAST: usize = 8;

/// What lengths must be multiplied by to be metres, and its standard deviation: from positions of a ball in
/// free flight at instants (s, growing; gaps and contacts may occur).
///
/// In units u with 1 u = s m, a ball in air has a = g/s − (k s)|v| v, with k unknown: linear in (g/s, k s), which
/// stretches of many flights determine together. Magnus' force is left out: over forehands and backhands it
/// cancels. Stretches that fit badly, with a contact inside, are left out (iterated at 2.5 median deviations).
/// `None` for too few stretches, or when no gravity is found in them.
pub fn scale_by_gravity(track: &[(f64, Vector3<f64>)]) -> Option<(f64, f64)> {
    let stretches: Vec<(Vector3<f64>, Vector3<f64>)> = track
        .windows(STRETCH)
        .step_by(STRETCH / 3)
        .filter(|w| w[STRETCH - 1].0 - w[0].0 < LONGEST_S && w.windows(2).all(|p| p[1].0 > p[0].0))
        .filter_map(motion)
        .collect();
    let mut used: Vec<&(Vector3<f64>, Vector3<f64>)> = stretches.iter().collect();
    let mut found: Option<(Vector4<f64>, Matrix4<f64>)> = None;
    for _ in 0..10 {
        if used.len() < LEAST {
            return None;
        }
        let (mut normal, mut rhs) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
        for (velocity, acceleration) in &used {
            let drag = -velocity * velocity.norm();
            for axis in 0..3 {
                let mut row = Vector4::zeros();
                (row[axis], row[3]) = (1.0, drag[axis]);
                normal += row * row.transpose();
                rhs += row * acceleration[axis];
            }
        }
        let inverse = normal.try_inverse()?;
        let solved = inverse * rhs;
        let off = |(v, a): &(Vector3<f64>, Vector3<f64>)| (a - solved.xyz() + v * v.norm() * solved.w).norm();
        let mut all: Vec<f64> = stretches.iter().map(off).collect();
        let middle = all.len() / 2;
        let median = *all.select_nth_unstable_by(middle, f64::total_cmp).1;
        let before = used.len();
        used = stretches.iter().filter(|s| off(s) <= 2.5 * median.max(1e-12)).collect();
        let squares: f64 = used.iter().map(|s| off(s).powi(2)).sum();
        let variance = squares / (3 * used.len()).saturating_sub(4).max(1) as f64;
        // Stretches overlap three deep: their errors are not independent.
        found = Some((solved, inverse * (3.0 * variance)));
        if used.len() == before {
            break;
        }
    }
    let (solved, covariance) = found?;
    let pull = solved.xyz();
    let strength = pull.norm();
    let along = Vector4::new(pull.x, pull.y, pull.z, 0.0) / strength;
    let sigma = (along.transpose() * covariance * along)[0].max(0.0).sqrt();
    let scale = STANDARD_GRAVITY / strength;
    // Lost in its own uncertainty there is no gravity in this track.
    (strength > 5.0 * sigma && scale.is_finite()).then_some((scale, scale * sigma / strength))
}

/// Velocity and acceleration in the middle of a stretch, from its parabola.
fn motion(stretch: &[(f64, Vector3<f64>)]) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let t0 = stretch[STRETCH / 2].0;
    let span = stretch[STRETCH - 1].0 - stretch[0].0;
    let mut normal = nalgebra::Matrix3::<f64>::zeros();
    let mut rhs = nalgebra::Matrix3::<f64>::zeros();
    for (t, at) in stretch {
        let s = (t - t0) / span;
        let row = Vector3::new(1.0, s, s * s);
        normal += row * row.transpose();
        rhs += row * at.transpose();
    }
    let solved = normal.try_inverse()? * rhs;
    // What lies still moves by rounding only.
    if solved.row(1).norm() < 1e-6 * stretch[0].1.norm() {
        return None;
    }
    Some((solved.row(1).transpose() / span, solved.row(2).transpose() * (2.0 / (span * span))))
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Flights through air in small steps, seen 100 times a second in a turned frame of another unit.
    fn track(unit_m: f64, noise_m: f64, seed: u64) -> Vec<(f64, Vector3<f64>)> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let turn = Rotation3::new(Vector3::new(1.1, -0.4, 0.7));
        let mut track = Vec::new();
        for flight in 0..20 {
            let side = if flight % 2 == 0 { 1.0 } else { -1.0 };
            let mut at = Vector3::new(random.random_range(-0.5..0.5), -1.3 * side, 0.3);
            let mut v =
                Vector3::new(random.random_range(-1.0..1.0), side * random.random_range(4.0..8.0), 2.0);
            for k in 0..40 {
                let t_s = f64::from(flight) * 2.0 + f64::from(k) * 0.01;
                let mut shake = || random.random_range(-1.7..1.7) * noise_m;
                let seen = at + Vector3::new(shake(), shake(), shake());
                track.push((t_s, turn * seen / unit_m));
                for _ in 0..20 {
                    let a = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY) - v * v.norm() * 0.11;
                    v += a * 5e-4;
                    at += v * 5e-4;
                }
            }
        }
        track
    }

    #[test]
    fn flights_give_the_scale_within_its_own_uncertainty() {
        for (unit_m, noise_m, seed) in [(1.0, 0.0, 1), (1.64, 3e-4, 2), (0.3, 1e-3, 3)] {
            let (scale, sigma) = scale_by_gravity(&track(unit_m, noise_m, seed)).expect("flights");
            let off = (scale / unit_m - 1.0).abs();
            println!(
                "unit {unit_m} m, noise {noise_m} m: off by {:.2} %, σ {:.2} %",
                100.0 * off,
                100.0 * sigma / scale
            );
            assert!(off < 3e-3 + 4.0 * sigma / scale, "{unit_m}: {scale} ± {sigma}");
            assert!(off < 0.02, "{unit_m}: {scale}");
        }
    }

    #[test]
    fn a_ball_at_rest_has_no_scale() {
        let still: Vec<_> = (0..200).map(|k| (f64::from(k) * 0.01, Vector3::new(0.1, 0.2, 0.3))).collect();
        assert_eq!(scale_by_gravity(&still), None);
        assert_eq!(scale_by_gravity(&[]), None);
    }
}
