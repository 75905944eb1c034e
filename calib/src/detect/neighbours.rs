//! Each corner against all others: what lies off where the board and a smooth lens put it is no corner.

use nalgebra::{DMatrix, DVector, Vector2, Vector3};

use super::Corner;
use crate::solve::{apply_homography, homography};

/// Furthest from where the others put it, in px; or in robust standard deviations of all corners, whichever is more.
const FLOOR_PX: f64 = 1.0;
/// Standard deviations that a corner of a chessboard or ChArUco board may be off: a saddle that was found is seldom
/// wrong.
pub(super) const MISFIT_SIGMAS: f64 = 6.0;
/// Fewest corners for which the lens is modelled; below, a board covers too little of the picture for it
/// to matter beyond [`SMALL_SHARE`].
const FEW: usize = 16;
/// What a homography alone may be off on a small part of a board, as a share of the spacing.
const SMALL_SHARE: f64 = 0.1;
/// Rounds of reweighting.
const ROUNDS: usize = 6;

/// Takes out corners that lie off the robust fit of a homography followed by a polynomial (second degree,
/// from 40 corners on third), which follows lens distortion over a board closely. `spacing_m` is the
/// distance of neighbours on the board; `sigmas` standard deviations are allowed.
pub(super) fn drop_misfits(corners: &mut Vec<Corner>, points: &[Vector3<f64>], spacing_m: f64, sigmas: f64) {
    // A gross mistake bends the homography itself: again without what was dropped.
    for _ in 0..3 {
        let before = corners.len();
        if before < 6 {
            return;
        }
        drop_once(corners, points, spacing_m, sigmas);
        if corners.len() == before {
            return;
        }
    }
}

fn drop_once(corners: &mut Vec<Corner>, points: &[Vector3<f64>], spacing_m: f64, sigmas: f64) {
    let from: Vec<Vector2<f64>> = corners.iter().map(|c| points[c.id].xy()).collect();
    let to: Vec<Vector2<f64>> = corners.iter().map(|c| c.at).collect();
    let Some(h) = homography(&from, &to) else { return };
    let Some(forecast) = from.iter().map(|p| apply_homography(&h, p)).collect::<Option<Vec<_>>>() else {
        return;
    };
    let off: Vec<Vector2<f64>> = to.iter().zip(&forecast).map(|(a, b)| a - b).collect();
    if corners.len() < FEW {
        let beside = from.iter().map(|p| apply_homography(&h, &(p + Vector2::new(spacing_m, 0.0))));
        let spacing = beside
            .zip(&forecast)
            .filter_map(|(b, f)| b.map(|b| (b - f).norm()))
            .fold(f64::INFINITY, f64::min);
        let limit = (SMALL_SHARE * spacing).max(FLOOR_PX);
        let mut index = 0..;
        corners.retain(|_| index.next().is_none_or(|i: usize| off[i].norm() <= limit));
        return;
    }
    let degree = if corners.len() >= 40 { 3 } else { 2 };
    let centre = forecast.iter().sum::<Vector2<f64>>() / forecast.len() as f64;
    let extent = forecast.iter().map(|p| (p - centre).amax()).fold(1e-9, f64::max);
    let terms: Vec<(i32, i32)> = (0..=degree).flat_map(|d| (0..=d).map(move |i| (d - i, i))).collect();
    let design = DMatrix::from_fn(forecast.len(), terms.len(), |r, c| {
        let p = (forecast[r] - centre) / extent;
        p.x.powi(terms[c].0) * p.y.powi(terms[c].1)
    });
    let mut weights = vec![1.0; off.len()];
    let mut residuals: Vec<f64> = Vec::new();
    let mut sigma = 0.0;
    for _ in 0..ROUNDS {
        let weighted = DMatrix::from_fn(design.nrows(), design.ncols(), |r, c| design[(r, c)] * weights[r]);
        let Some(normal) = (design.transpose() * &weighted).cholesky() else { return };
        let side = |pick: fn(&Vector2<f64>) -> f64| -> DVector<f64> {
            let rhs = weighted.transpose() * DVector::from_iterator(off.len(), off.iter().map(pick));
            &design * normal.solve(&rhs)
        };
        let (x, y) = (side(|o| o.x), side(|o| o.y));
        residuals = off.iter().enumerate().map(|(i, o)| (o.x - x[i]).hypot(o.y - y[i])).collect();
        let mut sorted = residuals.clone();
        let middle = sorted.len() / 2;
        // The median length of a 2D normal error is 1.1774 σ.
        sigma = (*sorted.select_nth_unstable_by(middle, f64::total_cmp).1 / 1.1774).max(0.02);
        let scale = 3.0 * sigma;
        weights = residuals.iter().map(|r| 1.0 / (1.0 + (r / scale).powi(2))).collect();
    }
    let limit = (sigmas * sigma).max(FLOOR_PX);
    let mut index = 0..;
    corners.retain(|_| index.next().is_none_or(|i: usize| residuals[i] <= limit));
}
