//! What speaks for a subset of candidates being the ball, and against it.

use nalgebra::{Matrix3, Vector3};
use netcord_common::wire::{Detection, DetectionFlags};

use super::{
    PosedCamera,
    appearance::{Appearance, MOST_MOTION, Motion, excess_distance, path_distance},
    consensus::{ABSENT, Candidate, Subset},
    memory::{Memory, Predicted, Rest, SPOT_RADIUS_M},
};

/// Where a candidate came from.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source {
    /// Its place in its camera's message.
    pub place: u8,
    /// What the segmenter says of it.
    pub detection: Detection,
    /// Length of its exposure, s; 0 where it is not known.
    pub exposure_s: f64,
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
}

/// What hypotheses are weighed by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scales<'a> {
    pub cameras: &'a [PosedCamera],
    pub candidates: &'a [Candidate],
    pub sources: &'a [Source],
    /// Bit i: camera i has looked.
    pub delivered: u32,
    pub radius_m: f64,
    pub memory: &'a Memory,
    /// Where the track goes on at `t_ns`.
    pub predicted: Option<Predicted>,
    pub t_ns: u64,
}

impl Hypothesis {
    /// A subset of which nothing is known yet.
    pub const fn new(subset: Subset) -> Self {
        Self { subset, evidence: 0.0, looks: 0.0, rest: Rest::Unknown }
    }

    /// Weighs it by its images, and by what is remembered.
    pub fn weigh(&mut self, scales: &Scales<'_>) {
        let point = self.subset.refined.point;
        self.looks = -0.5 * self.subset.distance2;
        let mut precision = Precision::default();
        let mut motion = Motion::default();
        // What was here some frames ago has gone twice round the spot since, at most.
        let slow = scales.memory.stayed_s(scales.t_ns, &point).map(|ago_s| 2.0 * SPOT_RADIUS_M / ago_s);
        let (mut off_track, mut too_fast) = (0.0, 0.0);
        let mut resting = 0;
        for (camera, posed) in scales.cameras.iter().enumerate() {
            let member = self.subset.members[camera];
            if member == ABSENT {
                if scales.delivered & (1 << camera) != 0 && is_in_view(posed, &point) {
                    self.looks += MISS_EVIDENCE;
                }
                continue;
            }
            let source = &scales.sources[usize::from(member)];
            let candidate = &scales.candidates[usize::from(member)];
            let detection = &source.detection;
            let score = detection.score.clamp(0.0, 1.0);
            self.looks += VIEW_EVIDENCE + ((score + 0.02) / (1.02 - score)).ln();
            let appearance = Appearance::of(posed, &candidate.observation, &point);
            self.looks -= 0.5 * appearance.size_distance(detection, scales.radius_m, source.is_partial());
            precision.see(candidate, &appearance);
            motion.see(&appearance, detection, source.exposure_s);
            if let Some(predicted) = &scales.predicted {
                off_track += path_distance(&appearance, detection, &predicted.velocity, source.exposure_s);
            }
            if let Some(speed) = slow {
                too_fast += excess_distance(&appearance, detection, speed, source.exposure_s);
            }
            resting += usize::from(detection.flags & DetectionFlags::AT_REST != 0);
        }
        self.looks += precision.evidence() - 0.5 * (motion.distance() + too_fast).min(MOST_MOTION);
        self.evidence =
            scales.memory.log_prior(scales.t_ns, &point, scales.predicted.as_ref(), off_track) + self.looks;
        self.rest = scales.memory.rest(scales.t_ns, &point);
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

/// How much it says that the views of a hypothesis agree: candidates whose places are known to a tenth of a pixel do not
/// meet by chance; those that may be anywhere within twenty pixels do.
///
/// The likelihood of the observations, marginal over the point: ∏ |Sᵢ|^(−½) · |∑ Jᵢᵀ Sᵢ⁻¹ Jᵢ|^(−½), Sᵢ the covariance of
/// view i with the calibration's slack and Jᵢ its Jacobian, against what it would be were each S that of
/// [`USUAL_SIGMA_PX`]. Where all are k times as wide, this is −(2 n − 3) ln k for n views.
#[derive(Debug, Clone, Copy)]
struct Precision {
    log_weight: f64,
    information: Matrix3<f64>,
    usual: Matrix3<f64>,
}

/// Standard deviation of a view, px, from which on its agreement counts less than [`VIEW_EVIDENCE`].
const USUAL_SIGMA_PX: f64 = 1.0;

impl Default for Precision {
    fn default() -> Self {
        Self { log_weight: 0.0, information: Matrix3::zeros(), usual: Matrix3::zeros() }
    }
}

impl Precision {
    fn see(&mut self, candidate: &Candidate, appearance: &Appearance) {
        const USUAL: f64 = 1.0 / (USUAL_SIGMA_PX * USUAL_SIGMA_PX);
        let information = candidate.gate_information_px();
        let j = appearance.by_world();
        self.log_weight += 0.5 * (information.determinant() / (USUAL * USUAL)).ln();
        self.information += j.tr_mul(&(information * j));
        self.usual += j.tr_mul(j) * USUAL;
    }

    /// At most 0: what fits better than usual needs no more than other evidence.
    fn evidence(&self) -> f64 {
        let volumes = 0.5 * (self.information.determinant() / self.usual.determinant()).ln();
        let evidence = self.log_weight - volumes;
        if evidence.is_finite() { evidence.min(0.0) } else { 0.0 }
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
