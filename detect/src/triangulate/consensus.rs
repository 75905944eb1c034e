//! The largest consistent subset of candidates, and all other subsets that agree on a point.
//!
//! Every pair of candidates of two cameras that nearly meets is a seed (as in RANSAC, Fischler & Bolles
//! 1981, but over all pairs instead of random ones, so that nothing is left to chance); each seed gathers
//! in every camera the candidate that fits best, is refined on them, and gathers again until nothing
//! changes (local optimisation, Chum et al. 2003). A pair that an accepted subset already explains is not
//! tried again, so that without outliers one seed is enough.

use nalgebra::{Matrix2, Vector2, Vector3};
use netcord_common::wire::MAX_CAMERAS;

use super::{
    Observation, PosedCamera,
    camera::MIN_DEPTH_M,
    methods::{Refined, middle, refine},
};

/// A camera takes no part.
pub(super) const ABSENT: u16 = u16::MAX;

/// Most subsets that are kept of one trigger.
pub(super) const MAX_SUBSETS: usize = 32;

/// Squared weighted distance, in each view, up to which a candidate belongs to a point: 4.2 standard
/// deviations; of the true ones 1 in 7,000 lies outside.
const GATE: f64 = 18.0;

/// The same for a point that is made from one pair only and may be far off along its rays.
const SEED_GATE: f64 = 8.0 * GATE;

/// Seeds that are followed in one trigger, so that a picture full of look-alikes cannot cost more than
/// about a millisecond. Best-scored pairs come first.
const MAX_SEEDS: usize = 256;

/// Rounds of gathering and refining; nearly always two are enough.
const MAX_ROUNDS: usize = 4;

/// One candidate with what the search needs of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub observation: Observation,
    /// Inverse of the covariance with the slack of the calibration, 1/px²; and the same for residuals in normalised
    /// coordinates.
    gate_information_px: Matrix2<f64>,
    gate_information: Matrix2<f64>,
    /// Bit i: subset i contains it.
    explained: u32,
}

impl Candidate {
    /// `slack_px`: what the calibration may be off by, one standard deviation.
    pub fn new(observation: Observation, slack_px: f64) -> Self {
        let widened = observation.covariance_px2 + Matrix2::identity() * (slack_px * slack_px);
        // Cannot fail: the covariance is positive, and more so with the slack.
        let information = widened.try_inverse().unwrap_or_else(Matrix2::zeros);
        let j = observation.pixel_by_normalised;
        Self {
            observation,
            gate_information_px: information,
            gate_information: j.transpose() * information * j,
            explained: 0,
        }
    }

    /// Inverse of the covariance with the slack of the calibration, 1/px².
    pub const fn gate_information_px(&self) -> &Matrix2<f64> {
        &self.gate_information_px
    }

    pub fn distance2(&self, normalised: &Vector2<f64>) -> f64 {
        let d = normalised - self.observation.normalised;
        d.dot(&(self.gate_information * d))
    }
}

/// Candidates that agree on a point, at most one of each camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Subset {
    /// Index into the candidates, by camera; [`ABSENT`] where none took part.
    pub members: [u16; MAX_CAMERAS],
    /// How many cameras take part.
    pub views: usize,
    /// Sum of the squared distances, weighted with the slack.
    pub distance2: f64,
    /// The refined point.
    pub refined: Refined,
}

/// All candidates of one trigger, in the order of their cameras.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    /// Candidates of camera i: `starts[i]..starts[i + 1]`.
    starts: [u16; MAX_CAMERAS + 1],
}

impl Layout {
    /// Of candidates that are sorted by camera.
    pub fn of(candidates: &[Candidate]) -> Self {
        let mut starts = [0; MAX_CAMERAS + 1];
        for c in candidates {
            starts[c.observation.camera + 1] += 1;
        }
        for i in 0..MAX_CAMERAS {
            starts[i + 1] += starts[i];
        }
        Self { starts }
    }

    pub fn range(&self, camera: usize) -> std::ops::Range<usize> {
        usize::from(self.starts[camera])..usize::from(self.starts[camera + 1])
    }

    fn count(&self, camera: usize) -> usize {
        self.range(camera).len()
    }
}

/// What the search came upon; tells why nothing was found.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Obstacles {
    pub parallel: bool,
    pub behind: bool,
    pub apart: bool,
}

/// Finds all subsets that agree, each reported once to `found`; `accepts` says whether a candidate can
/// belong to a point at that depth (its size against the ball's).
pub(super) fn search(
    cameras: &[PosedCamera],
    candidates: &mut [Candidate],
    accepts: impl Fn(usize, f64) -> bool,
    mut found: impl FnMut(&Subset),
) -> Obstacles {
    let layout = Layout::of(candidates);
    let mut seen = [0_usize; MAX_CAMERAS];
    let mut seen_len = 0;
    for camera in 0..cameras.len().min(MAX_CAMERAS) {
        if layout.count(camera) > 0 {
            seen[seen_len] = camera;
            seen_len += 1;
        }
    }
    let seen = &seen[..seen_len];
    let most = seen.iter().map(|c| layout.count(*c)).max().unwrap_or(0);
    let mut obstacles = Obstacles::default();
    let (mut seeds, mut subsets) = (0, 0);
    // Candidates stand in the order of their scores: ranks that add up to little come first.
    for rank in 0..(2 * most).saturating_sub(1) {
        for (place, &first) in seen.iter().enumerate() {
            for &second in &seen[place + 1..] {
                let (a_range, b_range) = (layout.range(first), layout.range(second));
                for i in rank.saturating_sub(b_range.len() - 1)..=rank.min(a_range.len() - 1) {
                    let (a, b) = (a_range.start + i, b_range.start + rank - i);
                    if candidates[a].explained & candidates[b].explained != 0 {
                        continue;
                    }
                    let Some(point) = seed(cameras, &candidates[a], &candidates[b], &mut obstacles) else {
                        continue;
                    };
                    if seeds == MAX_SEEDS || subsets == MAX_SUBSETS {
                        return obstacles;
                    }
                    seeds += 1;
                    let Some(subset) = grow(cameras, candidates, &layout, seen, point, &accepts) else {
                        obstacles.apart = true;
                        continue;
                    };
                    let members = subset.members.iter().filter(|m| **m != ABSENT).map(|m| usize::from(*m));
                    let shared = members.clone().fold(u32::MAX, |bits, m| bits & candidates[m].explained);
                    if shared != 0 {
                        // The same subset, or a part of one, from another seed.
                        continue;
                    }
                    members.for_each(|m| candidates[m].explained |= 1 << subsets);
                    subsets += 1;
                    found(&subset);
                }
            }
        }
    }
    obstacles
}

/// The middle of two rays, if they nearly meet in front of both cameras.
fn seed(
    cameras: &[PosedCamera],
    a: &Candidate,
    b: &Candidate,
    obstacles: &mut Obstacles,
) -> Option<Vector3<f64>> {
    let (camera_a, camera_b) = (&cameras[a.observation.camera], &cameras[b.observation.camera]);
    let point = middle((&camera_a.centre, &a.observation.ray), (&camera_b.centre, &b.observation.ray));
    let Some(point) = point else {
        obstacles.parallel = true;
        return None;
    };
    let (in_a, in_b) = (camera_a.in_camera(&point), camera_b.in_camera(&point));
    if in_a.z <= MIN_DEPTH_M || in_b.z <= MIN_DEPTH_M {
        obstacles.behind = true;
        return None;
    }
    // The middle splits the distance between the rays, and with it the residual, between both views.
    let near = a.distance2(&(in_a.xy() / in_a.z)) + b.distance2(&(in_b.xy() / in_b.z));
    if near > 3.0 * GATE {
        obstacles.apart = true;
        return None;
    }
    Some(point)
}

fn gather(
    cameras: &[PosedCamera],
    candidates: &[Candidate],
    layout: &Layout,
    seen: &[usize],
    point: &Vector3<f64>,
    gate: f64,
    accepts: &impl Fn(usize, f64) -> bool,
) -> ([u16; MAX_CAMERAS], usize, f64) {
    let mut members = [ABSENT; MAX_CAMERAS];
    let (mut views, mut sum) = (0, 0.0);
    for &camera in seen {
        let p = cameras[camera].in_camera(point);
        if p.z <= MIN_DEPTH_M {
            continue;
        }
        let normalised = p.xy() / p.z;
        let mut best = gate;
        for i in layout.range(camera) {
            let d2 = candidates[i].distance2(&normalised);
            if d2 < best && accepts(i, p.z) {
                best = d2;
                // At most 256 candidates.
                members[camera] = i as u16;
            }
        }
        if members[camera] != ABSENT {
            views += 1;
            sum += best;
        }
    }
    (members, views, sum)
}

/// Copies the members' observations into `buffer`.
pub(super) fn observations_of<'a>(
    candidates: &[Candidate],
    members: &[u16; MAX_CAMERAS],
    buffer: &'a mut [Observation; MAX_CAMERAS],
) -> &'a mut [Observation] {
    let mut count = 0;
    for &m in members.iter().filter(|m| **m != ABSENT) {
        buffer[count] = candidates[usize::from(m)].observation;
        count += 1;
    }
    &mut buffer[..count]
}

fn grow(
    cameras: &[PosedCamera],
    candidates: &[Candidate],
    layout: &Layout,
    seen: &[usize],
    seed: Vector3<f64>,
    accepts: &impl Fn(usize, f64) -> bool,
) -> Option<Subset> {
    let mut buffer = [candidates[0].observation; MAX_CAMERAS];
    let (mut members, mut views, _) = gather(cameras, candidates, layout, seen, &seed, SEED_GATE, accepts);
    let mut point = seed;
    for _ in 0..MAX_ROUNDS {
        if views < 2 {
            return None;
        }
        let refined = refine(cameras, observations_of(candidates, &members, &mut buffer), point)?;
        point = refined.point;
        let (again, count, distance2) = gather(cameras, candidates, layout, seen, &point, GATE, accepts);
        if again == members {
            // Two views share one residual: it is held against the gate as a whole. With more, each view has
            // been held against it.
            let consistent = count > 2 || distance2 <= GATE;
            return consistent.then_some(Subset { members, views: count, distance2, refined });
        }
        (members, views) = (again, count);
    }
    // It swings between two subsets: the last one, as it is.
    if views < 2 {
        return None;
    }
    let refined = refine(cameras, observations_of(candidates, &members, &mut buffer), point)?;
    let distance2 = members
        .iter()
        .filter(|m| **m != ABSENT)
        .map(|m| {
            let c = &candidates[usize::from(*m)];
            let p = cameras[c.observation.camera].in_camera(&refined.point);
            c.distance2(&(p.xy() / p.z))
        })
        .sum::<f64>();
    Some(Subset { members, views, distance2, refined })
}
