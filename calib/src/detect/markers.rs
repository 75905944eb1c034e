//! ArUco markers: which quadrilaterals carry a pattern of the dictionary, and where their corners are.

use nalgebra::{Matrix3, Vector2};

use super::{
    luma::Luma,
    quads::{Quad, fit_line, is_convex, meet, signed_area},
};
use crate::{
    board::Dictionary,
    solve::{apply_homography, homography},
};

/// A marker in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marker {
    /// Its number in the dictionary.
    pub id: usize,
    /// Its corners in the marker's own order, clockwise from its top left, in px.
    pub corners: [Vector2<f64>; 4],
    /// Bits read wrongly.
    pub errors: u32,
}

/// Share of the border's cells that may look white.
const BORDER_ERRORS: f64 = 0.25;
/// Least difference between white and black, in grey levels.
const MIN_STEP: f64 = 8.0;

/// Homography from the marker's cells (0 … size + 2) to the picture.
fn cells_to_image(quad: &Quad, cells: f64) -> Option<Matrix3<f64>> {
    let unit = [(0.0, 0.0), (cells, 0.0), (cells, cells), (0.0, cells)].map(|(x, y)| Vector2::new(x, y));
    homography(&unit, quad)
}

/// Reads the pattern inside `quad`: bits row by row from the quad's first corner. Black and white levels
/// are planes fitted to the border and to its surroundings (as in AprilTag 2), so that shading does not
/// flip bits. `None` where the border is not dark all around.
fn read(image: &Luma, quad: &Quad, size: usize) -> Option<u64> {
    let cells = size + 2;
    let h = cells_to_image(quad, cells as f64)?;
    let mean = |x: f64, y: f64, reach: f64| -> Option<f64> {
        let mut sum = 0.0;
        for (dx, dy) in [(0.0, 0.0), (-reach, -reach), (reach, -reach), (-reach, reach), (reach, reach)] {
            let p = apply_homography(&h, &Vector2::new(x + dx, y + dy))?;
            sum += image.sample(p.x, p.y)?;
        }
        Some(sum / 5.0)
    };
    let mut black = Vec::with_capacity(4 * cells);
    let mut white = Vec::with_capacity(4 * cells);
    let n = cells as f64;
    for i in 0..cells {
        let c = i as f64 + 0.5;
        for (x, y) in [(c, 0.5), (n - 0.5, c), (n - c, n - 0.5), (0.5, n - c)] {
            black.push((x, y, mean(x, y, 0.2)?));
        }
        for (x, y) in [(c, -0.4), (n + 0.4, c), (n - c, n + 0.4), (-0.4, n - c)] {
            // At the picture's edge the surroundings may be cut off.
            if let Some(v) = mean(x, y, 0.1) {
                white.push((x, y, v));
            }
        }
    }
    let (black_plane, white_plane) = (plane(&black)?, plane(&white)?);
    let level = |x: f64, y: f64| {
        let at = |p: &[f64; 3]| p[0] + p[1] * x + p[2] * y;
        (at(&black_plane), at(&white_plane))
    };
    let (b, w) = level(n / 2.0, n / 2.0);
    if w - b < MIN_STEP {
        return None;
    }
    let is_white = |x: f64, y: f64, v: f64| {
        let (b, w) = level(x, y);
        v > 0.5 * (b + w)
    };
    let wrong = black.iter().filter(|(x, y, v)| is_white(*x, *y, *v)).count();
    if wrong as f64 > BORDER_ERRORS * black.len() as f64 {
        return None;
    }
    let mut bits = 0;
    for row in 0..size {
        for column in 0..size {
            let (x, y) = (column as f64 + 1.5, row as f64 + 1.5);
            bits = bits << 1 | u64::from(is_white(x, y, mean(x, y, 0.2)?));
        }
    }
    Some(bits)
}

/// v = a + b x + c y by least squares.
fn plane(samples: &[(f64, f64, f64)]) -> Option<[f64; 3]> {
    let (mut normal, mut rhs) = (Matrix3::<f64>::zeros(), nalgebra::Vector3::zeros());
    for &(x, y, v) in samples {
        let row = nalgebra::Vector3::new(1.0, x, y);
        normal += row * row.transpose();
        rhs += row * v;
    }
    let p = normal.cholesky()?.solve(&rhs);
    Some([p.x, p.y, p.z])
}

/// The markers among `quads`: numbers of `ids` only, with up to `max_errors` bits wrong.
pub(super) fn decode(
    image: &Luma,
    quads: &[Quad],
    dictionary: &Dictionary,
    ids: &[usize],
    max_errors: u32,
) -> Vec<Marker> {
    let mut found: Vec<Marker> = Vec::new();
    for quad in quads {
        let Some(bits) = read(image, quad, dictionary.size()) else { continue };
        let Some(reading) = dictionary.identify(bits, ids.iter().copied(), max_errors) else { continue };
        let corners = [0, 1, 2, 3].map(|k| quad[(k + reading.turns) % 4]);
        found.push(Marker { id: reading.id, corners, errors: reading.errors });
    }
    found
}

/// Marker `id` where it is foretold to be: its corners in its own order, read with up to `max_errors` bits wrong.
pub(super) fn confirm(
    image: &Luma,
    foretold: &Quad,
    dictionary: &Dictionary,
    id: usize,
    max_errors: u32,
) -> Option<Marker> {
    let bits = read(image, foretold, dictionary.size())?;
    let reading = dictionary.identify(bits, std::iter::once(id), max_errors)?;
    (reading.turns == 0).then_some(Marker { id, corners: *foretold, errors: reading.errors })
}

/// Moves a marker's corners to where the lines through its edges meet: along each side, the edge is the
/// centroid of the gradient across it.
pub(super) fn refine_corners(image: &Luma, marker: &Marker, cells: usize, gap_cells: f64) -> Option<Marker> {
    let mut corners = marker.corners;
    // Once from the contour's corners, once more from where that led.
    for _ in 0..2 {
        let mut lines = [[(Vector2::zeros(), Vector2::zeros()); 2]; 4];
        let area = signed_area(&corners);
        for (i, line) in lines.iter_mut().enumerate() {
            let (from, to) = (corners[i], corners[(i + 1) % 4]);
            let side = to - from;
            let length = side.norm();
            let cell = length / cells as f64;
            let outward = Vector2::new(side.y, -side.x) / length;
            // Across the edge cells are shorter when the marker is tilted.
            let deep = (area / length / cells as f64).min(cell);
            let reach = (0.5 * deep).min(0.5 * gap_cells * deep).clamp(1.5, 4.5);
            let samples = (length * 0.75).ceil().clamp(8.0, 80.0);
            let mut points = Vec::with_capacity(samples as usize);
            for k in 0..samples as usize {
                let along = 0.1 + 0.8 * (k as f64 + 0.5) / samples;
                if let Some(off) = edge_offset(image, from + side * along, outward, reach) {
                    points.push(from + side * along + outward * off);
                }
            }
            *line = edge_ends(&points, samples as usize / 2, from, to)?;
        }
        let mut moved = corners;
        for (i, corner) in moved.iter_mut().enumerate() {
            *corner = meet(&lines[(i + 3) % 4][1], &lines[i][0])?;
            let cell = (corners[(i + 1) % 4] - corners[i]).norm() / cells as f64;
            if (*corner - corners[i]).norm() > cell.max(3.0) {
                return None;
            }
        }
        corners = moved;
    }
    (is_convex(&corners) && signed_area(&corners) > 0.0).then_some(Marker { corners, ..*marker })
}

/// Where, along `outward` from `at`, the brightness rises: the centroid of its derivative, the window
/// moved onto the edge once. `None` where nothing rises.
fn edge_offset(image: &Luma, at: Vector2<f64>, outward: Vector2<f64>, reach: f64) -> Option<f64> {
    const STEP: f64 = 0.5;
    let mut centre = 0.0;
    for _ in 0..2 {
        let steps = (reach / STEP).ceil() as i32;
        let value = |k: i32| {
            let p = at + outward * (centre + f64::from(k) * STEP);
            image.sample(p.x, p.y)
        };
        let (mut sum, mut moment) = (0.0, 0.0);
        let mut last = value(-steps)?;
        for k in -steps + 1..=steps {
            let v = value(k)?;
            sum += v - last;
            moment += (v - last) * (f64::from(k) - 0.5) * STEP;
            last = v;
        }
        if sum < MIN_STEP {
            return None;
        }
        centre += (moment / sum).clamp(-reach, reach);
        if centre.abs() > 1.5 * reach {
            return None;
        }
    }
    Some(centre)
}

/// The tangents (a point and a direction) at both ends of an edge that runs from `from` to `to`. A lens bends
/// edges: a parabola is fitted where its bend is sure, a line elsewhere, since the ends of a parabola are less
/// certain.
fn edge_ends(
    points: &[Vector2<f64>],
    least: usize,
    from: Vector2<f64>,
    to: Vector2<f64>,
) -> Option<[(Vector2<f64>, Vector2<f64>); 2]> {
    /// The bend in its standard deviations from which it is believed.
    const SURE: f64 = 3.0;
    let (kept, (mean, direction)) = robust_line(points, least)?;
    let across = Vector2::new(-direction.y, direction.x);
    let along = |p: &Vector2<f64>| (p - mean).dot(&direction);
    let half = kept.iter().map(|p| along(p).abs()).fold(1e-9, f64::max);
    let (mut normal, mut rhs) = (Matrix3::<f64>::zeros(), nalgebra::Vector3::<f64>::zeros());
    for p in &kept {
        let s = along(p) / half;
        let row = nalgebra::Vector3::new(1.0, s, s * s);
        normal += row * row.transpose();
        rhs += row * (p - mean).dot(&across);
    }
    let straight = [(mean, direction); 2];
    let Some(inverse) = normal.try_inverse().filter(|_| kept.len() > 5) else { return Some(straight) };
    let terms = inverse * rhs;
    let offset = |s: f64| terms.x + terms.y * s + terms.z * s * s;
    let squares: f64 = kept.iter().map(|p| (offset(along(p) / half) - (p - mean).dot(&across)).powi(2)).sum();
    let sigma = (squares / (kept.len() - 3) as f64 * inverse[(2, 2)]).sqrt();
    if terms.z.abs() < SURE * sigma {
        return Some(straight);
    }
    Some([from, to].map(|end| {
        let s = along(&end) / half;
        let slope = (terms.y + 2.0 * terms.z * s) / half;
        (mean + direction * (s * half) + across * offset(s), (direction + across * slope).normalize())
    }))
}

/// A line through at least `least` points, those far off left out; and those that are left.
fn robust_line(
    points: &[Vector2<f64>],
    least: usize,
) -> Option<(Vec<Vector2<f64>>, (Vector2<f64>, Vector2<f64>))> {
    let mut kept = points.to_vec();
    for _ in 0..3 {
        if kept.len() < least.max(3) {
            return None;
        }
        let (mean, direction) = fit_line(kept.iter().copied())?;
        let off = |p: &Vector2<f64>| (p - mean).perp(&direction).abs();
        let mut distances: Vec<f64> = kept.iter().map(off).collect();
        let middle = distances.len() / 2;
        let limit = 3.0 * 1.4826 * distances.select_nth_unstable_by(middle, f64::total_cmp).1.max(0.02);
        let before = kept.len();
        kept.retain(|p| off(p) <= limit);
        if kept.len() == before {
            return Some((kept, (mean, direction)));
        }
    }
    if kept.len() < least.max(3) {
        return None;
    }
    let line = fit_line(kept.iter().copied())?;
    Some((kept, line))
}
