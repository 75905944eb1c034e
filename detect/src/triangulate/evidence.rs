//! What speaks for a subset of candidates being the ball, and against it.

use nalgebra::Vector3;
use netcord_common::wire::{Detection, DetectionFlags};

use super::{
    PosedCamera,
    consensus::{ABSENT, Subset},
    memory::{Memory, Rest},
};

/// Where a candidate came from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source {
    /// Its place in its camera's message.
    pub place: u8,
    /// What the segmenter says of it.
    pub detection: Detection,
    /// Diameter of the ball's image here at a depth of one metre, px.
    pub ball_px_m: f64,
}

/// A subset with what speaks for it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hypothesis {
    /// The candidates, and where they meet.
    pub subset: Subset,
    /// Logarithm of the likelihood ratio against clutter.
    pub evidence: f64,
    /// The part of it that the images alone tell, without the track.
    looks: f64,
    /// Whether it moves.
    pub rest: Rest,
}

/// What a view that agrees is worth against clutter, as a logarithm: about 1 candidate of clutter per
/// 1,000 px wide strip of tolerance around an epipolar line.
const VIEW_EVIDENCE: f64 = 8.0;

/// Evidence from which on a hypothesis is taken for the ball. Two views of which each looks like a ball with a
/// score of one half, and no track, come to twice [`VIEW_EVIDENCE`]; limbs and paddles that happen to lie on one
/// epipolar line come to less.
pub(super) const LEAST_EVIDENCE: f64 = 2.0 * VIEW_EVIDENCE;

/// What a camera costs that should see the point and has no candidate there: misses are 1 in 10.
const MISS_EVIDENCE: f64 = -2.3;

/// What a view costs that has not moved where others have. The ball may come straight at one camera; a thing at
/// rest paired with a moving one by chance is the likelier reason.
const RESTING_VIEW_EVIDENCE: f64 = -4.0;

/// Scatter of the logarithm of a measured diameter, blurred or not: measured 0.06 where the ball was expected and
/// 0.13 elsewhere, with longer tails than a normal distribution has.
const SIZE_SIGMA: f64 = 0.15;

/// A candidate whose diameter differs from that of a ball at its depth by more than this factor is none.
const SIZE_GATE: f64 = 3.0;

/// What a view costs whose candidate a look-alike explains, and by how much worse than the hypothesis the
/// look-alike may look and still explain it.
const EXPLAINED_EVIDENCE: f64 = -9.0;
const EXPLAINED_SLACK: f64 = 3.0;

impl Source {
    /// The diameter of its image, px, where one was measured.
    fn diameter_px(&self) -> Option<f64> {
        Some(self.detection.diameter_px).filter(|diameter| *diameter > 0.0)
    }

    fn is_partial(&self) -> bool {
        self.detection.flags & (DetectionFlags::CUT_BY_FRAME | DetectionFlags::OCCLUDED) != 0
    }

    /// Whether a ball at `depth`, m, could look as large as this; a part of one may be smaller.
    pub fn fits(&self, depth: f64) -> bool {
        let expected = self.ball_px_m / depth;
        self.diameter_px().is_none_or(|measured| {
            measured < SIZE_GATE * expected && (self.is_partial() || measured * SIZE_GATE > expected)
        })
    }

    /// Squared distance of the measured diameter from that of a ball at `depth`, m, in standard deviations;
    /// zero where no diameter was measured, bounded, since shadows and nets do what they like.
    fn size_distance(&self, depth: f64) -> f64 {
        const MOST: f64 = 9.0;
        let sigma = if self.is_partial() { 2.0 * SIZE_SIGMA } else { SIZE_SIGMA };
        self.diameter_px()
            .map_or(0.0, |measured| ((measured * depth / self.ball_px_m).ln() / sigma).powi(2).min(MOST))
    }
}

impl Hypothesis {
    /// A subset of which nothing is known yet.
    pub const fn new(subset: Subset) -> Self {
        Self { subset, evidence: 0.0, looks: 0.0, rest: Rest::Unknown }
    }

    /// Weighs it by its images, and by what is remembered at `t_ns`; bit i of `delivered` says that camera i has
    /// looked.
    pub fn weigh(
        &mut self,
        cameras: &[PosedCamera],
        sources: &[Source],
        delivered: u32,
        memory: &Memory,
        t_ns: u64,
    ) {
        let point = self.subset.refined.point;
        self.looks = -0.5 * self.subset.distance2;
        let mut resting = 0;
        for (camera, posed) in cameras.iter().enumerate() {
            let member = self.subset.members[camera];
            if member == ABSENT {
                if delivered & (1 << camera) != 0 && is_in_view(posed, &point) {
                    self.looks += MISS_EVIDENCE;
                }
                continue;
            }
            let source = &sources[usize::from(member)];
            let score = source.detection.score.clamp(0.0, 1.0);
            self.looks += VIEW_EVIDENCE + ((score + 0.02) / (1.02 - score)).ln();
            self.looks -= 0.5 * source.size_distance(posed.in_camera(&point).z);
            resting += usize::from(source.detection.flags & DetectionFlags::AT_REST != 0);
        }
        self.evidence = memory.log_prior(t_ns, &point) + self.looks;
        self.rest = memory.rest(t_ns, &point);
        if self.rest == Rest::Unknown && resting == self.subset.views {
            self.rest = Rest::Still;
        } else if self.rest == Rest::Unknown {
            self.evidence += RESTING_VIEW_EVIDENCE * resting as f64;
        }
    }

    /// Whether both use the same candidate of a camera.
    fn shares(&self, other: &Self, camera: usize) -> bool {
        let member = self.subset.members[camera];
        member != ABSENT && other.subset.members[camera] == member
    }
}

/// Two look-alikes make two more points where each camera's image of one meets that of the other. What
/// look-alikes explain at least as well speaks for no ball.
pub(super) fn explain_away(hypotheses: &mut [Hypothesis], cameras: usize) {
    for i in 0..hypotheses.len() {
        let h = hypotheses[i];
        if h.rest == Rest::LookAlike {
            continue;
        }
        let explained = (0..cameras).filter(|camera| {
            hypotheses.iter().any(|other| {
                other.rest == Rest::LookAlike
                    && h.shares(other, *camera)
                    && other.looks >= h.looks - EXPLAINED_SLACK
            })
        });
        let cost = EXPLAINED_EVIDENCE * explained.count() as f64;
        hypotheses[i].evidence += cost;
    }
}

/// The one that is most likely the ball: one that moves goes before one at rest, and a look-alike comes last.
pub(super) fn best(hypotheses: &[Hypothesis]) -> Option<Hypothesis> {
    let order = |h: &Hypothesis| match h.rest {
        Rest::Unknown => 2,
        Rest::Still => 1,
        Rest::LookAlike => 0,
    };
    hypotheses.iter().max_by(|a, b| order(a).cmp(&order(b)).then(a.evidence.total_cmp(&b.evidence))).copied()
}

fn is_in_view(camera: &PosedCamera, point: &Vector3<f64>) -> bool {
    camera.project(&(*point).into()).is_some_and(|pixel| camera.model.contains(&pixel))
}
