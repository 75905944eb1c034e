use nalgebra::Vector2;

use crate::detect::{BoardView, Luma};

/// How blurred the edges of a board are: the standard deviation, in px, of the Gaussian that would make its
/// steepest edges as steep as they are; the middle over its corners. `None` when too little of the picture lies
/// around the corners.
///
/// An edge of contrast C blurred by σ has the slope C / (σ √(2π)) at its steepest. A pixel itself is as wide as a
/// Gaussian of 0.29 px, and the central difference widens it to about 0.6 px: a sharp picture gives that.
pub fn blur_px(picture: &Luma, board: &BoardView) -> Option<f64> {
    let reach = reach(board)?;
    let mut blurs: Vec<f64> =
        board.corners.iter().filter_map(|c| corner_blur(picture, &c.at, reach)).collect();
    if blurs.len() < 3 {
        return None;
    }
    let middle = blurs.len() / 2;
    Some(*blurs.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Half the side of the window around a corner: less than half the way to its neighbours.
fn reach(board: &BoardView) -> Option<i64> {
    const SMALLEST: f64 = 3.0;
    const LARGEST: f64 = 12.0;
    let mut nearest: Vec<f64> = board
        .corners
        .iter()
        .filter_map(|c| {
            let others = board.corners.iter().filter(|o| o.id != c.id);
            others.map(|o| (o.at - c.at).norm()).min_by(f64::total_cmp)
        })
        .collect();
    if nearest.is_empty() {
        return None;
    }
    let middle = nearest.len() / 2;
    let step = *nearest.select_nth_unstable_by(middle, f64::total_cmp).1;
    Some((0.45 * step).clamp(SMALLEST, LARGEST) as i64)
}

fn corner_blur(picture: &Luma, at: &Vector2<f64>, reach: i64) -> Option<f64> {
    let (x, y) = (at.x.round() as i64, at.y.round() as i64);
    let inside = |c: i64, size: usize| c > reach && c + reach + 1 < size as i64;
    if !inside(x, picture.width()) || !inside(y, picture.height()) {
        return None;
    }
    let value = |x: i64, y: i64| f64::from(picture.at(x as usize, y as usize));
    let mut levels = Vec::new();
    let mut slopes = Vec::new();
    for (px, py) in (y - reach..=y + reach).flat_map(|py| (x - reach..=x + reach).map(move |px| (px, py))) {
        levels.push(value(px, py));
        let slope =
            Vector2::new(value(px + 1, py) - value(px - 1, py), value(px, py + 1) - value(px, py - 1)) / 2.0;
        slopes.push(slope.norm());
    }
    levels.sort_unstable_by(f64::total_cmp);
    slopes.sort_unstable_by(f64::total_cmp);
    let quantile = |sorted: &[f64], q: f64| sorted[((sorted.len() - 1) as f64 * q).round() as usize];
    let contrast = quantile(&levels, 0.95) - quantile(&levels, 0.05);
    // A few of the steepest, not the very steepest, which is noise.
    let steepest = quantile(&slopes, 0.97);
    (contrast > 8.0 && steepest > 0.0).then(|| contrast / (steepest * (2.0 * std::f64::consts::PI).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::Corner;

    /// A chessboard of 40 px squares blurred by σ: the product of error functions along each axis, by sampling.
    fn board(sigma: f64) -> (Luma, BoardView) {
        let wave = |x: f64| -> f64 {
            let steps = 41;
            let mut sum = (0.0, 0.0);
            for i in 0..steps {
                let d = (f64::from(i) / f64::from(steps - 1) - 0.5) * 6.0;
                let weight = (-0.5 * d * d).exp();
                let sign = if ((x + d * sigma) / 40.0).floor() as i64 % 2 == 0 { 1.0 } else { -1.0 };
                sum = (sum.0 + weight * sign, sum.1 + weight);
            }
            sum.0 / sum.1
        };
        let axis: Vec<f64> = (0..240).map(|i| wave(f64::from(i) + 0.5)).collect();
        let data =
            (0..240 * 240).map(|i| (128.0 + 90.0 * axis[i % 240] * axis[i / 240]).round() as u8).collect();
        let corners = (0..16)
            .map(|i| Corner {
                id: i,
                at: Vector2::new(40.0 * (1 + i % 4) as f64 - 0.5, 40.0 * (1 + i / 4) as f64 - 0.5),
            })
            .collect();
        let view = BoardView { corners, markers: Vec::new(), anchored: true };
        (Luma::new(240, 240, data).expect("fits"), view)
    }

    #[test]
    fn blur_is_measured_to_a_fifth() {
        for sigma in [1.5, 2.5, 4.0] {
            let (picture, view) = board(sigma);
            let found = blur_px(&picture, &view).expect("corners");
            assert!((found / sigma - 1.0).abs() < 0.2, "σ = {sigma}: {found}");
        }
        let (picture, view) = board(0.3);
        assert!(blur_px(&picture, &view).expect("corners") < 1.0);
    }
}
