use nalgebra::{Matrix3, Vector3};
use netcord_common::{
    rig::Rig,
    wire::{
        BallPosition, BallTrajectory, Landing, LandingKind, MAX_PATH, PathPoint, PlaneCrossing, SearchWindow,
        TrajectoryOutcome, WorldFrame,
    },
};

use super::{
    bank::Bank,
    belief::Belief,
    confidence,
    flow::{Flow, Table},
    forecast::{Ahead, Crossing, Descent, PATH_STEP_S, look_ahead},
    habits::Habits,
    settings::Tuning,
    tracker::{Observation, Tracker},
    windows::WindowMaker,
};

/// How far the hitting plane and the landing point are looked for, s.
const HORIZON_S: f64 = 1.0;
/// Calibration errors that a position's covariance does not know of, as a standard deviation, m.
const POSITION_FLOOR_M: f64 = 5e-4;

/// What the predictor may be told beside the rig.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PredictOptions {
    /// The hitting plane y = …, in place of the rig file's, m.
    pub hitting_plane_y_m: Option<f64>,
}

/// From positions to the trajectory ahead, and to the search windows of the next trigger. Sees no clock
/// and allocates nothing after it was made.
///
/// ```
/// use netcord_detect::flight::{PredictOptions, Predictor};
/// use netcord_common::{rig::Rig, wire::BallPosition};
/// # fn follow(rig: &Rig, positions: &[BallPosition]) {
/// let mut predictor = Predictor::new(rig, PredictOptions::default());
/// for position in positions {
///     let trajectory = predictor.update(position);
///     println!("{:?}", trajectory.landing);
/// }
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Predictor {
    tracker: Tracker,
    windows: WindowMaker,
    frame: WorldFrame,
    plane_y_m: Option<f64>,
    trajectory: Box<BallTrajectory>,
    /// Triggers without a position since the last that had one.
    misses: u32,
    late: u64,
}

impl Predictor {
    /// A predictor for a rig. Without a table frame neither gravity's direction nor the table is known:
    /// then the path is drag and spin only, with the noise that this deserves.
    pub fn new(rig: &Rig, options: PredictOptions) -> Self {
        let table = (rig.world == WorldFrame::Table).then_some(Table::CENTRED);
        let tuning = if table.is_some() { Tuning::default() } else { Tuning::without_table() };
        let flow = Flow::new(&rig.flight, &rig.ball, table, tuning.noise);
        let plane_y_m = table.map(|_| options.hitting_plane_y_m.unwrap_or(rig.hitting_plane.y_m));
        Self {
            tracker: Tracker::new(flow, tuning.latitude, Habits::new(&tuning.latitude)),
            windows: WindowMaker::new(rig),
            frame: rig.world,
            plane_y_m,
            trajectory: Box::default(),
            misses: 0,
            late: 0,
        }
    }

    /// Takes in what the triangulator says of one trigger, and predicts. Positions may come late or out of
    /// order: the trajectory returned is always that of the newest.
    pub fn update(&mut self, position: &BallPosition) -> &BallTrajectory {
        let t_ns = position.stamps.mid_exposure_ns;
        if position.is_present() {
            let covariance = Matrix3::from_row_slice(&position.covariance_m2)
                + Matrix3::identity() * (POSITION_FLOOR_M * POSITION_FLOOR_M);
            let verdict = self.tracker.observe(&Observation {
                t_ns,
                position: Vector3::from(position.position_m),
                covariance,
            });
            match verdict {
                super::Verdict::InFlight | super::Verdict::Began => self.misses = 0,
                super::Verdict::Unexplained => self.misses = self.misses.saturating_add(1),
                super::Verdict::TooLate => self.late += 1,
            }
        } else {
            self.tracker.pass_time(t_ns);
            self.misses = self.misses.saturating_add(1);
        }
        self.describe(position);
        &self.trajectory
    }

    /// Where each camera will see the ball at `next_mid_exposure_ns`, in rig order: as its flight goes on, or, where
    /// the last positions are of no flight yet (it has been hit, or comes into view), near these.
    pub fn windows(&self, next_mid_exposure_ns: u64) -> impl Iterator<Item = SearchWindow> + '_ {
        let (mut bank, mut misses) = (Bank::default(), self.misses);
        if self.tracker.is_unsettled() {
            if let Some(newcomer) = self.tracker.newcomer_at(next_mid_exposure_ns) {
                bank.add(newcomer);
                misses = 0;
            }
        } else if self.tracker.is_in_flight() {
            bank = self.tracker.bank_at(next_mid_exposure_ns);
        }
        self.windows.windows(bank, misses, self.trajectory.trigger_id, next_mid_exposure_ns)
    }

    /// Positions that came too late to be of use, or twice.
    pub fn late(&self) -> u64 {
        self.late
    }

    fn describe(&mut self, position: &BallPosition) {
        let out = &mut *self.trajectory;
        out.trigger_id = position.trigger_id;
        out.sequence += 1;
        out.stamps = position.stamps;
        out.frame = self.frame.code();
        out.flight_id = self.tracker.flight_id();
        out.path_len = 0;
        out.crossing = PlaneCrossing::default();
        out.landing = Landing::default();
        // A late position changes the present, which stays where the newest position is.
        let t_ns = position.stamps.mid_exposure_ns.max(self.tracker.last_seen_ns());
        let bank = self.tracker.bank_at(t_ns);
        let Some(best) = bank.consensus() else {
            let outcome = if self.tracker.is_unsettled() {
                TrajectoryOutcome::Starting
            } else {
                TrajectoryOutcome::NoBall
            };
            out.outcome = outcome.code();
            (out.position_m, out.velocity_m_s, out.spin_rad_s) = ([0.0; 3], [0.0; 3], [0.0; 3]);
            out.covariance = [0.0; 81];
            out.bounces = 0;
            return;
        };
        out.outcome = TrajectoryOutcome::InFlight.code();
        out.stamps.mid_exposure_ns = t_ns;
        out.bounces = best.bounces;
        out.position_m = best.belief.position().into();
        out.velocity_m_s = best.belief.velocity().into();
        out.spin_rad_s = best.belief.spin().into();
        for row in 0..9 {
            for column in 0..9 {
                out.covariance[9 * row + column] = best.belief.covariance[(row, column)];
            }
        }
        let flow = self.tracker.flow();
        let (path, mut filled) = (&mut out.path, 0);
        let ahead = look_ahead(flow, &best.belief, best.exempt, HORIZON_S, self.plane_y_m, |k, belief| {
            if k <= MAX_PATH {
                path[k - 1] = path_point(belief, best.weight, k, t_ns);
                filled = k;
            }
        });
        out.path_len = filled as u32;
        describe_ahead(out, &ahead, best.weight, t_ns);
    }
}

fn step_ns(k: usize) -> u64 {
    (k as f64 * PATH_STEP_S * 1e9).round() as u64
}

fn after(t_ns: u64, seconds: f64) -> u64 {
    t_ns.saturating_add_signed((seconds * 1e9).round() as i64)
}

/// The upper triangle of a symmetric matrix, row by row.
fn triangle(m: &Matrix3<f64>) -> [f64; 6] {
    [m[(0, 0)], m[(0, 1)], m[(0, 2)], m[(1, 1)], m[(1, 2)], m[(2, 2)]]
}

fn path_point(belief: &Belief, weight: f64, k: usize, t_ns: u64) -> PathPoint {
    let covariance = belief.position_covariance();
    PathPoint {
        t_ns: t_ns + step_ns(k),
        position_m: belief.position().into(),
        covariance_m2: triangle(&covariance),
        confidence: confidence::of_place(&covariance, weight),
    }
}

fn describe_ahead(out: &mut BallTrajectory, ahead: &Ahead, weight: f64, t_ns: u64) {
    if let Some(c) = &ahead.crossing {
        out.crossing = PlaneCrossing {
            t_ns: after(t_ns, c.after_s),
            position_m: c.belief.position().into(),
            velocity_m_s: c.belief.velocity().into(),
            covariance_m2: triangle(&c.covariance),
            sigma_t_s: c.sigma_t_s,
            confidence: confidence::of_crossing(c, weight),
        };
    }
    if let Some((descent, c)) = &ahead.landing {
        out.landing = landing(*descent, c, t_ns);
    }
}

fn landing(descent: Descent, c: &Crossing, t_ns: u64) -> Landing {
    let p = c.belief.position();
    let covariance = &c.covariance;
    let kind = match descent {
        Descent::Table if p.y < 0.0 => LandingKind::NearSide,
        Descent::Table => LandingKind::FarSide,
        Descent::Net => LandingKind::Net,
        Descent::Beside => LandingKind::Out,
    };
    Landing {
        t_ns: after(t_ns, c.after_s),
        position_m: [p.x, p.y],
        covariance_m2: [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]],
        sigma_t_s: c.sigma_t_s,
        kind: kind.code(),
        _reserved: 0,
    }
}
