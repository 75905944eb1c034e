use nalgebra::{Matrix3, Vector3};
use netcord_common::geometry::{Point, World};

/// The ball's centre at an instant; `World` is the frame that its positions were computed in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedPoint {
    /// Instant, s.
    pub t_s: f64,
    /// Where, m.
    pub at: Point<World>,
}

/// A place where the ball turned upwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounce {
    /// Instant, s.
    pub t_s: f64,
    /// The ball's centre at contact, m.
    pub at: Point<World>,
    /// Standard deviation of its height, m, from how far the points lie off the two paths.
    pub sigma_m: f64,
}

/// Points on each side of a bounce that its paths are fitted to, at most…
const MOST: usize = 8;
/// …and at least: a parabola and one point to check it.
const LEAST: usize = 4;
/// A gap, s, after which a new flight begins.
const GAP_S: f64 = 0.06;
/// Longest path that still is a parabola, whatever the air does, s.
const REACH_S: f64 = 0.1;
/// A contact reverses at least this speed, m/s, downwards before and upwards after.
const LEAST_SPEED_M_S: f64 = 0.4;
/// A fit no better than this, m, is no bounce seen clearly.
const WORST_FIT_M: f64 = 0.02;

/// The bounces in `track` (instants growing), on whatever surface: where parabolas fitted to the points before
/// and after meet. `up` is the direction upwards in the track's frame; without it, that against which the
/// ball's acceleration points.
///
/// Points fewer than four on either side, or within 0.1 s of another bounce, leave one out.
pub fn find_bounces(track: &[TrackedPoint], up: Option<Vector3<f64>>) -> Vec<Bounce> {
    let Some(up) = up.or_else(|| up_from_flight(track)) else { return Vec::new() };
    let height = |p: &TrackedPoint| up.dot(&p.at.coords);
    let mut found: Vec<Bounce> = Vec::new();
    for flight in track.chunk_by(|a, b| b.t_s - a.t_s < GAP_S) {
        for i in 1..flight.len().saturating_sub(1) {
            // The lowest of five: the contact lies before or after it.
            let around = &flight[i.saturating_sub(2)..(i + 3).min(flight.len())];
            if around.iter().any(|p| height(p) < height(&flight[i])) {
                continue;
            }
            // The lowest point itself belongs to one side: to the one that it fits.
            let best = [i, i + 1]
                .into_iter()
                .filter_map(|split| meeting(&flight[..split], &flight[split..], &up))
                .min_by(|a, b| a.sigma_m.total_cmp(&b.sigma_m));
            if let Some(bounce) = best
                && found.last().is_none_or(|f| bounce.t_s - f.t_s > 0.03)
            {
                found.push(bounce);
            }
        }
    }
    found
}

/// Position, velocity and half the acceleration at `t0`, and the RMS of the points about the parabola.
struct Parabola {
    t0: f64,
    terms: [Vector3<f64>; 3],
    rms_m: f64,
}

impl Parabola {
    fn fit(points: &[TrackedPoint], t0: f64) -> Option<Self> {
        let mut normal = Matrix3::<f64>::zeros();
        let mut rhs = Matrix3::<f64>::zeros();
        // Seconds in units of a twentieth, so that the powers are alike in size.
        for p in points {
            let s = (p.t_s - t0) * 20.0;
            let row = Vector3::new(1.0, s, s * s);
            normal += row * row.transpose();
            rhs += row * p.at.coords.transpose();
        }
        let solved = normal.try_inverse()? * rhs;
        let terms = [1.0, 20.0, 400.0];
        let terms = std::array::from_fn(|k| Vector3::from(solved.row(k).transpose()) * terms[k]);
        let mut parabola = Self { t0, terms, rms_m: 0.0 };
        let squares: f64 = points.iter().map(|p| (parabola.at(p.t_s) - p.at.coords).norm_squared()).sum();
        // Three unknowns in each coordinate.
        parabola.rms_m = (squares / (points.len() - 3).max(1) as f64 / 3.0).sqrt();
        Some(parabola)
    }

    fn at(&self, t_s: f64) -> Vector3<f64> {
        let s = t_s - self.t0;
        self.terms[0] + self.terms[1] * s + self.terms[2] * (s * s)
    }

    fn velocity(&self, t_s: f64) -> Vector3<f64> {
        self.terms[1] + self.terms[2] * (2.0 * (t_s - self.t0))
    }
}

fn meeting(before: &[TrackedPoint], after: &[TrackedPoint], up: &Vector3<f64>) -> Option<Bounce> {
    let (last, first) = (before.last()?.t_s, after.first()?.t_s);
    let before = &before[before.len().saturating_sub(MOST)..];
    let before: Vec<_> = before.iter().copied().filter(|p| last - p.t_s < REACH_S).collect();
    let after: Vec<_> = after.iter().copied().take(MOST).filter(|p| p.t_s - first < REACH_S).collect();
    if before.len() < LEAST || after.len() < LEAST {
        return None;
    }
    let middle = 0.5 * (last + first);
    let (down, rise) = (Parabola::fit(&before, middle)?, Parabola::fit(&after, middle)?);
    if down.rms_m.max(rise.rms_m) > WORST_FIT_M {
        return None;
    }
    // Along `up` the difference of the paths grows from below zero before the contact to above it.
    let gap = |t: f64| up.dot(&(rise.at(t) - down.at(t)));
    let slack = 0.3 * (first - last);
    let (mut low, mut high) = (last - slack, first + slack);
    if gap(low) > 0.0 || gap(high) < 0.0 {
        return None;
    }
    for _ in 0..40 {
        let t = 0.5 * (low + high);
        if gap(t) > 0.0 {
            high = t;
        } else {
            low = t;
        }
    }
    let t_s = 0.5 * (low + high);
    let (fall, leap) = (up.dot(&down.velocity(t_s)), up.dot(&rise.velocity(t_s)));
    if fall > -LEAST_SPEED_M_S || leap < LEAST_SPEED_M_S {
        return None;
    }
    let noise = 0.5 * (down.rms_m + rise.rms_m);
    let at = Point::from((down.at(t_s) + rise.at(t_s)) * 0.5);
    // A parabola's end is known about as well as one of its points.
    Some(Bounce { t_s, at, sigma_m: noise.max(2e-4) * 1.5 })
}

/// Against the median acceleration of short stretches: gravity, and of drag what does not cancel.
fn up_from_flight(track: &[TrackedPoint]) -> Option<Vector3<f64>> {
    const STRETCH: usize = 7;
    let mut accelerations: Vec<Vector3<f64>> = track
        .windows(STRETCH)
        .step_by(3)
        .filter(|w| w[STRETCH - 1].t_s - w[0].t_s < STRETCH as f64 * GAP_S / 2.0)
        .filter_map(|w| Parabola::fit(w, w[STRETCH / 2].t_s))
        .map(|p| p.terms[2] * 2.0)
        // A stretch with a contact in it accelerates far more.
        .filter(|a| (3.0..40.0).contains(&a.norm()))
        .collect();
    if accelerations.len() < 3 {
        return None;
    }
    let middle = accelerations.len() / 2;
    let median = Vector3::from_fn(|axis, _| {
        accelerations.sort_by(|a, b| a[axis].total_cmp(&b[axis]));
        accelerations[middle][axis]
    });
    median.try_normalize(1.0).map(|a| -a)
}
