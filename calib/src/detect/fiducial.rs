//! Boards with markers: which markers belong to the board, and its corners.

use nalgebra::{Matrix3, Vector2};
use rayon::prelude::*;

use super::{
    Corner, Depth,
    luma::Luma,
    markers::{Marker, confirm, decode, refine_corners},
    neighbours::{MISFIT_SIGMAS, drop_misfits},
    pattern_fit::fit_pattern,
    quads::{Quad, find_quads},
    saddle::SaddleFit,
};
use crate::{
    board::{CalibrationBoard, Dictionary, Pattern, PlacedMarker},
    solve::{apply_homography, homography},
};

/// Pictures wider than this are searched at half size too: large markers are cheaper to find there, and
/// noise is halved.
const HALVE_ABOVE: usize = 1000;

/// Dark quadrilaterals of the picture, in full-size pixels.
pub(super) fn quads_of(image: &Luma, depth: Depth) -> Vec<Quad> {
    let half = (image.width() > HALVE_ABOVE).then(|| image.halved()).flatten();
    let mut quads = match (&half, depth) {
        (Some(_), Depth::Guiding) => Vec::new(),
        _ => find_quads(image),
    };
    if let Some(half) = half {
        let up = |p: Vector2<f64>| p * 2.0 + Vector2::repeat(0.5);
        quads.extend(find_quads(&half).into_iter().map(|q| q.map(up)));
    }
    quads
}

/// The board's markers in the picture, those that contradict the others left out.
pub(super) fn board_markers(image: &Luma, quads: &[Quad], board: &CalibrationBoard) -> Vec<Marker> {
    let Some(dictionary) = board.dictionary() else { return Vec::new() };
    let placed = board.markers();
    let ids: Vec<usize> = placed.iter().map(|m| m.id).collect();
    // The few numbers of one board lie further apart than those of the whole dictionary.
    let most = dictionary.correction().max(1).min((dictionary.size() * dictionary.size()) as u32 / 8);
    let mut found = decode(image, quads, dictionary, &ids, most);
    found.sort_by_key(|m| (m.id, m.errors));
    found.dedup_by(|b, a| a.id == b.id && (centre(a) - centre(b)).norm() < 0.5 * side_px(a));
    consistent(found, &placed, dictionary)
}

/// Numbers of the markers of `dictionary` that the picture shows with at most one wrong bit.
pub(super) fn any_markers(image: &Luma, quads: &[Quad], dictionary: &Dictionary) -> Vec<Marker> {
    let ids: Vec<usize> = (0..dictionary.len()).collect();
    let mut found = decode(image, quads, dictionary, &ids, u32::from(dictionary.size() > 4));
    found.sort_by_key(|m| (m.id, m.errors));
    found.dedup_by_key(|m| m.id);
    found
}

fn centre(m: &Marker) -> Vector2<f64> {
    m.corners.iter().sum::<Vector2<f64>>() / 4.0
}

fn side_px(m: &Marker) -> f64 {
    (0..4).map(|i| (m.corners[(i + 1) % 4] - m.corners[i]).norm()).fold(f64::INFINITY, f64::min)
}

fn place_of(placed: &[PlacedMarker], id: usize) -> Option<&PlacedMarker> {
    placed.iter().find(|p| p.id == id)
}

/// Homography from the board to the picture by the corners of these markers.
fn homography_of<'a>(
    markers: impl Iterator<Item = &'a Marker>,
    placed: &[PlacedMarker],
) -> Option<Matrix3<f64>> {
    let (mut from, mut to) = (Vec::new(), Vec::new());
    for m in markers {
        from.extend(place_of(placed, m.id)?.corners());
        to.extend(m.corners);
    }
    homography(&from, &to)
}

/// The largest set of markers that one homography puts where they were seen, within a good half of
/// their side, which leaves room for the lens; then each against its nearest neighbours, more strictly.
fn consistent(found: Vec<Marker>, placed: &[PlacedMarker], dictionary: &Dictionary) -> Vec<Marker> {
    const LOOSE: f64 = 0.6;
    const STRICT: f64 = 0.25;
    if found.len() <= 1 {
        // A single marker must be beyond doubt: no wrong bit, and enough bits.
        let sure =
            |m: &Marker| m.errors == 0 && (dictionary.size() > 4 || placed.len() <= 50) && side_px(m) > 12.0;
        return found.into_iter().filter(sure).collect();
    }
    let misfit = |h: &Matrix3<f64>, m: &Marker| -> f64 {
        let Some(place) = place_of(placed, m.id) else { return f64::INFINITY };
        let off = place.corners().into_iter().zip(m.corners);
        let off = off.map(|(b, c)| apply_homography(h, &b).map(|p| (p - c).norm()));
        off.map(|d| d.unwrap_or(f64::INFINITY)).fold(0.0, f64::max) / side_px(m)
    };
    let nearest = |i: usize, count: usize| -> Vec<usize> {
        let at = |k: usize| place_of(placed, found[k].id).map_or_else(Vector2::zeros, |p| p.origin);
        let mut others: Vec<usize> =
            (0..found.len()).filter(|k| *k != i && found[*k].id != found[i].id).collect();
        others.sort_by(|a, b| (at(*a) - at(i)).norm_squared().total_cmp(&(at(*b) - at(i)).norm_squared()));
        others.truncate(count);
        others
    };
    let mut best: Vec<usize> = Vec::new();
    for i in 0..found.len() {
        for count in [3, 1] {
            let chosen = nearest(i, count);
            let members = std::iter::once(i).chain(chosen).map(|k| &found[k]);
            let Some(h) = homography_of(members, placed) else { continue };
            let inliers: Vec<usize> = (0..found.len()).filter(|k| misfit(&h, &found[*k]) < LOOSE).collect();
            if inliers.len() > best.len() {
                best = inliers;
            }
        }
    }
    if best.len() < 2 {
        return Vec::new();
    }
    // Growing from the largest set by neighbours lets a strong lens in that one homography cannot hold.
    loop {
        let before = best.len();
        for i in 0..found.len() {
            if best.contains(&i) || best.iter().any(|b| found[*b].id == found[i].id) {
                continue;
            }
            let around: Vec<usize> =
                nearest(i, found.len()).into_iter().filter(|k| best.contains(k)).take(4).collect();
            let fits = homography_of(around.iter().map(|k| &found[*k]), placed)
                .is_some_and(|h| misfit(&h, &found[i]) < LOOSE);
            if fits {
                best.push(i);
            }
        }
        if best.len() == before {
            break;
        }
    }
    let kept = best.clone();
    if kept.len() >= 4 {
        best.retain(|&i| {
            let around = nearest(i, found.len()).into_iter().filter(|k| kept.contains(k)).take(5);
            homography_of(around.map(|k| &found[k]), placed).is_none_or(|h| misfit(&h, &found[i]) < STRICT)
        });
    }
    best.sort_unstable();
    let mut markers: Vec<Marker> = best.into_iter().map(|i| found[i]).collect();
    markers.dedup_by_key(|m| m.id);
    markers
}

/// Markers that no quadrilateral was seen of, because something lies over their edges: looked for where those around
/// foretell them, again and again from what that finds.
pub(super) fn recover(image: &Luma, markers: &mut Vec<Marker>, board: &CalibrationBoard) {
    /// Markers around that foretell one, and how many there must be.
    const AROUND: usize = 4;
    const LEAST: usize = 2;
    let Some(dictionary) = board.dictionary() else { return };
    let placed = board.markers();
    let reach = placed.iter().map(|p| p.side).fold(0.0, f64::max) * 3.0;
    loop {
        let before = markers.len();
        for place in &placed {
            if markers.iter().any(|m| m.id == place.id) {
                continue;
            }
            let mut around: Vec<(f64, &Marker)> = markers
                .iter()
                .filter_map(|m| Some(((place_of(&placed, m.id)?.origin - place.origin).norm(), m)))
                .filter(|(far, _)| *far < reach)
                .collect();
            around.sort_by(|a, b| a.0.total_cmp(&b.0));
            around.truncate(AROUND);
            if around.len() < LEAST {
                continue;
            }
            let Some(h) = homography_of(around.into_iter().map(|(_, m)| m), &placed) else { continue };
            let corners = place.corners().map(|c| apply_homography(&h, &c));
            let [Some(a), Some(b), Some(c), Some(d)] = corners else { continue };
            markers.extend(confirm(image, &[a, b, c, d], dictionary, place.id, dictionary.correction()));
        }
        if markers.len() == before {
            break;
        }
    }
    markers.sort_by_key(|m| m.id);
}

/// Standard deviations that a corner of a marker may be off: a marker is fitted wherever its pattern can be read,
/// whatever lies over its edges.
const MARKER_SIGMAS: f64 = 3.0;

/// Corners of an ArUco grid board: those of its markers, refined by their edges.
pub(super) fn grid_corners(
    image: &Luma,
    markers: &[Marker],
    board: &CalibrationBoard,
    depth: Depth,
) -> Vec<Corner> {
    let Pattern::ArucoGrid { gap_m, marker_m, dictionary, first_id, .. } = &board.pattern else {
        return Vec::new();
    };
    let cells = dictionary.size() + 2;
    let gap_cells = gap_m / (marker_m / cells as f64);
    let refine = |m: &Marker| match depth {
        Depth::Guiding => Some(*m),
        // Edges with something drawn over them are no lines; the pattern between them is still there.
        Depth::Final => match refine_corners(image, m, cells, gap_cells) {
            Some(edges) => Some(fit_pattern(image, &edges, dictionary, gap_cells).unwrap_or(edges)),
            None => fit_pattern(image, m, dictionary, gap_cells),
        },
    };
    let refined: Vec<Marker> = markers.par_iter().filter_map(refine).collect();
    let mut corners: Vec<Corner> = refined
        .iter()
        .flat_map(|m| (0..4).map(move |k| Corner { id: (m.id - first_id) * 4 + k, at: m.corners[k] }))
        .collect();
    let points = board.corners();
    drop_misfits(&mut corners, &points, marker_m + gap_m, MARKER_SIGMAS);
    // What led two corners of a marker astray led its others, too.
    let left: Vec<usize> = corners.iter().map(|c| c.id / 4).collect();
    corners.retain(|c| left.iter().filter(|m| **m == c.id / 4).count() > 2);
    corners
}

/// Inner corners of a ChArUco board: foretold from the markers around, then fitted as saddles.
pub(super) fn charuco_corners(image: &Luma, markers: &[Marker], board: &CalibrationBoard) -> Vec<Corner> {
    let Pattern::Charuco { columns, square_m, .. } = &board.pattern else { return Vec::new() };
    let placed = board.markers();
    let points = board.corners();
    let mut found: Vec<(Corner, f64)> = Vec::new();
    for (id, point) in points.iter().enumerate() {
        let at = point.xy();
        let mut near: Vec<(f64, &Marker)> = markers
            .iter()
            .filter_map(|m| {
                place_of(&placed, m.id).map(|p| ((p.origin + Vector2::repeat(p.side / 2.0) - at).norm(), m))
            })
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.truncate(4);
        // Further away than its neighbours' neighbours nothing can be foretold well enough.
        let Some((nearest, _)) = near.first() else { continue };
        if *nearest > 1.7 * square_m {
            continue;
        }
        let Some(h) = homography_of(near.iter().map(|(_, m)| *m), &placed) else { continue };
        let image_of = |dx: f64, dy: f64| apply_homography(&h, &(at + Vector2::new(dx, dy) * *square_m));
        let (Some(guess), Some(right), Some(down)) =
            (image_of(0.0, 0.0), image_of(1.0, 0.0), image_of(0.0, 1.0))
        else {
            continue;
        };
        let spacing = (right - guess).norm().min((down - guess).norm());
        // The marker's edge beside the corner must stay out of the fit.
        let Some(saddle) = SaddleFit::new(fit_radius(spacing)).refine(image, guess, (0.3 * spacing).max(1.5))
        else {
            continue;
        };
        let (column, row) = (id % (columns - 1) + 1, id / (columns - 1) + 1);
        let white_down_right = !board.is_black_square(column, row);
        let sign = if white_down_right { 1.0 } else { -1.0 };
        let (Some(a), Some(b)) = (image_of(0.2, 0.2 * sign), image_of(-0.2, -0.2 * sign)) else { continue };
        if !along(saddle.bright, a - b) {
            continue;
        }
        found.push((Corner { id, at: saddle.at }, saddle.strength));
    }
    let mut strengths: Vec<f64> = found.iter().map(|(_, s)| *s).collect();
    strengths.sort_by(f64::total_cmp);
    let weakest = strengths.get(strengths.len() / 2).map_or(0.0, |s| 0.12 * s);
    let mut corners: Vec<Corner> = found.into_iter().filter(|(_, s)| *s > weakest).map(|(c, _)| c).collect();
    drop_misfits(&mut corners, &points, *square_m, MISFIT_SIGMAS);
    corners
}

/// Whether a saddle's bright direction is the one foretold, within 35°.
fn along(bright: f64, direction: Vector2<f64>) -> bool {
    let off = (bright - direction.y.atan2(direction.x)).rem_euclid(std::f64::consts::PI);
    off.min(std::f64::consts::PI - off) < 35f64.to_radians()
}

/// Radius of the saddle fit for squares of `spacing` px: large against noise, small against the next
/// corner and against perspective.
pub(super) fn fit_radius(spacing: f64) -> f64 {
    (0.16 * spacing).clamp(2.5, 5.0)
}
