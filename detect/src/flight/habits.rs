//! What earlier flights taught of ball, table and frame, and of how balls are struck here.

use nalgebra::Vector3;

use super::{
    belief::Belief,
    physics::{DRAG, FRICTION, RESTITUTION, SLANT, STATE},
    strokes::{Stroke, Strokes},
};

/// One flight changes what is believed of ball and table by this share of its latitude at most: a hit that was
/// taken for a bounce must not spoil the flights to come.
const MOST_LESSON: f64 = 0.5;

/// How many numbers of a state are peculiar to ball, table and frame: the last of it.
const PECULIAR: usize = STATE - DRAG;

/// What earlier flights taught: mean and variance of what is peculiar to this ball, table and frame ([`DRAG`],
/// [`RESTITUTION`], [`SLANT`], [`FRICTION`]), and how balls were struck.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Habits {
    pub(super) peculiar: [(f64, f64); PECULIAR],
    pub(super) strokes: Strokes,
}

impl Habits {
    /// Nothing learned yet.
    pub fn new(latitude: &Latitude) -> Self {
        Self { peculiar: latitude.sigmas().map(|sigma| (0.0, sigma * sigma)), strokes: Strokes::default() }
    }

    /// Takes in the end of a flight that began with the velocity `struck_m_s`.
    pub fn learn(&mut self, latitude: &Latitude, struck_m_s: &Vector3<f64>, end: &Belief) {
        let sigmas = latitude.sigmas();
        for (i, (known, sigma)) in self.peculiar.iter_mut().zip(sigmas).enumerate() {
            let (place, before) = (DRAG + i, known.0);
            let most = MOST_LESSON * sigma;
            let mean = before + (end.mean[place] - before).clamp(-most, most);
            let forgotten = (latitude.forgetting * sigma).powi(2);
            *known = (mean, (end.covariance[(place, place)] + forgotten).min(sigma * sigma));
        }
        self.strokes.keep(Stroke {
            velocity: *struck_m_s,
            spin: end.struck_spin,
            covariance: end.struck_covariance,
        });
    }
}

/// How far ball, table and frame may differ from the rig file, as standard deviations, and how much of what
/// was learned is forgotten with each flight, as a share of that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latitude {
    /// Of the logarithm of the drag.
    pub drag: f64,
    /// Of the restitution.
    pub restitution: f64,
    /// Of each horizontal acceleration, m/s².
    pub slant_m_s2: f64,
    /// Of the logarithm of the table's friction.
    pub friction: f64,
    /// Share of the above by which it may change from flight to flight.
    pub forgetting: f64,
}

impl Latitude {
    /// In the order of a state.
    fn sigmas(&self) -> [f64; PECULIAR] {
        const { assert!(RESTITUTION == DRAG + 1 && SLANT == DRAG + 2) };
        const { assert!(FRICTION == SLANT + 2 && STATE == FRICTION + 1) };
        [self.drag, self.restitution, self.slant_m_s2, self.slant_m_s2, self.friction]
    }
}
