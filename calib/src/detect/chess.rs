//! Candidates for chessboard corners: saddles whose surroundings are four sectors, dark and bright by turns.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector2;

use super::{luma::Luma, saddle::SaddleFit};

/// A candidate.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub at: Vector2<f64>,
    pub strength: f64,
    /// Directions of the four edges, increasing, in [0, 2π); `rising[k]`: whether it gets brighter across
    /// edge k with growing angle. Opposite edges are of one kind, neighbours of the other.
    pub edges: [f64; 4],
    pub rising: [bool; 4],
}

/// Distance of the taps of the second differences, in px.
const TAP: usize = 2;
/// Half the window in which a saddle must be the largest, in px.
const SUPPRESS: usize = 3;
/// Most candidates that go on, the strongest.
pub(super) const MOST: usize = 2500;

/// Candidates in the picture, strongest first.
pub(super) fn candidates(image: &Luma, most: usize) -> Vec<Candidate> {
    let noise = image.noise();
    let smooth = image.binomial().binomial();
    let (w, h) = (smooth.width(), smooth.height());
    let border = TAP + SUPPRESS + 1;
    if w < 2 * border + 1 || h < 2 * border + 1 {
        return Vec::new();
    }
    // Two binomials leave 0.27 of the noise; a second difference has six times its variance.
    let least = (4.0 * 0.27 * noise * 6f64.sqrt()).max(8.0);
    let least = (least * least) as i32;
    let mut response = vec![0i32; w * h];
    for y in TAP..h - TAP {
        let (up, here, down) = (smooth.row(y - TAP), smooth.row(y), smooth.row(y + TAP));
        let out = &mut response[y * w..(y + 1) * w];
        for x in TAP..w - TAP {
            let v = |row: &[u8], x: usize| i32::from(row[x]);
            let twice = 2 * v(here, x);
            let xx = v(here, x - TAP) + v(here, x + TAP) - twice;
            let yy = v(up, x) + v(down, x) - twice;
            let xy = v(down, x + TAP) - v(down, x - TAP) - v(up, x + TAP) + v(up, x - TAP);
            // −det of the Hessian, the mixed difference being four times as large.
            out[x] = xy * xy / 16 - xx * yy;
        }
    }
    let mut peaks: Vec<(i32, usize, usize)> = Vec::new();
    for y in border..h - border {
        for x in border..w - border {
            let r = response[y * w + x];
            if r < least {
                continue;
            }
            let beaten = (y - SUPPRESS..=y + SUPPRESS).any(|v| {
                response[v * w + x - SUPPRESS..=v * w + x + SUPPRESS]
                    .iter()
                    .enumerate()
                    .any(|(i, o)| *o > r || *o == r && (v, x - SUPPRESS + i) < (y, x))
            });
            if !beaten {
                peaks.push((r, x, y));
            }
        }
    }
    peaks.sort_unstable_by(|a, b| b.cmp(a));
    // Texture must not crowd out the board: a corner of it is seldom below a hundredth of the strongest.
    peaks.truncate(3 * most);
    let fit = SaddleFit::new(3.0);
    let mut found: Vec<Candidate> = peaks
        .iter()
        .filter_map(|&(_, x, y)| {
            let saddle = fit.refine(&smooth, Vector2::new(x as f64, y as f64), 2.5)?;
            [4.0, 2.8, 6.0]
                .iter()
                .find_map(|radius| sectors(&smooth, saddle.at, *radius, 2.0 * 0.27 * noise))
                .map(|(edges, rising)| Candidate { at: saddle.at, strength: saddle.strength, edges, rising })
        })
        .collect();
    found.truncate(most);
    found
}

/// Whether the surroundings of `at`, on a circle of `radius` px, are four sectors. `noise` is the image's.
pub(super) fn is_corner(image: &Luma, at: Vector2<f64>, radius: f64, noise: f64) -> bool {
    sectors(image, at, radius, 2.0 * noise).is_some()
}

/// Samples on the circle.
const SAMPLES: usize = 32;

/// The edges around `centre` on a circle of `radius` px, if brightness there crosses its middle exactly
/// four times and looks the same turned by half.
fn sectors(image: &Luma, centre: Vector2<f64>, radius: f64, noise: f64) -> Option<([f64; 4], [bool; 4])> {
    let mut v = [0.0; SAMPLES];
    for (i, v) in v.iter_mut().enumerate() {
        let angle = TAU * i as f64 / SAMPLES as f64;
        *v = image.sample(centre.x + radius * angle.cos(), centre.y + radius * angle.sin())?;
    }
    // Middle of the range, not the mean: at skew views one pair of sectors is far wider.
    let (low, high) = v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    if high - low < 10.0 + 2.0 * noise {
        return None;
    }
    let middle = 0.5 * (low + high);
    let d = v.map(|v| v - middle);
    let power: f64 = d.iter().map(|d| d * d).sum();
    let half_turned: f64 = (0..SAMPLES).map(|i| d[i] * d[(i + SAMPLES / 2) % SAMPLES]).sum();
    if half_turned < 0.55 * power {
        return None;
    }
    let mut edges = [0.0; 4];
    let mut rising = [false; 4];
    let mut count = 0;
    for i in 0..SAMPLES {
        let (a, b) = (d[i], d[(i + 1) % SAMPLES]);
        if (a < 0.0) == (b < 0.0) {
            continue;
        }
        if count == 4 {
            return None;
        }
        edges[count] = TAU * (i as f64 + a / (a - b)) / SAMPLES as f64;
        rising[count] = a < 0.0;
        count += 1;
    }
    if count != 4 {
        return None;
    }
    // Opposite edges form one line.
    for k in 0..2 {
        let bend = turn(edges[k] + PI, edges[k + 2]);
        if bend.abs() > 0.6 {
            return None;
        }
        let middle = edges[k] + 0.5 * turn(edges[k] + PI, edges[k + 2]);
        (edges[k], edges[k + 2]) = (middle, middle + PI);
    }
    Some((edges, rising))
}

/// The angle from `a` to `b`, in (−π, π].
pub(super) fn turn(a: f64, b: f64) -> f64 {
    let t = (b - a).rem_euclid(TAU);
    if t > PI { t - TAU } else { t }
}
