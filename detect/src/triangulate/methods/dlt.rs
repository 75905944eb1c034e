use nalgebra::{Matrix4, Vector3, Vector4};
use netcord_common::{
    geometry::{Point, World},
    wire::{MethodCode, NoPosition},
};

use super::{Method, at_least_two, in_front};
use crate::triangulate::{Observation, PosedCamera};

/// Homogeneous direct linear transform (Hartley & Zisserman, Multiple View Geometry, §12.2): the unit
/// vector X of least ‖A X‖, whose rows are x r₃ − r₁ and y r₃ − r₂ of each `[R|t]` on undistorted
/// normalised points, not scaled. Minimises an algebraic error: far and near cameras weigh differently,
/// and so does the choice of the origin.
#[derive(Debug, Clone, Copy, Default)]
pub struct DltSvd;

/// Inhomogeneous direct linear transform: the same rows with X = (x, y, z, 1), by linear least squares.
#[derive(Debug, Clone, Copy, Default)]
pub struct DltLs;

/// A pivot below this share of the largest means that the rays leave the point's depth open: rounding
/// alone, 1e-16, would then be millimetres.
const DEGENERATE: f64 = 1e-9;

impl Method for DltSvd {
    fn code(&self) -> MethodCode {
        MethodCode::DltSvd
    }

    fn locate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Point<World>, NoPosition> {
        at_least_two(observations)?;
        let (x, conditioning) = least_singular_vector(triangle(cameras, observations));
        if conditioning < DEGENERATE || x.w.abs() < DEGENERATE {
            return Err(NoPosition::ParallelRays);
        }
        in_front(cameras, observations, x.xyz() / x.w)
    }
}

impl Method for DltLs {
    fn code(&self) -> MethodCode {
        MethodCode::DltLs
    }

    fn locate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Point<World>, NoPosition> {
        at_least_two(observations)?;
        in_front(cameras, observations, linear(cameras, observations).ok_or(NoPosition::ParallelRays)?)
    }
}

/// The inhomogeneous solution; `None` where the rays are parallel.
pub(super) fn linear(cameras: &[PosedCamera], observations: &[Observation]) -> Option<Vector3<f64>> {
    let r = triangle(cameras, observations);
    let largest = r.m11.abs().max(r.m22.abs()).max(r.m33.abs());
    let smallest = r.m11.abs().min(r.m22.abs()).min(r.m33.abs());
    if smallest <= DEGENERATE * largest {
        return None;
    }
    let z = -r.m34 / r.m33;
    let y = -(r.m24 + r.m23 * z) / r.m22;
    let x = -(r.m14 + r.m12 * y + r.m13 * z) / r.m11;
    Some(Vector3::new(x, y, z))
}

/// The triangular factor of A = Q R, row after row by Givens rotations: as well conditioned as A itself
/// (Aᵀ A would square that), of fixed size for any number of views.
fn triangle(cameras: &[PosedCamera], observations: &[Observation]) -> Matrix4<f64> {
    let mut r = Matrix4::zeros();
    for o in observations {
        let camera = &cameras[o.camera];
        let row = |i: usize| {
            let m = &camera.rotation;
            Vector4::new(m[(i, 0)], m[(i, 1)], m[(i, 2)], camera.translation[i])
        };
        let third = row(2);
        annihilate(&mut r, o.normalised.x * third - row(0));
        annihilate(&mut r, o.normalised.y * third - row(1));
    }
    r
}

fn annihilate(r: &mut Matrix4<f64>, mut row: Vector4<f64>) {
    for k in 0..4 {
        if row[k] == 0.0 {
            continue;
        }
        let length = (r[(k, k)] * r[(k, k)] + row[k] * row[k]).sqrt();
        let (c, s) = (r[(k, k)] / length, row[k] / length);
        for j in k..4 {
            let above = r[(k, j)];
            r[(k, j)] = c * above + s * row[j];
            row[j] = c * row[j] - s * above;
        }
    }
}

/// The right singular vector of the smallest singular value, and the second smallest value over the
/// largest (zero when the vector is not determined). One-sided Jacobi (Hestenes 1958): the most accurate
/// method for small matrices, and without cases in which it does not converge.
fn least_singular_vector(mut a: Matrix4<f64>) -> (Vector4<f64>, f64) {
    const SWEEPS: usize = 30;
    let mut v = Matrix4::identity();
    for _ in 0..SWEEPS {
        let mut rotated = false;
        for p in 0..3 {
            for q in p + 1..4 {
                let alpha = a.column(p).norm_squared();
                let beta = a.column(q).norm_squared();
                let gamma = a.column(p).dot(&a.column(q));
                if gamma.abs() <= 1e-16 * (alpha * beta).sqrt() || gamma == 0.0 {
                    continue;
                }
                rotated = true;
                let zeta = (beta - alpha) / (2.0 * gamma);
                let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
                let c = 1.0 / (1.0 + t * t).sqrt();
                let s = c * t;
                for m in [&mut a, &mut v] {
                    for i in 0..4 {
                        let (x, y) = (m[(i, p)], m[(i, q)]);
                        m[(i, p)] = c * x - s * y;
                        m[(i, q)] = s * x + c * y;
                    }
                }
            }
        }
        if !rotated {
            break;
        }
    }
    let norms: [f64; 4] = std::array::from_fn(|j| a.column(j).norm());
    let mut order = [0, 1, 2, 3];
    order.sort_unstable_by(|i, j| norms[*i].total_cmp(&norms[*j]));
    let conditioning = if norms[order[3]] > 0.0 { norms[order[1]] / norms[order[3]] } else { 0.0 };
    (v.column(order[0]).into_owned(), conditioning)
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, Matrix4};
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn the_singular_vector_is_that_of_a_general_decomposition() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(1);
        for _ in 0..200 {
            let a = Matrix4::from_fn(|_, _| random.random_range(-1.0..1.0));
            let (x, conditioning) = least_singular_vector(a);
            let svd = DMatrix::from_fn(4, 4, |i, j| a[(i, j)]).svd(false, true);
            let v_t = svd.v_t.expect("asked for");
            let least = svd.singular_values.imin();
            let against = (0..4).map(|i| v_t[(least, i)] * x[i]).sum::<f64>().abs();
            assert!((against - 1.0).abs() < 1e-9, "cosine {against}");
            assert!((a * x).norm() <= svd.singular_values[least] + 1e-12);
            assert!(conditioning > 0.0);
        }
    }
}
