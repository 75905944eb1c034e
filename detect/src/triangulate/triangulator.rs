use nalgebra::{Matrix2, Vector2, Vector3};
use netcord_common::{
    rig::Rig,
    wire::{
        BallPosition, Detection, DetectionFlags, Detections, MAX_CAMERAS, MAX_DETECTIONS, MethodCode,
        NoPosition, Scope, Stamps, WorldFrame,
    },
};

use super::{
    Estimate, Method, Observation, PosedCamera, RigWatch, TriangulateOptions,
    consensus::{Candidate, MAX_SUBSETS, Obstacles, observations_of, search},
    evidence::{Hypothesis, LEAST_EVIDENCE, Scales, Source, best, explain_away},
    memory::{Memory, Rest},
    methods::{method, reason, refine},
    variance::UnitVariance,
};

/// Finds the ball at each trigger from what the segmenters saw. Knows no clock and no bus; the same
/// messages in the same order give the same positions. Allocates nothing after it was made.
#[derive(Debug)]
pub struct Triangulator {
    cameras: Vec<PosedCamera>,
    method: &'static dyn Method,
    slack_px: f64,
    radius_m: f64,
    tolerance_ns: u64,
    world: WorldFrame,
    memory: Memory,
    variance: UnitVariance,
    watch: RigWatch,
    candidates: Vec<Candidate>,
    sources: Vec<Source>,
    hypotheses: Vec<Hypothesis>,
    sequence: u64,
}

/// Variance of a detection that states none, px².
const UNKNOWN_VARIANCE_PX2: f64 = 0.25;

impl Triangulator {
    /// A triangulator for a rig.
    pub fn new(rig: &Rig, options: &TriangulateOptions) -> Self {
        let cameras: Vec<_> =
            rig.cameras.iter().map(|c| PosedCamera::new(c.model, &c.camera_from_world)).collect();
        Self {
            method: method(options.method),
            slack_px: options.slack_px,
            radius_m: rig.ball.radius_m(),
            tolerance_ns: rig.tolerance_ns,
            world: rig.world,
            memory: Memory::new(rig.world == WorldFrame::Table, rig.ball.radius_m()),
            variance: UnitVariance::new(),
            watch: RigWatch::new(options.slack_px),
            candidates: Vec::with_capacity(MAX_CAMERAS * MAX_DETECTIONS),
            sources: Vec::with_capacity(MAX_CAMERAS * MAX_DETECTIONS),
            hypotheses: Vec::with_capacity(MAX_SUBSETS),
            sequence: 0,
            cameras,
        }
    }

    /// The cameras of the rig, posed.
    pub fn cameras(&self) -> &[PosedCamera] {
        &self.cameras
    }

    /// How well the cameras fit together.
    pub const fn watch(&self) -> &RigWatch {
        &self.watch
    }

    /// The position of one trigger from one message of each camera that delivered, in any order, or the
    /// reason why there is none.
    pub fn process(&mut self, detections: &[&Detections]) -> BallPosition {
        let mut position = self.begin(detections);
        let together = match self.synchronous(detections) {
            Ok(together) => together,
            Err(reason) => return self.absent(position, reason),
        };
        let obstacles = self.associate(detections, together);
        let t_ns = position.stamps.mid_exposure_ns;
        let best =
            best(&self.hypotheses).filter(|h| h.rest != Rest::LookAlike && h.evidence > LEAST_EVIDENCE);
        match best {
            Some(best) => match self.conclude(&best, &mut position, detections) {
                Ok(()) => self.remember_all(t_ns, Some(&best)),
                Err(reason) => return self.absent(position, reason),
            },
            None => {
                let reason = self.reason(&obstacles);
                if reason == NoPosition::ResidualTooLarge {
                    self.watch_lone_candidates();
                }
                self.remember_all(t_ns, None);
                return self.absent(position, reason);
            }
        }
        self.numbered(position)
    }

    /// The position of one trigger from what the search windows held, if the windows of all cameras that
    /// are trusted agree on one moving ball; else `None`, and nothing has happened.
    pub fn process_windows(&mut self, detections: &[&Detections]) -> Option<BallPosition> {
        let trusted = (0..self.cameras.len()).filter(|c| self.watch.distrusted() & (1 << c) == 0).count();
        if detections.len() < self.cameras.len() {
            return None;
        }
        let together = self.synchronous(detections).ok()?;
        let mut position = self.begin(detections);
        self.associate(detections, together);
        let best = best(&self.hypotheses)?;
        if best.subset.views < trusted.max(2) || best.rest != Rest::Unknown || best.evidence < LEAST_EVIDENCE
        {
            return None;
        }
        self.conclude(&best, &mut position, detections).ok()?;
        Some(self.numbered(position))
    }

    /// Looks at the full detections of a trigger whose position came from the search windows, for what
    /// does not move. Changes no position.
    pub fn look_around(&mut self, detections: &[&Detections]) {
        let Ok(together) = self.synchronous(detections) else { return };
        let t_ns = self.begin(detections).stamps.mid_exposure_ns;
        self.associate(detections, together);
        let best = best(&self.hypotheses);
        self.remember_all(t_ns, best.as_ref());
    }

    /// A message that says that a trigger has no position, and why.
    pub fn without_position(&mut self, detections: &[&Detections], reason: NoPosition) -> BallPosition {
        let position = self.begin(detections);
        self.absent(position, reason)
    }

    fn begin(&self, detections: &[&Detections]) -> BallPosition {
        let mut stamps = Stamps::default();
        let mut first = usize::MAX;
        let mut scope = Scope::Window.code();
        for d in detections {
            if d.stamps.segment_published_ns >= stamps.segment_published_ns {
                stamps = Stamps { mid_exposure_ns: stamps.mid_exposure_ns, ..d.stamps };
            }
            if d.scope == Scope::Full.code() {
                scope = Scope::Full.code();
            }
        }
        for d in detections {
            if (d.camera as usize) < first {
                first = d.camera as usize;
                stamps.mid_exposure_ns = d.stamps.mid_exposure_ns;
            }
        }
        BallPosition {
            trigger_id: detections.first().map_or(0, |d| d.trigger_id),
            stamps,
            candidate: [u8::MAX; MAX_CAMERAS],
            method: self.method.code().code(),
            frame: self.world.code(),
            scope,
            distrusted: self.watch.distrusted(),
            ..BallPosition::default()
        }
    }

    fn numbered(&mut self, mut position: BallPosition) -> BallPosition {
        self.sequence += 1;
        position.sequence = self.sequence;
        position
    }

    fn absent(&mut self, mut position: BallPosition, reason: NoPosition) -> BallPosition {
        position.reason = reason.code();
        self.numbered(position)
    }

    /// The cameras, as bits, whose exposures belong together: the largest group within the tolerance, if
    /// it holds two cameras or there is only one.
    fn synchronous(&self, detections: &[&Detections]) -> Result<u32, NoPosition> {
        let mut best = 0_u32;
        for start in detections {
            let from = start.stamps.mid_exposure_ns;
            let group = detections
                .iter()
                .filter(|d| {
                    (from..=from.saturating_add(self.tolerance_ns)).contains(&d.stamps.mid_exposure_ns)
                })
                .fold(0, |bits, d| bits | 1_u32.checked_shl(d.camera).unwrap_or(0));
            if group.count_ones() > best.count_ones() {
                best = group;
            }
        }
        if detections.is_empty() {
            Err(NoPosition::NoDetection)
        } else if best.count_ones() < 2 && detections.len() > 1 {
            Err(NoPosition::NotSynchronised)
        } else {
            Ok(best)
        }
    }

    /// Fills `candidates` from the cameras in `together`, finds the subsets that agree, and weighs them.
    fn associate(&mut self, detections: &[&Detections], together: u32) -> Obstacles {
        let offered = |mask: u32| detections.iter().filter(|d| mask & bit(d) != 0 && d.count > 0).count();
        let trusted = together & !self.watch.distrusted();
        let used = if offered(trusted) >= 2 { trusted } else { together };
        self.candidates.clear();
        self.sources.clear();
        self.hypotheses.clear();
        for camera in 0..self.cameras.len() {
            let Some(message) = detections.iter().find(|d| d.camera as usize == camera && used & bit(d) != 0)
            else {
                continue;
            };
            for (place, detection) in message.items().iter().enumerate() {
                if let Some(seen) = observe(&self.cameras[camera], camera, detection) {
                    let px = seen.pixel_by_normalised.determinant().abs().sqrt();
                    self.candidates.push(Candidate::new(seen, self.slack_px));
                    self.sources.push(Source {
                        // At most 16 places.
                        place: place as u8,
                        detection: *detection,
                        exposure_s: message.exposure_ns as f64 * 1e-9,
                        ball_px_m: px * 2.0 * self.radius_m,
                    });
                }
            }
        }
        let delivered = detections.iter().fold(0, |bits, d| bits | (bit(d) & used));
        let t_ns = detections.iter().map(|d| d.stamps.mid_exposure_ns).min().unwrap_or(0);
        let Self { cameras, candidates, sources, hypotheses, memory, radius_m, .. } = self;
        if candidates.is_empty() {
            return Obstacles::default();
        }
        let fits = |i: usize, depth: f64| sources[i].fits(depth);
        let obstacles = search(cameras, candidates, fits, |subset| {
            hypotheses.push(Hypothesis::new(*subset));
        });
        let scales = Scales {
            cameras,
            candidates,
            sources,
            delivered,
            radius_m: *radius_m,
            memory,
            predicted: memory.predict(t_ns),
            t_ns,
        };
        hypotheses.iter_mut().for_each(|hypothesis| hypothesis.weigh(&scales));
        explain_away(hypotheses, cameras.len());
        obstacles
    }

    fn reason(&self, obstacles: &Obstacles) -> NoPosition {
        let mut views = 0_u32;
        for c in &self.candidates {
            views |= 1 << c.observation.camera;
        }
        if !self.hypotheses.is_empty() {
            // Only look-alikes: nobody has seen a ball in play.
            return NoPosition::NoDetection;
        }
        match views.count_ones() {
            0 => NoPosition::NoDetection,
            1 => NoPosition::OneView,
            _ => reason(obstacles),
        }
    }

    /// Computes the position of the chosen subset, and learns from it.
    fn conclude(
        &mut self,
        best: &Hypothesis,
        position: &mut BallPosition,
        detections: &[&Detections],
    ) -> Result<(), NoPosition> {
        let mut buffer = [self.candidates[0].observation; MAX_CAMERAS];
        let used = observations_of(&self.candidates, &best.subset.members, &mut buffer);
        let mut corrected = false;
        for o in used.iter_mut() {
            let member = usize::from(best.subset.members[o.camera]);
            if self.sources[member].detection.flags & DetectionFlags::SPHERE_CORRECTED == 0 {
                let camera = &self.cameras[o.camera];
                if let Some(centre) = sphere_centre(camera, o, &best.subset.refined.point, self.radius_m) {
                    *o = centre;
                    corrected = true;
                }
            }
        }
        let mut estimate = match self.method.code() {
            MethodCode::Robust => {
                let refined = if corrected {
                    refine(&self.cameras, used, best.subset.refined.point).ok_or(NoPosition::BehindCamera)?
                } else {
                    best.subset.refined
                };
                let covariance = refined.covariance().ok_or(NoPosition::ParallelRays)?;
                Estimate::assess(&self.cameras, used, refined.point, covariance)
            }
            _ => {
                let taken = used.len().min(self.method.max_views());
                self.method.estimate(&self.cameras, &used[..taken])?
            }
        };
        /// Standard deviation from which on depth counts as undetermined, m.
        const UNDETERMINED_M: f64 = 1.0;
        if estimate.covariance_m2.trace() > UNDETERMINED_M * UNDETERMINED_M {
            return Err(NoPosition::ParallelRays);
        }
        let views = estimate.views.count_ones() as usize;
        self.variance.see(estimate.chi2, views);
        estimate.covariance_m2 *= self.variance.factor();
        self.watch_over(&estimate, detections);

        position.position_m = estimate.point.coords.into();
        // Symmetric: its columns are its rows.
        position.covariance_m2.copy_from_slice(estimate.covariance_m2.as_slice());
        position.residual_px = estimate.residual_px;
        position.residual_by_camera_px = estimate.residual_by_camera_px;
        position.chi2 = estimate.chi2;
        position.views = estimate.views;
        for camera in 0..self.cameras.len() {
            let member = best.subset.members[camera];
            if estimate.views & (1 << camera) != 0 {
                position.candidate[camera] = self.sources[usize::from(member)].place;
            } else if detections.iter().any(|d| d.camera as usize == camera && d.count > 0) {
                position.rejected |= 1 << camera;
            }
        }
        let first = detections.iter().filter(|d| position.views & bit(d) != 0).min_by_key(|d| d.camera);
        if let Some(first) = first {
            position.stamps.mid_exposure_ns = first.stamps.mid_exposure_ns;
        }
        position.distrusted = self.watch.distrusted();
        self.memory.follow(position.stamps.mid_exposure_ns, estimate.point.coords);
        Ok(())
    }

    /// Shows the watch where each camera saw the ball: also those whose candidate did not fit.
    fn watch_over(&mut self, estimate: &Estimate, detections: &[&Detections]) {
        /// How far a knocked camera's candidate may lie from where the ball should be, px.
        const REACH_PX: f64 = 80.0;
        if self.cameras.len() < 2 || !self.memory.is_moving() {
            return;
        }
        let mut seen = [self.candidates[0].observation; MAX_CAMERAS];
        let mut count = 0;
        for message in detections {
            let camera = message.camera as usize;
            let Some(posed) = self.cameras.get(camera) else { continue };
            let Some(expected) = posed.project(&estimate.point) else { continue };
            let off = |d: &Detection| (Vector2::new(d.u_px, d.v_px) - expected).norm();
            let nearest = message
                .items()
                .iter()
                .filter(|d| d.flags & DetectionFlags::AT_REST == 0)
                .min_by(|a, b| off(a).total_cmp(&off(b)))
                .filter(|d| off(d) < REACH_PX);
            if let Some(o) = nearest.and_then(|d| observe(posed, camera, d)) {
                seen[count] = o;
                count += 1;
            }
        }
        self.watch.see(&self.cameras, &seen[..count]);
    }

    /// Shows the watch candidates that do not agree although each is the only one of its camera: after a
    /// hard knock nothing ever agrees, and no position would tell.
    fn watch_lone_candidates(&mut self) {
        let mut seen = [self.candidates[0].observation; MAX_CAMERAS];
        for (i, c) in self.candidates.iter().enumerate() {
            let camera = c.observation.camera;
            if i > 0 && self.candidates[i - 1].observation.camera == camera {
                return;
            }
            seen[i] = c.observation;
        }
        self.watch.see(&self.cameras, &seen[..self.candidates.len()]);
    }

    fn remember_all(&mut self, t_ns: u64, chosen: Option<&Hypothesis>) {
        for h in &self.hypotheses {
            let is_chosen = chosen.is_some_and(|c| c.subset.members == h.subset.members);
            self.memory.sight(t_ns, &h.subset.refined.point, is_chosen);
        }
    }
}

fn bit(detections: &Detections) -> u32 {
    1_u32.checked_shl(detections.camera).unwrap_or(0)
}

/// The observation of a detection; `None` where its pixel or covariance cannot be.
fn observe(camera: &PosedCamera, index: usize, d: &Detection) -> Option<Observation> {
    let [uu, uv, vv] = d.covariance_px2;
    let stated = uu > 0.0 && vv > 0.0 && uu * vv > uv * uv;
    let covariance =
        if stated { Matrix2::new(uu, uv, uv, vv) } else { Matrix2::identity() * UNKNOWN_VARIANCE_PX2 };
    camera.observe(index, Vector2::new(d.u_px, d.v_px), covariance)
}

/// From the centre of a sphere's outline to the image of its centre: the outline's ellipse, on the
/// normalised plane, is centred on n z² / (z² − r²) for a sphere of radius r at depth z in direction n.
fn sphere_centre(
    camera: &PosedCamera,
    seen: &Observation,
    point: &Vector3<f64>,
    radius_m: f64,
) -> Option<Observation> {
    let z = camera.in_camera(point).z;
    let centre = seen.normalised * (1.0 - (radius_m / z).powi(2));
    let d = camera.model.distort(&centre)?;
    let pixel =
        Vector2::new(camera.model.fx * d.x + camera.model.cx, camera.model.fy * d.y + camera.model.cy);
    camera.observe(seen.camera, pixel, seen.covariance_px2)
}
