use nalgebra::{DMatrix, Matrix3, Vector2, Vector3};

/// A similarity that moves points to mean zero and mean distance √2 (Hartley 1997): without it the
/// squared condition number of the DLT eats the digits of pixel coordinates.
fn normaliser<'a>(points: impl Iterator<Item = &'a Vector2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let count = points.clone().count() as f64;
    let mean = points.clone().sum::<Vector2<f64>>() / count;
    let spread = points.map(|p| (p - mean).norm()).sum::<f64>() / count;
    (spread > 0.0).then(|| {
        let s = 2f64.sqrt() / spread;
        Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0)
    })
}

/// The homography H with `to ~ H from` by the normalised direct linear transform (Hartley and
/// Zisserman, *Multiple View Geometry*, 2nd ed., algorithm 4.2), which minimises the algebraic error.
/// `None` for fewer than four points, or points on a line.
pub fn homography(from: &[Vector2<f64>], to: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    if from.len() != to.len() || from.len() < 4 {
        return None;
    }
    let (from_normaliser, to_normaliser) = (normaliser(from.iter())?, normaliser(to.iter())?);
    let mut normal = DMatrix::<f64>::zeros(9, 9);
    for (f, t) in from.iter().zip(to) {
        let f = apply_affine(&from_normaliser, f);
        let t = apply_affine(&to_normaliser, t);
        let rows = [
            [f.x, f.y, 1.0, 0.0, 0.0, 0.0, -t.x * f.x, -t.x * f.y, -t.x],
            [0.0, 0.0, 0.0, f.x, f.y, 1.0, -t.y * f.x, -t.y * f.y, -t.y],
        ];
        for row in rows {
            for (i, a) in row.iter().enumerate() {
                for (j, b) in row.iter().enumerate() {
                    normal[(i, j)] += a * b;
                }
            }
        }
    }
    let eigen = normal.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    // The second smallest eigenvalue vanishes too when the points do not fix a homography.
    if eigen.eigenvalues[order[1]] < 1e-10 * eigen.eigenvalues[order[8]] {
        return None;
    }
    let h = eigen.eigenvectors.column(order[0]);
    let normalised = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    let result = to_normaliser.try_inverse()? * normalised * from_normaliser;
    let scale = result.norm();
    (scale.is_finite() && scale > 0.0).then(|| {
        // The sign that puts the points in front: h₃·(x, y, 1) > 0.
        let depth = (result * Vector3::new(from[0].x, from[0].y, 1.0)).z;
        result * (depth.signum() / scale)
    })
}

fn apply_affine(m: &Matrix3<f64>, p: &Vector2<f64>) -> Vector2<f64> {
    Vector2::new(m[(0, 0)] * p.x + m[(0, 2)], m[(1, 1)] * p.y + m[(1, 2)])
}

/// The image of `point` under `h`; `None` at the line that goes to infinity.
pub fn apply(h: &Matrix3<f64>, point: &Vector2<f64>) -> Option<Vector2<f64>> {
    let p = h * Vector3::new(point.x, point.y, 1.0);
    (p.z.abs() > f64::EPSILON * h.norm()).then(|| Vector2::new(p.x / p.z, p.y / p.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exact_homography_is_recovered_and_a_line_refused() {
        let truth = Matrix3::new(420.0, -31.0, 700.0, 22.0, 390.0, 300.0, 0.2, -0.1, 1.3);
        let from: Vec<_> =
            (0..20).map(|i| Vector2::new(f64::from(i % 5) * 0.1, f64::from(i / 5) * 0.12)).collect();
        let to: Vec<_> = from.iter().map(|p| apply(&truth, p).expect("finite")).collect();
        let found = homography(&from, &to).expect("well posed");
        for (f, t) in from.iter().zip(&to) {
            assert!((apply(&found, f).expect("finite") - t).norm() < 1e-8);
        }
        let line: Vec<_> = (0..8).map(|i| Vector2::new(f64::from(i), 2.0 * f64::from(i))).collect();
        assert_eq!(homography(&line, &line), None);
    }
}
