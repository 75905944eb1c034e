//! What there is to see: a hall with a table, light, players, balls that lie about, and the ball.

mod body;
mod carried;
mod cast;
mod light;
mod look;
mod options;
mod paint;
mod room;

pub use body::Body;
pub use carried::{BoardPath, CarriedBoard, CarriedBoardError};
pub use cast::Cast;
pub use light::{Dimming, Flicker, Light};
pub use look::{Difficulty, Preset};
pub use options::{SceneError, SceneOptions};
pub use paint::{Paint, Rgb, Texture};
pub use room::{Block, Face, Hit, NetHit, Room};

use nalgebra::Vector3;
use netcord_common::rig::{BallColour, Rig};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::{
    flight::{Air, BallTrack, Contact, Rally, RecordedFlights, TrackPoint},
    render::SensorNoise,
};

/// A scene, settled in all it shows by its options and seed. Time zero is its beginning.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Table, net, hall and light.
    pub room: Room,
    /// Players and balls that are not in play.
    pub cast: Cast,
    /// The ball's surface.
    pub ball: Paint,
    /// The ball's radius, m.
    pub radius_m: f64,
    /// The sensor's noise.
    pub noise: SensorNoise,
    /// Grey values of white in full light: red, green, blue, and without a filter, DN. The three
    /// colours differ: raw frames know no white balance.
    pub white_dn: [f32; 4],
    /// Width of the lens's blur (standard deviation), px.
    pub blur_px: f64,
    /// Length of the exposure, ns, where the scene asks for one.
    pub exposure_ns: Option<u64>,
    /// What all noise comes from.
    pub seed: u64,
    /// A calibration board, where one is shown: then nobody plays.
    pub board: Option<CarriedBoard>,
    flights: Flights,
}

#[derive(Debug, Clone)]
enum Flights {
    Rally { air: Air, contact: Contact, style: super::flight::RallyStyle, seed: u64 },
    Recorded(RecordedFlights),
    Nobody,
}

impl Scene {
    /// The scene that `options` describe, for the ball and rate of `rig`.
    ///
    /// # Errors
    /// [`SceneError`] when the file of flights cannot be used, or the ball cannot be played.
    pub fn new(rig: &Rig, options: &SceneOptions) -> Result<Self, SceneError> {
        let difficulty = options.preset.difficulty();
        let mut random = Pcg64::seed_from_u64(options.seed);
        let random = &mut random;
        let white = match (rig.ball.colour, options.preset) {
            (BallColour::White, _) | (BallColour::Auto, Preset::Hard) => true,
            (BallColour::Orange, _) | (BallColour::Auto, Preset::Clean) => false,
            (BallColour::Auto, Preset::Normal) => random.random_bool(0.5),
        };
        let ball = if white { look::WHITE } else { look::ORANGE };
        let radius_m = rig.ball.radius_m();
        let light = light(&difficulty, random);
        let room = Room::new(&difficulty, light, ball.colour, random);
        let board = match &options.board {
            Some(spec) => Some(CarriedBoard::new(rig, spec, options.board_path.as_deref())?),
            None => None,
        };
        let mut cast = Cast::new(&difficulty, ball, radius_m, random);
        if board.is_some() {
            cast = Cast::nobody();
        }
        let channel = |share: f64| (difficulty.white_dn * share) as f32;
        let white_dn = [
            channel(random.random_range(0.55..0.95)),
            channel(1.0),
            channel(random.random_range(0.5..0.9)),
            channel(0.9),
        ];
        let blur_px = random.random_range(0.40..0.75);
        let flights = match &options.flights {
            _ if board.is_some() => Flights::Nobody,
            Some(path) => Flights::Recorded(RecordedFlights::read(path)?),
            None => Flights::Rally {
                // Constants differ from scene to scene within what has been published.
                air: Air::new(radius_m, random.random_range(0.44..0.50), random.random_range(0.10..0.14)),
                contact: Contact {
                    radius_m,
                    restitution: random.random_range(0.96..0.99),
                    restitution_slope_s_m: 0.02,
                    friction: random.random_range(0.22..0.30),
                    floor_restitution: 0.72,
                },
                style: difficulty.style,
                seed: random.random(),
            },
        };
        if let Flights::Rally { air, contact, style, seed } = &flights
            && !Rally::new(*air, *contact, *style, *seed).begins()
        {
            return Err(SceneError::NoFlight { diameter_m: rig.ball.diameter_m });
        }
        let exposure_ns = options.exposure_ns.or(difficulty.exposure_ns);
        let (noise, seed) = (difficulty.noise, options.seed);
        Ok(Self { room, cast, ball, radius_m, noise, white_dn, blur_px, exposure_ns, seed, board, flights })
    }

    /// Level of a pixel behind the filter `channel` (red, green, blue, none) at a radiance in full light,
    /// DN.
    pub fn level(&self, radiance: &Rgb, channel: usize) -> f32 {
        match radiance.get(channel) {
            Some(light) => light * self.white_dn[channel],
            None => {
                let [r, g, b] = radiance;
                (0.30 * r + 0.55 * g + 0.15 * b) * self.white_dn[3]
            }
        }
    }

    /// The ball's way through the scene. Every call gives an equal one.
    pub fn track(&self) -> Box<dyn BallTrack> {
        match &self.flights {
            Flights::Rally { air, contact, style, seed } => {
                Box::new(Rally::new(*air, *contact, *style, *seed))
            }
            Flights::Recorded(flights) => Box::new(flights.clone()),
            Flights::Nobody => Box::new(NoBall),
        }
    }
}

/// The track of a scene without a ball.
#[derive(Debug)]
struct NoBall;

impl BallTrack for NoBall {
    fn at(&mut self, _t_s: f64) -> Option<TrackPoint> {
        None
    }
}

/// Lamps above the table, now more from one side, now from the other.
fn light(difficulty: &Difficulty, random: &mut Pcg64) -> Light {
    let mut lamp = |strength: f64| {
        let to = Vector3::new(random.random_range(-0.5..0.5), random.random_range(-0.6..0.6), 1.0);
        (to.normalize(), strength)
    };
    let lamps = [lamp(0.38), lamp(0.22)];
    let (sky, ground) = (random.random_range(0.28..0.38), random.random_range(0.10..0.22));
    let light_hz = if random.random_bool(0.7) { 100.0 } else { 120.0 };
    Light {
        lamps,
        sky,
        ground,
        flicker: Flicker { light_hz, depth: difficulty.flicker, phase: random.random_range(0.0..6.0) },
        dimming: Dimming { period_s: random.random_range(14.0..30.0), depth: difficulty.dimming },
    }
}
