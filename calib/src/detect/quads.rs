//! Dark quadrilaterals: local threshold, outer contours, four sides.

use nalgebra::Vector2;

use super::luma::Luma;

/// A dark quadrilateral: its corners, clockwise in the picture (x right, y down).
pub(super) type Quad = [Vector2<f64>; 4];

/// Side of the tiles whose least and largest values give the threshold, in px. A tile and its
/// neighbours must see both sides of an edge: 12 px do, also for an edge blurred over 6.
const TILE: usize = 4;
/// Least contrast, in grey levels, for a tile to hold an edge.
const MIN_CONTRAST: f64 = 12.0;
/// …and in standard deviations of the (smoothed) noise: the range of 144 normal numbers is below 6 σ in
/// all but one case in ten.
const NOISE_RANGE: f64 = 7.0;
/// Shortest contour that can be a marker, in px: sides of 8.
const MIN_CONTOUR: usize = 32;
/// How far a contour may lie off its quadrilateral, as a share of its length (OpenCV's
/// `polygonalApproxAccuracyRate`).
const POLYGON_TOLERANCE: f64 = 0.03;

/// All dark quadrilaterals of the picture.
pub(super) fn find_quads(image: &Luma) -> Vec<Quad> {
    let smooth = image.binomial();
    let mask = threshold(&smooth, (NOISE_RANGE * 0.375 * image.noise()).max(MIN_CONTRAST));
    contours(&mask, image.width(), image.height()).iter().filter_map(|c| fit(c)).collect()
}

/// 1 where darker than the middle between the least and largest value nearby, 0 elsewhere and where
/// there is no contrast; with a frame of one pixel of 0.
fn threshold(image: &Luma, contrast: f64) -> Vec<u8> {
    let (w, h) = (image.width(), image.height());
    let (tw, th) = (w.div_ceil(TILE), h.div_ceil(TILE));
    let (mut low, mut high) = (vec![255u8; tw * th], vec![0u8; tw * th]);
    for y in 0..h {
        let at = (y / TILE) * tw;
        for (t, pixels) in image.row(y).chunks(TILE).enumerate() {
            let (least, largest) = pixels.iter().fold((255, 0), |(l, g), v| ((*v).min(l), (*v).max(g)));
            low[at + t] = low[at + t].min(least);
            high[at + t] = high[at + t].max(largest);
        }
    }
    let stride = w + 2;
    let mut mask = vec![0u8; stride * (h + 2)];
    let contrast = contrast.min(255.0) as u8;
    let mut limits = vec![0u8; tw];
    for ty in 0..th {
        for (tx, limit) in limits.iter_mut().enumerate() {
            let (mut least, mut largest) = (255u8, 0u8);
            for y in ty.saturating_sub(1)..(ty + 2).min(th) {
                for x in tx.saturating_sub(1)..(tx + 2).min(tw) {
                    least = least.min(low[y * tw + x]);
                    largest = largest.max(high[y * tw + x]);
                }
            }
            // Nothing is darker than 0: a tile without contrast stays empty.
            *limit = if largest - least < contrast { 0 } else { least + (largest - least) / 2 };
        }
        for y in ty * TILE..((ty + 1) * TILE).min(h) {
            let out = &mut mask[(y + 1) * stride + 1..(y + 1) * stride + 1 + w];
            for ((out, pixels), limit) in out.chunks_mut(TILE).zip(image.row(y).chunks(TILE)).zip(&limits) {
                for (o, v) in out.iter_mut().zip(pixels) {
                    *o = u8::from(v < limit);
                }
            }
        }
    }
    mask
}

/// Outer borders of the 8-connected dark areas (Moore's border following), clockwise.
fn contours(mask: &[u8], width: usize, height: usize) -> Vec<Vec<Vector2<f64>>> {
    let stride = (width + 2) as isize;
    // E, SE, S, SW, W, NW, N, NE.
    let delta = [1, stride + 1, stride, stride - 1, -1, -stride - 1, -stride, -stride + 1];
    let mut visited = vec![false; mask.len()];
    let mut found = Vec::new();
    let mut path: Vec<usize> = Vec::new();
    for y in 1..=height {
        let row = y * stride as usize;
        for start in row + 1..=row + width {
            if mask[start] == 0 || mask[start - 1] == 1 || visited[start] {
                continue;
            }
            path.clear();
            // The neighbour from which the search goes on clockwise: background, to the west.
            let (mut at, mut back) = (start, 4usize);
            loop {
                let next =
                    (1..=8).map(|k| (back + k) % 8).find(|d| mask[at.wrapping_add_signed(delta[*d])] == 1);
                visited[at] = true;
                let Some(d) = next else { break };
                path.push(at);
                at = at.wrapping_add_signed(delta[d]);
                back = if d % 2 == 0 { (d + 6) % 8 } else { (d + 5) % 8 };
                // Back at the start, and about to leave it as before.
                if at == start {
                    let leaves = (1..=8)
                        .map(|k| (back + k) % 8)
                        .find(|d| mask[at.wrapping_add_signed(delta[*d])] == 1)
                        .map(|d| at.wrapping_add_signed(delta[d]));
                    if path.len() < 2 || leaves == Some(path[1]) {
                        break;
                    }
                }
            }
            if path.len() >= MIN_CONTOUR {
                let place = |i: &usize| {
                    let (x, y) = (i % stride as usize, i / stride as usize);
                    Vector2::new(x as f64 - 1.0, y as f64 - 1.0)
                };
                found.push(path.iter().map(place).collect());
            }
        }
    }
    found
}

/// The quadrilateral that a contour is, with its corners where the lines fitted to its sides meet;
/// `None` for any other shape, and for the border of a hole.
fn fit(contour: &[Vector2<f64>]) -> Option<Quad> {
    let n = contour.len();
    // Clockwise with y down: a positive area; the borders of holes run the other way.
    let area = signed_area(contour);
    if area < 40.0 {
        return None;
    }
    let centre = contour.iter().sum::<Vector2<f64>>() / n as f64;
    let farthest = |from: &Vector2<f64>| {
        (0..n).max_by(|&a, &b| {
            (contour[a] - from).norm_squared().total_cmp(&(contour[b] - from).norm_squared())
        })
    };
    let first = farthest(&centre)?;
    let second = farthest(&contour[first])?;
    let tolerance = (POLYGON_TOLERANCE * n as f64).max(1.5);
    let mut corners = vec![first, second];
    split(contour, first, second, tolerance, &mut corners);
    split(contour, second, first, tolerance, &mut corners);
    if corners.len() != 4 {
        return None;
    }
    corners.sort_unstable();
    let quad = [0, 1, 2, 3].map(|i| contour[corners[i]]);
    let quad_area = signed_area(&quad);
    if quad_area <= 0.0 || !(0.8..1.25).contains(&(area / quad_area)) || !is_convex(&quad) {
        return None;
    }
    let lines = [0, 1, 2, 3].map(|i| {
        let (from, to) = (corners[i], corners[(i + 1) % 4]);
        let length = (to + n - from) % n;
        // The corners themselves are rounded by blur.
        let cut = (length / 6).max(1);
        let points = (cut..=length.saturating_sub(cut)).map(|k| contour[(from + k) % n]);
        fit_line(points)
    });
    let mut sides = [(Vector2::zeros(), Vector2::zeros()); 4];
    for (i, line) in lines.into_iter().enumerate() {
        let (point, mut direction) = line?;
        if direction.dot(&(quad[(i + 1) % 4] - quad[i])) < 0.0 {
            direction = -direction;
        }
        // The contour runs through the centres of the outermost dark pixels; the edge is half a pixel out.
        sides[i] = (point + Vector2::new(direction.y, -direction.x) * 0.5, direction);
    }
    let mut out = quad;
    for (i, corner) in out.iter_mut().enumerate() {
        let met = meet(&sides[(i + 3) % 4], &sides[i])?;
        if (met - *corner).norm() > tolerance + 2.0 {
            return None;
        }
        *corner = met;
    }
    Some(out)
}

/// Douglas and Peucker's subdivision of the way from `from` to `to`.
fn split(contour: &[Vector2<f64>], from: usize, to: usize, tolerance: f64, corners: &mut Vec<usize>) {
    let n = contour.len();
    let chord = contour[to] - contour[from];
    let length = (to + n - from) % n;
    let off = |k: usize| {
        let p = contour[(from + k) % n] - contour[from];
        (chord.x * p.y - chord.y * p.x).abs() / chord.norm().max(1e-9)
    };
    let Some((worst, distance)) = (1..length).map(|k| (k, off(k))).max_by(|a, b| a.1.total_cmp(&b.1)) else {
        return;
    };
    if distance > tolerance && corners.len() < 8 {
        let middle = (from + worst) % n;
        corners.push(middle);
        split(contour, from, middle, tolerance, corners);
        split(contour, middle, to, tolerance, corners);
    }
}

pub(super) fn signed_area(polygon: &[Vector2<f64>]) -> f64 {
    let n = polygon.len();
    0.5 * (0..n).map(|i| polygon[i].perp(&polygon[(i + 1) % n])).sum::<f64>()
}

pub(super) fn is_convex(quad: &Quad) -> bool {
    (0..4).all(|i| (quad[(i + 1) % 4] - quad[i]).perp(&(quad[(i + 2) % 4] - quad[(i + 1) % 4])) > 0.0)
}

/// The line of least squared distance: a point on it and its unit direction.
pub(super) fn fit_line(
    points: impl Iterator<Item = Vector2<f64>> + Clone,
) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let count = points.clone().count();
    if count < 2 {
        return None;
    }
    let mean = points.clone().sum::<Vector2<f64>>() / count as f64;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let d = p - mean;
        (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
    }
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    Some((mean, Vector2::new(angle.cos(), angle.sin())))
}

/// Where two lines meet.
pub(super) fn meet(
    a: &(Vector2<f64>, Vector2<f64>),
    b: &(Vector2<f64>, Vector2<f64>),
) -> Option<Vector2<f64>> {
    let cross = a.1.perp(&b.1);
    (cross.abs() > 1e-3).then(|| a.0 + a.1 * ((b.0 - a.0).perp(&b.1) / cross))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dark_square_is_found_with_its_corners_and_a_disc_is_not() {
        let data = (0..100 * 100)
            .map(|i| {
                let (x, y) = (f64::from(i % 100), f64::from(i / 100));
                let in_square = (x - 30.0) + 0.2 * (y - 30.0) > -15.0
                    && (x - 30.0) + 0.2 * (y - 30.0) < 15.0
                    && (y - 30.0) - 0.2 * (x - 30.0) > -15.0
                    && (y - 30.0) - 0.2 * (x - 30.0) < 15.0;
                let in_disc = (x - 72.0).hypot(y - 72.0) < 15.0;
                if in_square || in_disc { 40 } else { 200 }
            })
            .collect();
        let quads = find_quads(&Luma::new(100, 100, data).expect("fits"));
        assert_eq!(quads.len(), 1);
        let centre = quads[0].iter().sum::<Vector2<f64>>() / 4.0;
        assert!((centre - Vector2::new(30.0, 30.0)).norm() < 0.5, "{centre}");
        let area = signed_area(&quads[0]);
        assert!((area - 900.0 / 1.04).abs() < 40.0, "{area}");
    }
}
