//! Watches the residuals of each pair of cameras, and names a camera that no longer fits the rig.

use netcord_common::wire::MAX_CAMERAS;

use super::{Observation, PosedCamera, camera::MIN_DEPTH_M, consensus::Candidate, methods::middle};

/// Sightings over which a pair's mean is taken: half a second at 100 Hz.
const MEMORY: f64 = 50.0;

/// Sightings of a pair before anything is said of it.
const ENOUGH: u32 = 100;

/// Mean absolute residual of a pair, in standard deviations of detection and calibration, from which on
/// the pair does not fit. The mean of a pair that fits is 0.8; with the usual slack of 0.75 px this is
/// an epipolar error of about 3 px.
const UNFIT: f64 = 2.5;

/// Below this a pair fits again.
const FIT: f64 = 1.5;

/// A single sighting counts at most this much: a wrong association is no evidence of a knock.
const CUT: f64 = 8.0;

#[derive(Debug, Clone, Copy, Default)]
struct Pair {
    mean: f64,
    sightings: u32,
    unfit: bool,
}

/// The watch.
#[derive(Debug, Clone)]
pub struct RigWatch {
    pairs: [[Pair; MAX_CAMERAS]; MAX_CAMERAS],
    distrusted: u32,
    slack_px: f64,
}

impl RigWatch {
    pub(super) fn new(slack_px: f64) -> Self {
        Self { pairs: [[Pair::default(); MAX_CAMERAS]; MAX_CAMERAS], distrusted: 0, slack_px }
    }

    /// Bit i: camera i no longer fits the others.
    pub const fn distrusted(&self) -> u32 {
        self.distrusted
    }

    /// Mean absolute residual of a pair, in standard deviations of detection and calibration (0.8 where
    /// the calibration holds); `None` before enough was seen.
    pub fn pair(&self, a: usize, b: usize) -> Option<f64> {
        let pair = &self.pairs[a.min(b)][a.max(b)];
        (pair.sightings >= ENOUGH).then_some(pair.mean)
    }

    /// The pairs that do not fit, first camera first.
    pub fn unfit_pairs(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        (0..MAX_CAMERAS)
            .flat_map(|a| (a + 1..MAX_CAMERAS).map(move |b| (a, b)))
            .filter(|(a, b)| self.pairs[*a][*b].unfit)
    }

    /// Takes note of where the cameras saw the same ball.
    pub(super) fn see(&mut self, cameras: &[PosedCamera], observations: &[Observation]) {
        for (i, a) in observations.iter().enumerate() {
            for b in &observations[i + 1..] {
                let Some(distance) = self.distance(cameras, a, b) else { continue };
                let pair = &mut self.pairs[a.camera.min(b.camera)][a.camera.max(b.camera)];
                pair.sightings = pair.sightings.saturating_add(1);
                let weight = (1.0 / f64::from(pair.sightings)).max(1.0 / MEMORY);
                pair.mean += weight * (distance.min(CUT) - pair.mean);
                if pair.sightings >= ENOUGH {
                    pair.unfit = pair.mean > if pair.unfit { FIT } else { UNFIT };
                }
            }
        }
        self.judge();
    }

    /// Distance of two rays, in standard deviations.
    fn distance(&self, cameras: &[PosedCamera], a: &Observation, b: &Observation) -> Option<f64> {
        let (camera_a, camera_b) = (&cameras[a.camera], &cameras[b.camera]);
        let point = middle((&camera_a.centre, &a.ray), (&camera_b.centre, &b.ray))?;
        let (in_a, in_b) = (camera_a.in_camera(&point), camera_b.in_camera(&point));
        if in_a.z <= MIN_DEPTH_M || in_b.z <= MIN_DEPTH_M {
            return Some(CUT);
        }
        let near = Candidate::new(*a, self.slack_px).distance2(&(in_a.xy() / in_a.z))
            + Candidate::new(*b, self.slack_px).distance2(&(in_b.xy() / in_b.z));
        Some(near.sqrt())
    }

    /// Takes out, one by one, the camera that most unfit pairs share, as long as it is alone in that; a
    /// single unfit pair accuses nobody.
    fn judge(&mut self) {
        self.distrusted = 0;
        loop {
            let count = |camera: usize| {
                self.unfit_pairs()
                    .filter(|(a, b)| *a == camera || *b == camera)
                    .filter(|(a, b)| self.distrusted & (1 << a | 1 << b) == 0)
                    .count()
            };
            let mut worst = (0, 0);
            let mut second = 0;
            for camera in 0..MAX_CAMERAS {
                let unfit = count(camera);
                if unfit > worst.1 {
                    second = worst.1;
                    worst = (camera, unfit);
                } else {
                    second = second.max(unfit);
                }
            }
            if worst.1 < 2 || second == worst.1 {
                return;
            }
            self.distrusted |= 1 << worst.0;
        }
    }
}
