use nalgebra::{SMatrix, SVector, Vector2};

use super::luma::Luma;

/// A saddle of the picture's brightness: a corner of a chessboard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Saddle {
    /// Where.
    pub at: Vector2<f64>,
    /// √(−det Hessian), in grey levels per px²: how pronounced it is.
    pub strength: f64,
    /// Direction, in radians, along which lie the bright squares.
    pub bright: f64,
}

/// Fits z = a + b x + c y + d x² + e x y + f y² to a disc of the picture, weighted by a Gaussian, and
/// moves to its stationary point until that no longer changes (Lucchese and Mitra 2002). The weights are
/// the same at every place, so the fit is six sums.
#[derive(Debug, Clone)]
pub struct SaddleFit {
    radius: f64,
    taps: Vec<(f64, f64, SVector<f64, 6>)>,
}

/// Steps below this, in px, end the iteration.
const STILL_PX: f64 = 2e-3;

impl SaddleFit {
    /// A fit over a disc of `radius` px.
    pub fn new(radius: f64) -> Self {
        let reach = radius.ceil() as i32;
        let sigma2 = (radius * 0.6) * (radius * 0.6);
        let mut normal = SMatrix::<f64, 6, 6>::zeros();
        let mut rows = Vec::new();
        for (dx, dy) in (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (x, y))) {
            let (x, y) = (f64::from(dx), f64::from(dy));
            let r2 = x * x + y * y;
            if r2 <= radius * radius {
                let row = SVector::<f64, 6>::new(1.0, x, y, x * x, x * y, y * y);
                let weight = (-0.5 * r2 / sigma2).exp();
                normal += row * row.transpose() * weight;
                rows.push((x, y, row * weight));
            }
        }
        // Singular only for discs of fewer than six pixels; such a fit then finds nothing.
        let inverse = normal.try_inverse().unwrap_or_else(SMatrix::zeros);
        Self { radius, taps: rows.into_iter().map(|(x, y, row)| (x, y, inverse * row)).collect() }
    }

    /// The saddle near `start`; `None` when there is none, or it lies further than `reach` px away.
    pub fn refine(&self, image: &Luma, start: Vector2<f64>, reach: f64) -> Option<Saddle> {
        let mut at = start;
        for _ in 0..15 {
            let mut q = SVector::<f64, 6>::zeros();
            for (x, y, tap) in &self.taps {
                q += tap * image.sample(at.x + x, at.y + y)?;
            }
            let determinant = 4.0 * q[3] * q[5] - q[4] * q[4];
            if determinant >= 0.0 {
                return None;
            }
            let step =
                Vector2::new(q[4] * q[2] - 2.0 * q[5] * q[1], q[4] * q[1] - 2.0 * q[3] * q[2]) / determinant;
            let longest = 0.5 * self.radius;
            at += if step.norm() > longest { step * (longest / step.norm()) } else { step };
            if (at - start).norm() > reach {
                return None;
            }
            if step.norm() < STILL_PX {
                let bright = 0.5 * q[4].atan2(q[3] - q[5]);
                return Some(Saddle { at, strength: (-determinant).sqrt(), bright });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smooth_saddle_is_found_to_a_hundredth_of_a_pixel() {
        let truth = Vector2::new(20.37, 19.71);
        let data = (0..40 * 40)
            .map(|i| {
                let p = Vector2::new(f64::from(i % 40), f64::from(i / 40)) - truth;
                let (c, s) = (0.3f64.cos(), 0.3f64.sin());
                let (u, v) = (c * p.x + s * p.y, c * p.y - s * p.x);
                (128.0 + 100.0 * (u / 2.0).tanh() * (v / 2.0).tanh()).round() as u8
            })
            .collect();
        let image = Luma::new(40, 40, data).expect("fits");
        let found = SaddleFit::new(4.0).refine(&image, Vector2::new(21.0, 19.0), 4.0).expect("there");
        assert!((found.at - truth).norm() < 0.01, "{}", found.at);
        // The bright squares are where u and v have one sign: at 45° to the edges.
        let off = (found.bright - (0.3 + std::f64::consts::FRAC_PI_4)).rem_euclid(std::f64::consts::PI);
        assert!(!(0.02..=std::f64::consts::PI - 0.02).contains(&off), "{}", found.bright);
    }
}
