//! Where a belief goes with time: free flight, and contacts with table, net and floor on the way.

use nalgebra::Vector3;
use netcord_common::rig::{Ball, FlightConstants};

use super::{
    bank::erf,
    belief::Belief,
    contact::{
        BounceScatter, NET_HALF_WIDTH_M, NET_HEIGHT_M, Surface, TABLE_HALF_LENGTH_M, TABLE_HALF_WIDTH_M,
        TABLE_HEIGHT_M, net_contact,
    },
    physics::{Forces, State, split},
};

/// Longest step of the integration, s; see [`Forces::step`].
const STEP_S: f64 = 0.02;
/// Slower than this along the normal a contact ends in rolling, m/s.
const ROLLING_M_S: f64 = 0.15;
/// A mean that the filter has pushed this far into the table is still one that bounces now, m.
const PENETRATION_M: f64 = 0.03;
/// How surely a ball must be below the net's cord to touch it, in standard deviations of its height.
const NET_DOUBT_SIGMAS: f64 = 1.5;
/// Most contacts in one advance; a ball that touches more often lies.
const MAX_CONTACTS: u32 = 16;

/// Where the table is in the frame of the positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Table {
    /// Height of its surface, m.
    pub surface_z_m: f64,
    /// Whether the frame's origin is the table's centre, so that its edges are known too.
    pub edges_known: bool,
    /// Whether a net is up in the plane y = 0.
    pub net: bool,
}

impl Table {
    /// The table of the table frame.
    pub const CENTRED: Self = Self { surface_z_m: 0.0, edges_known: true, net: true };

    /// Signed distance from (x, y) to the nearest edge, m; positive on the table.
    pub fn inside_by(&self, x: f64, y: f64) -> f64 {
        (TABLE_HALF_WIDTH_M - x.abs()).min(TABLE_HALF_LENGTH_M - y.abs())
    }
}

/// What the model leaves out, as noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelNoise {
    /// Spectral density of the unmodelled acceleration, m²/s³.
    pub acceleration: f64,
    /// Spectral density of the spin's change, rad²/s³.
    pub spin: f64,
    /// Bounces.
    pub bounce: BounceScatter,
}

/// How a ball leaves the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leaving {
    /// Friction has stopped the slip.
    Rolling,
    /// It has not.
    Sliding,
}

/// What was touched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Touched {
    /// The table.
    Table,
    /// The net.
    Net,
    /// The floor.
    Floor,
}

/// A contact on the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// What was touched.
    pub touched: Touched,
    /// Seconds after the start of the advance.
    pub after_s: f64,
    /// The belief just before.
    pub before: Belief,
}

/// What a belief is exempt from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Exempt {
    /// The ball has passed the table's plane beside the table.
    pub table: bool,
    /// The ball has passed the net's plane beside or above the net.
    pub net: bool,
}

/// Forces, surfaces and noise together: all that decides where a belief goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flow {
    /// Forces in the air.
    pub forces: Forces,
    /// The table, where one is known.
    pub table: Option<Table>,
    /// How the table returns balls.
    pub table_surface: Surface,
    /// How the floor returns balls.
    pub floor_surface: Surface,
    /// The noise.
    pub noise: ModelNoise,
    /// Radius of the ball, m.
    pub radius_m: f64,
    /// How balls leave the table, where that is given.
    pub leaving: Option<Leaving>,
}

impl Flow {
    /// The flow of a rig's constants around `table`.
    pub fn new(constants: &FlightConstants, ball: &Ball, table: Option<Table>, noise: ModelNoise) -> Self {
        let radius_m = ball.radius_m();
        let mut forces = Forces::new(constants, ball);
        if table.is_none() {
            // Without a table frame nobody knows which way is down.
            forces.gravity_m_s2 = Vector3::zeros();
        }
        Self {
            forces,
            table,
            table_surface: Surface::table(constants, radius_m),
            floor_surface: Surface::floor(radius_m),
            noise,
            radius_m,
            leaving: None,
        }
    }

    /// Moves `belief` on by `dt` seconds through all contacts, each reported to `on_contact`.
    pub fn advance(
        &self,
        belief: &mut Belief,
        dt: f64,
        exempt: &mut Exempt,
        mut on_contact: impl FnMut(&Contact),
    ) {
        let (mut done, mut contacts) = (0.0, 0);
        while done < dt - 1e-12 {
            let h = (dt - done).min(STEP_S);
            if contacts < MAX_CONTACTS
                && let Some((touched, tau)) = self.next_contact(belief, h, exempt)
            {
                self.fly(belief, tau);
                on_contact(&Contact { touched, after_s: done + tau, before: *belief });
                self.touch(belief, touched, exempt);
                contacts += 1;
                done += tau;
                continue;
            }
            self.fly(belief, h);
            self.keep_on_table(belief, exempt);
            done += h;
        }
    }

    /// Free flight by `h` (which may be slightly negative), with covariance and noise.
    pub fn fly(&self, belief: &mut Belief, h: f64) {
        if h == 0.0 {
            return;
        }
        let next = self.forces.step(&belief.mean, h);
        let f = self.forces.transition(&(0.5 * (belief.mean + next)), h);
        belief.map_flight(next, &f);
        let (q, h) = (self.noise.acceleration, h.abs());
        for axis in 0..3 {
            belief.covariance[(axis, axis)] += q * h * h * h / 3.0;
            belief.covariance[(axis, axis + 3)] += q * h * h / 2.0;
            belief.covariance[(axis + 3, axis)] += q * h * h / 2.0;
            belief.covariance[(axis + 3, axis + 3)] += q * h;
            belief.covariance[(axis + 6, axis + 6)] += self.noise.spin * h;
        }
    }

    /// The first contact within `h`, and when.
    fn next_contact(&self, belief: &Belief, h: f64, exempt: &Exempt) -> Option<(Touched, f64)> {
        let table = self.table?;
        let state = &belief.mean;
        let end = self.forces.step(state, h);
        let level = table.surface_z_m + self.radius_m;
        let mut first: Option<(Touched, f64)> = None;
        let mut offer = |touched, tau: f64| {
            if first.is_none_or(|(_, t)| tau < t) {
                first = Some((touched, tau));
            }
        };
        let sinks = state[5] < -ROLLING_M_S || end[5] < -ROLLING_M_S;
        if !exempt.table && sinks && end[2] <= level && state[2] > level - PENETRATION_M {
            let tau = if state[2] >= level {
                self.crossing_time(state, h, 2, level)
            } else {
                // Pushed below by the last position: the bounce is a moment ago.
                ((level - state[2]) / state[5].min(-ROLLING_M_S)).max(-h)
            };
            let at = self.forces.step(state, tau);
            if at[5] < 0.0 && (!table.edges_known || table.inside_by(at[0], at[1]) > 0.0) {
                offer(Touched::Table, tau);
            }
        }
        if !table.edges_known {
            return first;
        }
        if table.net && !exempt.net && state[1] * end[1] < 0.0 {
            let tau = self.crossing_time(state, h, 1, 0.0);
            let at = self.forces.step(state, tau);
            let height = at[2] - table.surface_z_m;
            // Players aim above the net: it is touched only where that is beyond doubt.
            let doubt = NET_DOUBT_SIGMAS * belief.covariance[(2, 2)].max(0.0).sqrt();
            if at[0].abs() < NET_HALF_WIDTH_M && (0.0..NET_HEIGHT_M - doubt).contains(&height) {
                offer(Touched::Net, tau);
            }
        }
        let floor = table.surface_z_m - TABLE_HEIGHT_M + self.radius_m;
        if end[2] <= floor && state[2] > floor && end[5] < -ROLLING_M_S {
            offer(Touched::Floor, self.crossing_time(state, h, 2, floor));
        }
        first
    }

    /// When coordinate `axis`, on different sides of `level` now and after `h`, passes it: Newton's
    /// method on the flight itself, kept between the two ends.
    pub(super) fn crossing_time(&self, state: &State, h: f64, axis: usize, level: f64) -> f64 {
        let mut tau = {
            let end = self.forces.step(state, h);
            let span = end[axis] - state[axis];
            if span.abs() < 1e-12 { return h } else { h * (level - state[axis]) / span }
        };
        for _ in 0..4 {
            let at = self.forces.step(state, tau);
            let rate = at[axis + 3];
            if rate.abs() < 1e-6 {
                break;
            }
            tau = (tau - (at[axis] - level) / rate).clamp(0.0, h);
        }
        tau
    }

    /// Carries a belief over a contact at its mean's instant. Members of the belief that touch earlier or
    /// later are carried along by the saltation matrix S = D + (f⁺ − D f⁻) nᵀ / (nᵀ f⁻) (Kong et al. 2024,
    /// "Saltation matrices: the essential tool for linearizing hybrid dynamical systems").
    fn touch(&self, belief: &mut Belief, touched: Touched, exempt: &mut Exempt) {
        if let (Touched::Table, Some(leaving)) = (touched, self.leaving) {
            self.cut(belief, leaving);
        }
        let before = belief.mean;
        let (after, d, q, axis) = match touched {
            Touched::Table | Touched::Floor => {
                let (surface, scatter) = if touched == Touched::Table {
                    (&self.table_surface, self.noise.bounce)
                } else {
                    let unknown = BounceScatter { normal: 0.1, tangential: 0.3, tangential_floor_m_s: 0.1 };
                    (&self.floor_surface, unknown)
                };
                let (after, d) = surface.bounce(&before);
                (after, d, surface.scatter(&scatter, &before, &after), 2)
            }
            Touched::Net => {
                let (after, d, q) = net_contact(&before);
                exempt.net = true;
                (after, d, q, 1)
            }
        };
        let rate = |s: &State| {
            let mut f = State::zeros();
            let (_, v, _) = split(s);
            f.fixed_rows_mut::<3>(0).copy_from(&v);
            // The accelerations of ½ ms; contacts change velocities by far more.
            let a = (self.forces.step(s, 5e-4) - s).fixed_rows::<3>(3) / 5e-4;
            f.fixed_rows_mut::<3>(3).copy_from(&a);
            f
        };
        let (f_before, f_after) = (rate(&before), rate(&after));
        // A grazing contact has no instant to first order: bounded.
        let normal_rate = f_before[axis].signum() * f_before[axis].abs().max(0.3);
        let mut s = d;
        let jump = (f_after - d * f_before) / normal_rate;
        let mut column = s.column_mut(axis);
        column += jump;
        belief.map(after, &s);
        belief.covariance += q;
    }

    /// Chance that a ball believed to be as `before` just before a bounce leaves it rolling.
    pub fn chance_of_rolling(&self, before: &Belief) -> f64 {
        let (grip, by) = self.table_surface.grip(&before.mean);
        let sigma = by.dot(&(before.covariance * by)).max(1e-12).sqrt();
        normal_cdf(grip / sigma)
    }

    /// What is left of a belief just before a bounce when it is known how the ball will leave: the moments of
    /// the normal distribution cut at the plane where friction just stops the slip.
    fn cut(&self, belief: &mut Belief, leaving: Leaving) {
        let (grip, by) = self.table_surface.grip(&belief.mean);
        let sign = if leaving == Leaving::Rolling { 1.0 } else { -1.0 };
        let lever = belief.covariance * by;
        let sigma = by.dot(&lever).max(1e-12).sqrt();
        let z = sign * grip / sigma;
        let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        let hazard = density / normal_cdf(z).max(1e-6);
        let reduced = hazard * (hazard + z);
        let struck = belief.struck_cross * by;
        belief.mean += lever * (sign * hazard / sigma);
        belief.struck_spin += struck * (sign * hazard / sigma);
        let share = reduced.clamp(0.0, 0.99) / (sigma * sigma);
        belief.covariance -= lever * lever.transpose() * share;
        belief.struck_covariance -= struck * struck.transpose() * share;
        belief.struck_cross -= struck * lever.transpose() * share;
    }

    /// A ball that has stopped bouncing rolls: it stays on the table.
    fn keep_on_table(&self, belief: &mut Belief, exempt: &Exempt) {
        let Some(table) = self.table else { return };
        let level = table.surface_z_m + self.radius_m;
        let m = &mut belief.mean;
        let over = !table.edges_known || table.inside_by(m[0], m[1]) > 0.0;
        if !exempt.table
            && over
            && m[2] < level
            && m[2] > level - PENETRATION_M
            && m[5].abs() <= 2.0 * ROLLING_M_S
        {
            m[2] = level;
            m[5] = m[5].max(0.0);
        }
    }
}

/// The distribution function of the standard normal distribution.
fn normal_cdf(z: f64) -> f64 {
    0.5 * (1.0 + erf(z * std::f64::consts::FRAC_1_SQRT_2))
}
