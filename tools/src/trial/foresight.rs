//! What was foreseen, held against what came: where the ball crossed the hitting plane, and where it landed.

use nalgebra::{Vector2, Vector3};
use netcord_common::wire::{BallTrajectory, BallTruth, LandingKind};
use serde::Serialize;

/// How long before the ball crosses the hitting plane its place there is asked for, s.
const HITTING_LEAD_S: f64 = 0.3;
/// How long before it lands its landing point is asked for, s.
const LANDING_LEAD_S: f64 = 0.15;
/// A flight that has lasted for less has not shown where it goes, s.
const LEAST_SEEN_S: f64 = 0.1;
/// Height of the ball's centre on the table, m.
const RADIUS_M: f64 = 0.02;
/// Above this height a turn upwards is a racket's, m.
const BOUNCE_BELOW_M: f64 = 0.1;

/// Errors of predictions of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ForesightErrors {
    /// How long before the event it was asked for, s.
    pub lead_s: f64,
    /// Median distance, mm, in which a prediction that was not made counts as infinitely far; absent where
    /// the median is one of these, or nothing was asked.
    pub median_mm: Option<f64>,
    /// 90 % of the distances, mm; absent likewise.
    pub p90_mm: Option<f64>,
    /// Events.
    pub n: usize,
    /// Events for which nothing was predicted.
    pub missing: usize,
}

impl ForesightErrors {
    fn of(lead_s: f64, mut errors_m: Vec<f64>) -> Self {
        errors_m.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let last = errors_m.len().checked_sub(1)?;
            Some(errors_m[(share * last as f64).round() as usize] * 1e3).filter(|e| e.is_finite())
        };
        Self {
            lead_s,
            median_mm: at(0.5),
            p90_mm: at(0.9),
            n: errors_m.len(),
            missing: errors_m.iter().filter(|e| e.is_infinite()).count(),
        }
    }
}

/// Collects truth and trajectories, and compares at the end.
#[derive(Debug, Default)]
pub struct Foresight {
    truths: Vec<Truth>,
    said: Vec<Said>,
}

#[derive(Debug, Clone, Copy)]
struct Truth {
    t_ns: u64,
    flight_id: u64,
    position: Vector3<f64>,
    velocity: Vector3<f64>,
}

/// What one trajectory says of the future.
#[derive(Debug, Clone, Copy)]
struct Said {
    t_ns: u64,
    crossing: Option<Vector3<f64>>,
    landing: Option<Vector2<f64>>,
}

/// Something that happened to the ball.
#[derive(Debug, Clone, Copy)]
struct Event {
    t_ns: u64,
    place: Vector3<f64>,
    /// When its flight began.
    began_ns: u64,
}

impl Foresight {
    /// Takes in what is true of a trigger.
    pub fn truth(&mut self, truth: &BallTruth) {
        if truth.present == 1 {
            self.truths.push(Truth {
                t_ns: truth.mid_exposure_ns,
                flight_id: truth.flight_id,
                position: truth.position_m.into(),
                velocity: truth.velocity_m_s.into(),
            });
        }
    }

    /// Takes in what was predicted at a trigger.
    pub fn trajectory(&mut self, trajectory: &BallTrajectory) {
        let (crossing, landing) = (&trajectory.crossing, &trajectory.landing);
        let lands = landing.t_ns != 0 && landing.kind != LandingKind::None.code();
        self.said.push(Said {
            t_ns: trajectory.stamps.mid_exposure_ns,
            crossing: (crossing.t_ns != 0).then(|| crossing.position_m.into()),
            landing: lands.then(|| landing.position_m.into()),
        });
    }

    /// Errors at the plane y = `plane_y_m`, of the crossings from `from_ns` to before `to_ns`.
    pub fn hitting_errors(&self, plane_y_m: f64, from_ns: u64, to_ns: u64) -> ForesightErrors {
        let crossings = self.events(from_ns, to_ns, |a, b| {
            let (before, after) = (a.position.y - plane_y_m, b.position.y - plane_y_m);
            (before * after < 0.0).then(|| before / (before - after))
        });
        let errors =
            self.errors(crossings, HITTING_LEAD_S, |said, place| Some((said.crossing? - place).norm()));
        ForesightErrors::of(HITTING_LEAD_S, errors)
    }

    /// Errors of the landing points on the table, of the bounces from `from_ns` to before `to_ns`.
    pub fn landing_errors(&self, from_ns: u64, to_ns: u64) -> ForesightErrors {
        let bounces = self.events(from_ns, to_ns, |a, b| {
            let turns = a.velocity.z < 0.0 && b.velocity.z > 0.0 && a.position.z < BOUNCE_BELOW_M;
            let step_s = (b.t_ns - a.t_ns) as f64 * 1e-9;
            // Falling at nearly constant speed down to the table, within one interval.
            turns.then(|| ((a.position.z - RADIUS_M) / -a.velocity.z / step_s).clamp(0.0, 1.0))
        });
        let bounces = bounces.map(|(event, before)| {
            // A bounce bends the path between the two truths: from the one before it.
            let after_s = (event.t_ns - before.t_ns) as f64 * 1e-9;
            (Event { place: before.position + before.velocity * after_s, ..event }, before)
        });
        let errors =
            self.errors(bounces, LANDING_LEAD_S, |said, place| Some((said.landing? - place.xy()).norm()));
        ForesightErrors::of(LANDING_LEAD_S, errors)
    }

    /// Events between consecutive truths of one flight: `share` says whether there is one, and after which
    /// share of the interval. With the truth before.
    fn events(
        &self,
        from_ns: u64,
        to_ns: u64,
        share: impl Fn(&Truth, &Truth) -> Option<f64>,
    ) -> impl Iterator<Item = (Event, Truth)> {
        let mut began_ns = 0;
        let mut flight_id = 0;
        self.truths.windows(2).filter_map(move |pair| {
            let [a, b] = pair else { return None };
            if a.flight_id != flight_id {
                (flight_id, began_ns) = (a.flight_id, a.t_ns);
            }
            if a.flight_id != b.flight_id {
                return None;
            }
            let share = share(a, b)?;
            let t_ns = a.t_ns + ((b.t_ns - a.t_ns) as f64 * share) as u64;
            let place = a.position + (b.position - a.position) * share;
            (from_ns..to_ns).contains(&t_ns).then_some((Event { t_ns, place, began_ns }, *a))
        })
    }

    /// Distances from what was said `lead_s` before each event; infinite where nothing was.
    fn errors(
        &self,
        events: impl Iterator<Item = (Event, Truth)>,
        lead_s: f64,
        distance: impl Fn(&Said, &Vector3<f64>) -> Option<f64>,
    ) -> Vec<f64> {
        let (lead_ns, least_ns) = ((lead_s * 1e9) as u64, (LEAST_SEEN_S * 1e9) as u64);
        events
            .filter_map(|(event, _)| {
                let asked_ns = event.t_ns.checked_sub(lead_ns)?;
                if asked_ns < event.began_ns + least_ns {
                    return None;
                }
                let newest = self.said.iter().filter(|s| s.t_ns <= asked_ns).max_by_key(|s| s.t_ns);
                // What was said of the flight before is not about this event.
                let newest = newest.filter(|s| s.t_ns >= event.began_ns);
                Some(newest.and_then(|s| distance(s, &event.place)).unwrap_or(f64::INFINITY))
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: u64 = 10_000_000;

    /// A ball that flies along −y at 5 m/s, falls at 2 m/s from 0.52 m, and rises as fast after its bounce.
    fn truth(k: u64) -> BallTruth {
        let t = k as f64 * 0.01;
        let (z, rate) = if t < 0.25 { (0.52 - 2.0 * t, -2.0) } else { (0.02 + 2.0 * (t - 0.25), 2.0) };
        BallTruth {
            trigger_id: k,
            mid_exposure_ns: k * STEP_NS,
            flight_id: 1,
            position_m: [0.1, 1.0 - 5.0 * t, z],
            velocity_m_s: [0.0, -5.0, rate],
            present: 1,
            ..BallTruth::default()
        }
    }

    fn said(k: u64, crossing: [f64; 3], landing: [f64; 2]) -> BallTrajectory {
        let mut trajectory = BallTrajectory::default();
        trajectory.stamps.mid_exposure_ns = k * STEP_NS;
        (trajectory.crossing.t_ns, trajectory.crossing.position_m) = (1, crossing);
        trajectory.landing.t_ns = 1;
        trajectory.landing.position_m = landing;
        trajectory.landing.kind = LandingKind::FarSide.code();
        trajectory
    }

    #[test]
    fn errors_are_those_of_what_was_said_in_time() {
        let mut foresight = Foresight::default();
        for k in 0..=60 {
            foresight.truth(&truth(k));
            // The plane y = −1.502 is crossed at 0.5004 s, 0.5208 m high; asked for at 0.2 s.
            let crossing = if k <= 20 { [0.1, -1.502, 0.5308] } else { [0.1, -1.502, 0.5208] };
            // It lands at y = −0.25 after 0.25 s; asked for at 0.1 s.
            let landing = if k <= 10 { [0.1, -0.245] } else { [0.1, -0.25] };
            foresight.trajectory(&said(k, crossing, landing));
        }
        let hitting = foresight.hitting_errors(-1.502, 0, u64::MAX);
        assert_eq!((hitting.n, hitting.missing), (1, 0));
        assert!((hitting.median_mm.expect("one crossing") - 10.0).abs() < 0.1, "{hitting:?}");
        let landing = foresight.landing_errors(0, u64::MAX);
        assert_eq!((landing.n, landing.missing), (1, 0));
        assert!((landing.median_mm.expect("one bounce") - 5.0).abs() < 0.1, "{landing:?}");
        assert_eq!(foresight.hitting_errors(-1.502, 0, 400_000_000).n, 0, "outside of what is judged");
    }

    #[test]
    fn silence_counts_as_infinitely_far() {
        let mut foresight = Foresight::default();
        for k in 0..=60 {
            foresight.truth(&truth(k));
            foresight.trajectory(&BallTrajectory::default());
        }
        let hitting = foresight.hitting_errors(-1.502, 0, u64::MAX);
        assert_eq!((hitting.n, hitting.missing, hitting.median_mm), (1, 1, None));
    }
}
