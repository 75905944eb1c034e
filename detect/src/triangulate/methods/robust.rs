use netcord_common::{
    geometry::{Point, World},
    wire::{MAX_CAMERAS, MethodCode, NoPosition},
};

use super::{Method, at_least_two};
use crate::triangulate::{
    Estimate, Observation, PosedCamera,
    consensus::{Candidate, Obstacles, Subset, observations_of, search},
};

/// The largest subset of views that agree on one point, then the least reprojection error on it (the
/// approach of Gomez-Gonzalez et al., Robotics 8(4) 90, 2019, with every pair tried and each subset
/// refined).
#[derive(Debug, Clone, Copy)]
pub struct Robust {
    slack_px: f64,
}

impl Robust {
    /// `slack_px`: what the calibration may be off by, one standard deviation, beside the observations'
    /// own covariances.
    pub const fn with_slack_px(slack_px: f64) -> Self {
        Self { slack_px }
    }

    fn largest(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<(Subset, [Observation; MAX_CAMERAS], usize), NoPosition> {
        at_least_two(observations)?;
        let mut candidates = [Candidate::new(observations[0], self.slack_px); MAX_CAMERAS];
        let candidates = &mut candidates[..observations.len().min(MAX_CAMERAS)];
        for (candidate, observation) in candidates.iter_mut().zip(observations).skip(1) {
            *candidate = Candidate::new(*observation, self.slack_px);
        }
        candidates.sort_unstable_by_key(|c| c.observation.camera);
        let mut best: Option<Subset> = None;
        let obstacles = search(
            cameras,
            candidates,
            |_, _| true,
            |subset| {
                let better = best.as_ref().is_none_or(|b| {
                    subset.views > b.views || (subset.views == b.views && subset.distance2 < b.distance2)
                });
                if better {
                    best = Some(*subset);
                }
            },
        );
        let subset = best.ok_or_else(|| reason(&obstacles))?;
        let mut used = [observations[0]; MAX_CAMERAS];
        let count = observations_of(candidates, &subset.members, &mut used).len();
        Ok((subset, used, count))
    }
}

/// Why no subset was found.
pub(in crate::triangulate) fn reason(obstacles: &Obstacles) -> NoPosition {
    match obstacles {
        Obstacles { apart: true, .. } => NoPosition::ResidualTooLarge,
        Obstacles { behind: true, .. } => NoPosition::BehindCamera,
        Obstacles { parallel: true, .. } => NoPosition::ParallelRays,
        Obstacles { .. } => NoPosition::ResidualTooLarge,
    }
}

impl Method for Robust {
    fn code(&self) -> MethodCode {
        MethodCode::Robust
    }

    fn locate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Point<World>, NoPosition> {
        self.largest(cameras, observations).map(|(subset, ..)| Point::from(subset.refined.point))
    }

    fn estimate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Estimate, NoPosition> {
        let (subset, used, count) = self.largest(cameras, observations)?;
        let covariance = subset.refined.covariance().ok_or(NoPosition::ParallelRays)?;
        Ok(Estimate::assess(cameras, &used[..count], subset.refined.point, covariance))
    }
}
