//! What is believed of a flight's spin, ball and table before anything bends its path.

use nalgebra::{Matrix3, Vector3};

/// One kind of stroke: a normal distribution of the spin in the frame of the heading (forward along the
/// horizontal velocity, left, up), rad/s. Topspin is spin about "left".
#[derive(Debug, Clone, Copy, PartialEq)]
struct Strokes {
    /// Share of strokes of this kind.
    share: f64,
    /// Mean topspin: constant, per m/s of horizontal speed, per m/s of vertical velocity.
    topspin: [f64; 3],
    /// Standard deviations about forward, left and up.
    sigma: [f64; 3],
    /// Correlation of the spins about forward and up: a ball brushed sideways is brushed below or above
    /// its middle too. The path shows the one, the bounce the other.
    forward_up: f64,
}

/// The first is fitted by least squares to the 13,088 rally states of `deepmind-ball-states` (D'Ambrosio et
/// al. 2024, CC BY 4.0; commit 54cf18e): topspin = −54 + 16.4 v_h + 1.8 v_z with a scatter of 32, sidespin
/// and corkscrew 26 rad/s with a correlation of −0.42. Serves (2,704 states) have a smaller scatter and are
/// covered by it. These are amateurs against a robot; others push with backspin, professional play reaches
/// 800 rad/s with a median of 265, of either sign, and ball guns spin as they are set (about forward 1.2 times
/// as much as about up, with a correlation of −0.92, in 150 measured ones): hence the other, wide kinds, with
/// shares that let a bend of the path decide. The first two are narrower than what was measured, by as much as lowers
/// the prediction error of recorded flights: the tails of the measured scatter are the other kinds' part here.
const STROKES: [Strokes; 4] = [
    Strokes { share: 0.3, topspin: [-54.0, 16.4, 1.8], sigma: [17.5, 20.0, 17.5], forward_up: -0.42 },
    Strokes { share: 0.14, topspin: [-74.0, 0.0, 0.0], sigma: [27.0, 34.0, 27.0], forward_up: -0.42 },
    Strokes { share: 0.3, topspin: [160.0, 0.0, 0.0], sigma: [108.0, 101.0, 103.0], forward_up: -0.92 },
    Strokes { share: 0.26, topspin: [-160.0, 0.0, 0.0], sigma: [108.0, 101.0, 103.0], forward_up: -0.92 },
];

/// How many kinds of stroke the prior distinguishes.
pub const STROKE_KINDS: usize = STROKES.len();

/// Fastest topspin that the mean of a kind expects, rad/s: the line is fitted to 3–9 m/s.
const LIKELY_TOPSPIN: f64 = 160.0;

/// Share, mean and covariance of the spin of each kind of stroke, for a ball that has just been struck
/// and flies with `velocity` (m/s); table frame, rad/s.
pub fn spin(velocity: &Vector3<f64>) -> [(f64, Vector3<f64>, Matrix3<f64>); STROKE_KINDS] {
    let horizontal = velocity.xy().norm();
    let forward =
        if horizontal > 0.1 { Vector3::new(velocity.x, velocity.y, 0.0) / horizontal } else { Vector3::x() };
    let left = Vector3::z().cross(&forward);
    let table_from_heading = Matrix3::from_columns(&[forward, left, Vector3::z()]);
    STROKES.map(|kind| {
        let [constant, by_horizontal, by_vertical] = kind.topspin;
        let top = (constant + by_horizontal * horizontal + by_vertical * velocity.z)
            .clamp(-LIKELY_TOPSPIN, LIKELY_TOPSPIN);
        let [forward_sigma, left_sigma, up_sigma] = kind.sigma;
        let shared = kind.forward_up * forward_sigma * up_sigma;
        let in_heading = Matrix3::new(
            forward_sigma.powi(2),
            0.0,
            shared,
            0.0,
            left_sigma.powi(2),
            0.0,
            shared,
            0.0,
            up_sigma.powi(2),
        );
        (kind.share, left * top, table_from_heading * in_heading * table_from_heading.transpose())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_is_expected_to_have_topspin_whatever_its_heading() {
        for heading in
            [Vector3::new(0.0, 7.0, 1.0), Vector3::new(3.0, -6.0, 1.0), Vector3::new(0.0, 0.0, -1.0)]
        {
            let kinds = spin(&heading);
            let (shares, expected) = kinds
                .iter()
                .fold((0.0, Vector3::zeros()), |(sum, mean), (share, m, _)| (sum + share, mean + m * *share));
            assert!((shares - 1.0_f64).abs() < 1e-12, "{shares}");
            // Magnus pulls a ball with topspin down.
            for mean in [kinds[0].1, expected] {
                assert!(mean.cross(&heading).z <= 0.0, "{mean}");
            }
            for (share, _, covariance) in kinds {
                assert!((0.0..1.0).contains(&share));
                assert!(covariance.cholesky().is_some());
            }
        }
    }
}
