use iceoryx2::prelude::ZeroCopySend;

use super::{Message, Stamps, assert_layout, code_enum};

/// Most points of a predicted path: 0.64 s at the usual spacing of 20 ms.
pub const MAX_PATH: usize = 32;

code_enum! {
    /// What a trajectory message holds.
    TrajectoryOutcome {
        /// A ball is in flight and its path is predicted.
        InFlight = 0 => "in-flight",
        /// No ball is being followed.
        NoBall = 1 => "no-ball",
        /// A flight has begun, but too little has been seen to predict.
        Starting = 2 => "starting",
    }
}

code_enum! {
    /// Where the ball comes down next.
    LandingKind {
        /// No landing within the horizon.
        None = 0 => "none",
        /// On the half of the table with y < 0.
        NearSide = 1 => "near-side",
        /// On the half of the table with y > 0.
        FarSide = 2 => "far-side",
        /// Into the net first.
        Net = 3 => "net",
        /// Past the table.
        Out = 4 => "out",
    }
}

/// One point of the predicted path.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.PathPoint")]
#[repr(C)]
pub struct PathPoint {
    /// When, in the clock of `Stamps::mid_exposure_ns`.
    pub t_ns: u64,
    /// Where, m.
    pub position_m: [f64; 3],
    /// Covariance, m²: xx, xy, xz, yy, yz, zz.
    pub covariance_m2: [f64; 6],
    /// Chance that the ball is within 40 mm of here then, 0–1.
    pub confidence: f64,
}

assert_layout!(PathPoint, size = 88);

/// Where the ball crosses the plane in which it can be hit.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.PlaneCrossing")]
#[repr(C)]
pub struct PlaneCrossing {
    /// When; 0 when the path does not cross the plane within the horizon.
    pub t_ns: u64,
    /// Where, m.
    pub position_m: [f64; 3],
    /// Velocity there, m/s.
    pub velocity_m_s: [f64; 3],
    /// Covariance of the position, m²: xx, xy, xz, yy, yz, zz.
    pub covariance_m2: [f64; 6],
    /// Standard deviation of the instant, s.
    pub sigma_t_s: f64,
    /// Chance that the ball crosses within 40 mm of `position_m`, 0–1.
    pub confidence: f64,
}

assert_layout!(PlaneCrossing, size = 120);

/// Where the ball comes down next.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.Landing")]
#[repr(C)]
pub struct Landing {
    /// When; 0 when there is no landing within the horizon.
    pub t_ns: u64,
    /// Where on the table's plane: x, y of the ball's centre, m.
    pub position_m: [f64; 2],
    /// Covariance, m²: xx, xy, yy.
    pub covariance_m2: [f64; 3],
    /// Standard deviation of the instant, s.
    pub sigma_t_s: f64,
    /// [`LandingKind`] as its code.
    pub kind: u32,
    #[doc(hidden)]
    pub _reserved: u32,
}

assert_layout!(Landing, size = 64, kind = 56);

/// The ball's state and where it will go: `ball/trajectory`.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("netcord.BallTrajectory")]
#[repr(C)]
pub struct BallTrajectory {
    /// The trigger of the position that it was made from.
    pub trigger_id: u64,
    /// Counts this predictor's messages from 1.
    pub sequence: u64,
    /// The position's, with predict's own.
    pub stamps: Stamps,
    /// Counts the flights seen from 1; changes with every hit.
    pub flight_id: u64,
    /// Filtered position at mid-exposure, m.
    pub position_m: [f64; 3],
    /// Filtered velocity, m/s.
    pub velocity_m_s: [f64; 3],
    /// Filtered spin, rad/s.
    pub spin_rad_s: [f64; 3],
    /// Covariance of (position, velocity, spin), SI units, row-major 9 × 9.
    pub covariance: [f64; 81],
    /// Where it crosses the hitting plane.
    pub crossing: PlaneCrossing,
    /// Where it lands.
    pub landing: Landing,
    /// The predicted path, filled up to `path_len`.
    pub path: [PathPoint; MAX_PATH],
    /// How many points of `path` are filled.
    pub path_len: u32,
    /// [`TrajectoryOutcome`] as its code.
    pub outcome: u32,
    /// [`super::WorldFrame`] as its code.
    pub frame: u32,
    /// Table bounces seen in this flight.
    pub bounces: u32,
}

assert_layout!(
    BallTrajectory,
    size = 1024 + 88 * MAX_PATH,
    stamps = 16,
    position_m = 104,
    covariance = 176,
    crossing = 824,
    path = 1008
);

impl Message for BallTrajectory {}

impl Default for BallTrajectory {
    fn default() -> Self {
        Self {
            trigger_id: 0,
            sequence: 0,
            stamps: Stamps::default(),
            flight_id: 0,
            position_m: [0.0; 3],
            velocity_m_s: [0.0; 3],
            spin_rad_s: [0.0; 3],
            covariance: [0.0; 81],
            crossing: PlaneCrossing::default(),
            landing: Landing::default(),
            path: [PathPoint::default(); MAX_PATH],
            path_len: 0,
            outcome: TrajectoryOutcome::NoBall.code(),
            frame: 0,
            bounces: 0,
        }
    }
}

impl BallTrajectory {
    /// The filled points of the path.
    pub fn path(&self) -> &[PathPoint] {
        &self.path[..(self.path_len as usize).min(MAX_PATH)]
    }
}
