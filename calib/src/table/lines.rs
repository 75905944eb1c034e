//! The table's white lines in a camera's picture, found from a rough pose; and the marks where they cross.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point, Transform},
};

use super::{TABLE_LENGTH_M, TABLE_WIDTH_M, Table};
use crate::detect::{Luma, normal_distribution};

/// Width of the lines along the sides and ends, m (ITTF Laws 2.1.4).
pub const BORDER_LINE_M: f64 = 0.02;
/// How far a line is looked for beside where the rough pose puts it, m on the table.
const REACH_M: f64 = 0.10;
/// Distance of the places along a line at which it is looked for, m.
const PITCH_M: f64 = 0.015;
/// The ends of a line that are left out, m: there others cross it.
const END_M: f64 = 0.06;
/// Fewest places at which a line must be found, and their share of those in the picture.
const LEAST: usize = 12;
const LEAST_SHARE: f64 = 0.25;
/// Furthest that a place may lie off its line, px.
const OFF_PX: f64 = 0.8;
/// Least rise of an edge, grey levels, and in standard deviations of the picture's noise.
const RISE: f64 = 6.0;
const RISE_SIGMAS: f64 = 3.0;
/// Places are taken this far apart along a profile, px.
const STEP_PX: f64 = 0.5;

/// A crossing of two lines, found.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundMark {
    /// Its place as [`super::mark`] takes it.
    pub mark: String,
    /// The same, m in the table frame.
    pub on_table: Vector3<f64>,
    /// Its raw pixel.
    pub at: Vector2<f64>,
    /// Standard deviation of the pixel, from how straight the lines are and how long they were seen, px.
    pub sigma_px: f64,
}

/// A line of the table: what is located is the inner edge of a border line, or the middle line itself.
#[derive(Debug, Clone, Copy)]
struct Line {
    from: Vector2<f64>,
    to: Vector2<f64>,
    /// Direction on the table in which brightness rises, for an edge; nothing for a thin line.
    rises: Option<Vector2<f64>>,
}

/// The inner edges of the four border lines, in the order x−, x+, y−, y+; then the middle line.
fn lines() -> [Line; 5] {
    let (x, y) = (TABLE_WIDTH_M / 2.0 - BORDER_LINE_M, TABLE_LENGTH_M / 2.0 - BORDER_LINE_M);
    let line = |from: (f64, f64), to: (f64, f64), rises: Option<(f64, f64)>| Line {
        from: Vector2::new(from.0, from.1),
        to: Vector2::new(to.0, to.1),
        rises: rises.map(|r| Vector2::new(r.0, r.1)),
    };
    [
        line((-x, -y), (-x, y), Some((-1.0, 0.0))),
        line((x, -y), (x, y), Some((1.0, 0.0))),
        line((-x, -y), (x, -y), Some((0.0, -1.0))),
        line((-x, y), (x, y), Some((0.0, 1.0))),
        line((0.0, -y), (0.0, y), None),
    ]
}

/// Finds the inner corners of the border lines and the ends of the middle line in `image`, from a pose that puts
/// the lines within some eight centimetres of where they are. Each line is located at many places as an edge (or, the
/// middle line, as a ridge), the line that most of them agree on is fitted in the undistorted picture, where it is
/// straight; what crosses where follows from the lines as a whole, so that a player or the net may cover parts.
/// Lines of which too little is seen give no marks.
pub fn find_marks(
    image: &Luma,
    model: &CameraModel,
    camera_from_table: &Transform<Camera, Table>,
) -> Vec<FoundMark> {
    let view = View { image, model, camera_from_table, least: RISE.max(RISE_SIGMAS * image.noise()) };
    let all = lines();
    let fitted = all.map(|line| view.fit(&line));
    let pairs = [(0, 2), (1, 2), (1, 3), (0, 3), (4, 2), (4, 3)];
    pairs
        .into_iter()
        .filter_map(|(a, b)| {
            let on_table = Vector2::new(all[a].from.x, all[b].from.y);
            view.crossing(fitted[a].as_ref()?, fitted[b].as_ref()?, on_table)
        })
        .collect()
}

/// A picture of the table.
struct View<'a> {
    image: &'a Luma,
    model: &'a CameraModel,
    camera_from_table: &'a Transform<Camera, Table>,
    /// Least rise of an edge, grey levels.
    least: f64,
}

/// A line in the undistorted picture: n · p = distance, n of unit length.
struct Fitted {
    normal: Vector2<f64>,
    distance: f64,
    /// Middle of the places it was fitted to, the mean square of their offsets along the line, and their number.
    middle: Vector2<f64>,
    spread: f64,
    count: f64,
    /// Standard deviation of one place, in units of the undistorted picture.
    sigma: f64,
}

impl Fitted {
    /// Standard deviation of the line at `p`, in units of the undistorted picture.
    fn sigma_at(&self, p: &Vector2<f64>) -> f64 {
        let along = (p - self.middle).perp(&self.normal);
        self.sigma * ((1.0 + along * along / self.spread.max(1e-12)) / self.count).sqrt()
    }
}

impl View<'_> {
    fn project(&self, on_table: &Vector2<f64>) -> Option<Vector2<f64>> {
        let at = self.camera_from_table * Point::new(on_table.x, on_table.y, 0.0);
        self.model.project(&at).filter(|p| self.model.contains(p))
    }

    /// The line that most places agree on; `None` where too few do.
    fn fit(&self, line: &Line) -> Option<Fitted> {
        let length = (line.to - line.from).norm();
        let along = (line.to - line.from) / length;
        let places = ((length - 2.0 * END_M) / PITCH_M) as usize;
        let (mut seen, mut in_picture) = (Vec::new(), 0usize);
        for k in 0..=places {
            let on_table = line.from + along * (END_M + k as f64 * PITCH_M);
            let Some(found) = self.candidates(line, &on_table, &along) else { continue };
            in_picture += 1;
            seen.extend(found.into_iter().filter_map(|p| Some((k, self.model.undistort(&p)?))));
        }
        let least = LEAST.max((LEAST_SHARE * in_picture as f64) as usize);
        let off = OFF_PX / self.model.fx;
        let best = agreed(&seen, off).filter(|b| b.len() >= least)?;
        straight(&best, off)
    }

    /// Raw pixels beside a place of the line where the edge or ridge may be; `None` where that is not in the picture.
    fn candidates(
        &self,
        line: &Line,
        on_table: &Vector2<f64>,
        along: &Vector2<f64>,
    ) -> Option<Vec<Vector2<f64>>> {
        let across = line.rises.unwrap_or_else(|| Vector2::new(-along.y, along.x));
        let (here, ahead) = (self.project(on_table)?, self.project(&(on_table + along * 0.01))?);
        let beside = self.project(&(on_table + across * 0.01))?;
        let direction = (ahead - here).normalize();
        // Across the line in the picture, towards the same side.
        let normal = Vector2::new(-direction.y, direction.x);
        let px_per_m = (beside - here).dot(&normal) / 0.01;
        let normal = normal * px_per_m.signum();
        let px_per_m = px_per_m.abs();
        let reach = (REACH_M * px_per_m).max(4.0);
        let steps = (reach / STEP_PX).ceil() as i32;
        let profile: Option<Vec<f64>> = (-steps..=steps)
            .map(|i| {
                let p = here + normal * (f64::from(i) * STEP_PX);
                self.image.sample(p.x, p.y)
            })
            .collect();
        let profile = profile?;
        let response = match line.rises {
            Some(_) => edge_response(&profile),
            // The middle line is 3 mm wide: its blur decides how wide it looks.
            None => ridge_response(&profile, ((0.004 * px_per_m / STEP_PX).round() as usize).max(4)),
        };
        let width = BORDER_LINE_M * px_per_m / STEP_PX;
        let peaks = peaks(&response, self.least).into_iter().map(|i| match line.rises {
            Some(_) => line_edge(&profile, i, width).unwrap_or(i),
            None => i,
        });
        Some(peaks.map(|i| here + normal * ((i - f64::from(steps)) * STEP_PX)).collect())
    }

    fn crossing(&self, a: &Fitted, b: &Fitted, on_table: Vector2<f64>) -> Option<FoundMark> {
        let rows = Matrix2::from_rows(&[a.normal.transpose(), b.normal.transpose()]);
        let inverse = rows.try_inverse()?;
        let n = inverse * Vector2::new(a.distance, b.distance);
        let at = self.model.project(&Point::<Camera>::new(n.x, n.y, 1.0))?;
        // Only what is in the picture can be looked at.
        self.model.contains(&at).then_some(())?;
        let scatter = inverse * Vector2::new(a.sigma_at(&n), 0.0);
        let scatter = scatter.norm().hypot((inverse * Vector2::new(0.0, b.sigma_at(&n))).norm());
        Some(FoundMark {
            mark: format!("{}/{}", round(on_table.x), round(on_table.y)),
            on_table: on_table.push(0.0),
            at,
            sigma_px: scatter * self.model.fx,
        })
    }
}

/// To tenths of a millimetre, for names.
fn round(v: f64) -> f64 {
    (v * 1e4).round() / 1e4 + 0.0
}

/// How much brighter it gets along the profile, over two pixels.
fn edge_response(profile: &[f64]) -> Vec<f64> {
    const HALF: usize = 2;
    let n = profile.len();
    (0..n)
        .map(|i| if i < HALF || i + HALF >= n { 0.0 } else { profile[i + HALF] - profile[i - HALF] })
        .collect()
}

/// How much brighter it is than on either side, `apart` places away.
fn ridge_response(profile: &[f64], apart: usize) -> Vec<f64> {
    let n = profile.len();
    let at = |i: usize| {
        if i < apart || i + apart >= n {
            0.0
        } else {
            profile[i] - profile[i - apart].max(profile[i + apart])
        }
    };
    (0..n).map(at).collect()
}

/// Places of the maxima above `least`, each as the parabola through its neighbourhood has it.
fn peaks(response: &[f64], least: f64) -> Vec<f64> {
    (1..response.len().saturating_sub(1))
        .filter(|&i| response[i] > least && response[i] >= response[i - 1] && response[i] > response[i + 1])
        .map(|i| {
            // The centroid of what stands above half the peak: less moved by noise than its top.
            let half = 0.5 * response[i];
            let first = (0..=i).rev().take_while(|k| response[*k] > half).last().unwrap_or(i);
            let last = (i..response.len()).take_while(|k| response[*k] > half).last().unwrap_or(i);
            let (mut sum, mut moment) = (0.0, 0.0);
            for (k, r) in response.iter().enumerate().take(last + 1).skip(first) {
                sum += r - half;
                moment += (r - half) * k as f64;
            }
            if sum > 0.0 { moment / sum } else { i as f64 }
        })
        .collect()
}

/// Where a line of `width` places begins, whose inner edge was found near `start`: the least squares of
/// L + A Φ((x − x₀) / σ) − B Φ((x − x₀ − width) / σ) by x₀, σ and the levels. Far away the line is narrower than its
/// blur, and the far edge would move the maximum of the slope. `None` where the profile shows no such line.
fn line_edge(profile: &[f64], start: f64, width: f64) -> Option<f64> {
    /// Places beside the line that are looked at, and how far its edge may move.
    const BESIDE: f64 = 6.0;
    const MOVED: f64 = 3.0;
    let first = (start - BESIDE).max(0.0).ceil() as usize;
    let last = ((start + width + BESIDE) as usize).min(profile.len() - 1);
    let (mut at, mut sigma) = (start, 2.0_f64);
    let mut levels = [profile[first], 1.0, 1.0];
    for round in 0..12 {
        let mut normal = SMatrix::<f64, 5, 5>::zeros();
        let mut rhs = SVector::<f64, 5>::zeros();
        for (x, value) in profile.iter().enumerate().take(last + 1).skip(first) {
            let z = [x as f64 - at, x as f64 - at - width].map(|d| d / sigma);
            let [(rise, slope), (fall, descent)] = z.map(normal_distribution);
            let [level, a, b] = levels;
            let row = SVector::<f64, 5>::from([
                1.0,
                rise,
                -fall,
                (b * descent - a * slope) / sigma,
                b * descent * z[1] - a * slope * z[0],
            ]);
            normal += row * row.transpose();
            rhs += row * (value - (level + a * rise - b * fall));
        }
        for i in 0..5 {
            normal[(i, i)] *= 1.0 + 1e-6;
        }
        // The levels first, then all; a line much narrower than its blur leaves that where it was.
        normal[(4, 4)] += 100.0;
        if round == 0 {
            (normal[(3, 3)], normal[(4, 4)]) = (1e12, 1e12);
        }
        let step = normal.cholesky()?.solve(&rhs);
        levels.iter_mut().zip(step.iter()).for_each(|(level, s)| *level += s);
        at += step[3].clamp(-1.0, 1.0);
        sigma *= step[4].clamp(-0.3, 0.3).exp();
        if (at - start).abs() > MOVED || !(0.4..8.0).contains(&sigma) {
            return None;
        }
        if round > 0 && step[3].abs() < 1e-3 {
            return (levels[1] > 0.0).then_some(at);
        }
    }
    None
}

/// The largest set of places on one line, at most one of each number: tried are the lines through pairs of places
/// far apart.
fn agreed(seen: &[(usize, Vector2<f64>)], off: f64) -> Option<Vec<Vector2<f64>>> {
    /// Lines tried at most.
    const TRIALS: usize = 3000;
    let last = seen.last()?.0;
    let (early, late): (Vec<_>, Vec<_>) =
        seen.iter().copied().partition::<Vec<(usize, Vector2<f64>)>, _>(|(k, _)| 2 * k < last);
    let stride = (early.len() * late.len()).div_ceil(TRIALS).max(1);
    let inliers = |normal: &Vector2<f64>, distance: f64| -> Vec<Vector2<f64>> {
        let mut nearest: Vec<(usize, f64, Vector2<f64>)> = Vec::new();
        for (k, p) in seen {
            let away = (normal.dot(p) - distance).abs();
            match nearest.last_mut() {
                Some(best) if best.0 == *k => {
                    if away < best.1 {
                        *best = (*k, away, *p);
                    }
                }
                _ => nearest.push((*k, away, *p)),
            }
        }
        nearest.into_iter().filter(|(_, away, _)| *away < off).map(|(_, _, p)| p).collect()
    };
    let pairs = early.iter().flat_map(|a| late.iter().map(move |b| (a.1, b.1)));
    let mut best: Vec<Vector2<f64>> = Vec::new();
    for (a, b) in pairs.step_by(stride) {
        let Some(along) = (b - a).try_normalize(1e-9) else { continue };
        let normal = Vector2::new(-along.y, along.x);
        let found = inliers(&normal, normal.dot(&a));
        if found.len() > best.len() {
            best = found;
        }
    }
    (!best.is_empty()).then_some(best)
}

/// The line of least squared distance through places, those further than `off` from it left out.
fn straight(places: &[Vector2<f64>], off: f64) -> Option<Fitted> {
    let mut kept = places.to_vec();
    let mut fitted = None;
    for _ in 0..3 {
        let count = kept.len() as f64;
        if count < 3.0 {
            return None;
        }
        let middle = kept.iter().sum::<Vector2<f64>>() / count;
        let moments: Matrix2<f64> = kept.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
        let eigen = moments.symmetric_eigen();
        let least = usize::from(eigen.eigenvalues[1] < eigen.eigenvalues[0]);
        let normal: Vector2<f64> = eigen.eigenvectors.column(least).into();
        let distance = normal.dot(&middle);
        fitted = Some(Fitted {
            normal,
            distance,
            middle,
            spread: eigen.eigenvalues[1 - least] / count,
            count,
            sigma: (eigen.eigenvalues[least].max(0.0) / (count - 2.0)).sqrt(),
        });
        kept.retain(|p| (normal.dot(p) - distance).abs() < off);
    }
    fitted
}
