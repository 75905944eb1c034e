use nalgebra::Vector3;
use rand::RngExt as _;
use rand_pcg::Pcg64;

use super::{Body, Paint, Rgb, Texture, look::Difficulty};
use crate::synthetic::flight::{FLOOR_Z_M, TABLE_HALF_LENGTH_M, TABLE_HALF_WIDTH_M};

/// What moves beside the ball: balls that are not in play, and the players.
#[derive(Debug, Clone)]
pub struct Cast {
    decoys: Vec<Decoy>,
    players: Vec<Player>,
}

/// A ball of the same size that is not in play: at rest, or rolling to and fro.
#[derive(Debug, Clone, Copy)]
struct Decoy {
    from: Vector3<f64>,
    to: Vector3<f64>,
    /// There and back, s.
    period_s: f64,
    paint: Paint,
}

/// Bodies of one player.
const PLAYER_BODIES: usize = 12;

#[derive(Debug, Clone, Copy)]
struct Player {
    stand: Vector3<f64>,
    facing: f64,
    sway_s: f64,
    phase: f64,
    shirt: Paint,
    shorts: Paint,
    skin: Paint,
    paddle: Paint,
}

const HANDLE: Paint = Paint::plain([0.50, 0.36, 0.22]);

const SKINS: [Rgb; 3] = [[0.72, 0.48, 0.36], [0.45, 0.28, 0.19], [0.80, 0.58, 0.46]];

impl Cast {
    /// Chosen by `random` for a difficulty; `ball` and `radius_m` are those of the ball in play, which
    /// decoys share.
    pub fn new(difficulty: &Difficulty, ball: Paint, radius_m: f64, random: &mut Pcg64) -> Self {
        let decoys = (0..difficulty.decoys).map(|i| Self::decoy(i, ball, radius_m, random)).collect();
        let players = (0..difficulty.players)
            .map(|i| {
                let facing = if i % 2 == 0 { 1.0 } else { -1.0 };
                let plain = Rgb::from(std::array::from_fn(|_| random.random_range(0.05..0.8)));
                // Every second shirt has the ball's colour.
                let colour = if random.random_bool(difficulty.alike) { ball.colour } else { plain };
                let texture = match random.random_range(0..3) {
                    0 => Texture::Plain,
                    1 => Texture::Stripes(1.5),
                    _ => Texture::Checks(2.0),
                };
                let dark = [0.05, 0.05, 0.07];
                Player {
                    stand: Vector3::new(
                        random.random_range(-0.3..0.3),
                        -facing * random.random_range(2.0..2.5),
                        0.0,
                    ),
                    facing,
                    sway_s: random.random_range(1.1..1.9),
                    phase: random.random_range(0.0..6.0),
                    shirt: Paint { colour, other: plain, texture, gloss: 0.0 },
                    shorts: Paint::plain(dark),
                    skin: Paint::plain(SKINS[random.random_range(0..SKINS.len())]),
                    paddle: Paint::plain(if random.random_bool(0.5) {
                        [0.55, 0.06, 0.05]
                    } else {
                        [0.04; 3]
                    }),
                }
            })
            .collect();
        Self { decoys, players }
    }

    /// Nobody and nothing.
    pub const fn nobody() -> Self {
        Self { decoys: Vec::new(), players: Vec::new() }
    }

    fn decoy(index: usize, ball: Paint, radius_m: f64, random: &mut Pcg64) -> Decoy {
        let on_table = index.is_multiple_of(3);
        let place = |random: &mut Pcg64| {
            if on_table {
                let x = random.random_range(-1.0..1.0) * (TABLE_HALF_WIDTH_M - 0.03);
                let y = random.random_range(0.5..0.97) * TABLE_HALF_LENGTH_M;
                Vector3::new(x, if random.random_bool(0.5) { y } else { -y }, radius_m)
            } else {
                let x = random.random_range(0.95..1.9);
                let y = random.random_range(-1.9..1.9);
                Vector3::new(if random.random_bool(0.5) { x } else { -x }, y, FLOOR_Z_M + radius_m)
            }
        };
        let from = place(random);
        // A third of them lie still. One that rolls stays on its side of the table.
        let to = if index % 3 == 1 {
            from
        } else {
            Vector3::new(
                from.x + 0.1 * from.x.signum() * random.random_range(-1.0..0.2),
                -from.y.signum() * 0.2 + 0.6 * from.y,
                from.z,
            )
        };
        let shade = random.random_range(0.85..1.0);
        let paint = Paint { colour: ball.colour.map(|c| c * shade), ..ball };
        Decoy { from, to, period_s: random.random_range(4.0..9.0), paint }
    }

    /// Most bodies that [`Self::bodies`] gives.
    pub fn size(&self) -> usize {
        self.decoys.len() + self.players.len() * PLAYER_BODIES
    }

    /// How often the picture of body `index` must be renewed, s: hips, chests, heads and legs are large, and move
    /// no more than some pixels in this time.
    pub fn renewal_s(&self, index: usize) -> f64 {
        match index.checked_sub(self.decoys.len()) {
            None => 0.02,
            Some(part) if part % PLAYER_BODIES < 5 => 0.20,
            Some(_) => 0.08,
        }
    }

    /// Body `index` as it is at `t_s`; `radius_m` is the balls'.
    pub fn body(&self, index: usize, t_s: f64, radius_m: f64) -> Option<Body> {
        let (mut found, mut i) = (None, 0);
        self.bodies(t_s, radius_m, |body| {
            if i == index {
                found = Some(body);
            }
            i += 1;
        });
        found
    }

    /// Calls `body` for each body as it is at `t_s`; `radius_m` is the balls'.
    pub fn bodies(&self, t_s: f64, radius_m: f64, mut body: impl FnMut(Body)) {
        for decoy in &self.decoys {
            let share = 0.5 - 0.5 * (t_s * std::f64::consts::TAU / decoy.period_s).cos();
            body(Body::sphere(decoy.from.lerp(&decoy.to, share), radius_m, decoy.paint));
        }
        for player in &self.players {
            player.bodies(t_s, &mut body);
        }
    }
}

impl Player {
    fn bodies(&self, t_s: f64, body: &mut impl FnMut(Body)) {
        let swing = |speed: f64, offset: f64| {
            (t_s * std::f64::consts::TAU / self.sway_s * speed + self.phase + offset).sin()
        };
        let at = self.stand + Vector3::new(0.12 * swing(0.2, 0.0), 0.05 * swing(0.3, 1.0), 0.0);
        let f = self.facing;
        let up = |x: f64, y: f64, z: f64| at + Vector3::new(x, f * y, z);
        let hip = up(0.0, -0.05, 0.10);
        let chest = up(0.015 * swing(0.5, 0.3), 0.08, 0.42);
        let head = up(0.02 * swing(0.5, 0.6), 0.18, 0.82);
        let hand = up(
            0.32 * f + 0.25 * swing(1.0, 0.0),
            0.50 + 0.22 * swing(1.0, 1.2),
            0.28 + 0.12 * swing(1.0, 2.0),
        );
        let elbow = up(0.30 * f, 0.18, 0.26);
        let other = up(-0.30 * f, 0.30 + 0.05 * swing(0.8, 0.0), 0.25);
        body(Body::upright(hip, [0.19, 0.15, 0.20], self.shorts));
        body(Body::upright(chest, [0.24, 0.16, 0.34], self.shirt));
        body(Body::upright(head, [0.09, 0.11, 0.13], self.skin));
        for side in [-0.11, 0.11] {
            let foot = self.stand + Vector3::new(1.6 * side, -f * 0.05, FLOOR_Z_M);
            body(Body::limb(hip + Vector3::new(side, 0.0, -0.05), foot, 0.07, self.skin));
        }
        body(Body::limb(up(0.2 * f, 0.10, 0.60), elbow, 0.055, self.shirt));
        body(Body::limb(elbow, hand, 0.042, self.skin));
        body(Body::sphere(hand, 0.05, self.skin));
        let blade = hand + Vector3::new(0.02 * f, f * 0.12, 0.05);
        body(Body::limb(hand, blade, 0.015, HANDLE));
        body(Body::disc(blade, Vector3::new(0.3 * swing(1.0, 0.5), f, 0.35), 0.08, self.paddle));
        body(Body::limb(up(-0.2 * f, 0.10, 0.60), other, 0.05, self.shirt));
        body(Body::sphere(other, 0.05, self.skin));
    }
}
