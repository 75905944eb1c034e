use nalgebra::Vector3;
use rand::RngExt as _;
use rand_pcg::Pcg64;

use super::{
    Light, Paint, Rgb, Texture,
    look::{Difficulty, FLOORS, TABLES, WALLS},
};
use crate::synthetic::flight::{
    FLOOR_Z_M, NET_HALF_WIDTH_M, NET_HEIGHT_M, TABLE_HALF_LENGTH_M, TABLE_HALF_WIDTH_M,
};

/// What stands still: the table with its net, the hall and the things in it.
#[derive(Debug, Clone)]
pub struct Room {
    blocks: Vec<Block>,
    /// Corners of the hall's inside, m.
    hall: (Vector3<f64>, Vector3<f64>),
    floor: Paint,
    walls: Paint,
    light: Light,
    net: Rgb,
}

/// An upright cuboid.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    /// Lowest corner, m.
    pub low: Vector3<f64>,
    /// Highest corner, m.
    pub high: Vector3<f64>,
    paint: Paint,
    kind: BlockKind,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum BlockKind {
    TableTop,
    Thing,
}

/// A face of a cuboid, or of the hall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Face {
    block: usize,
    /// Across which axis it lies, and where.
    axis: usize,
    at_m: f64,
    /// Whether rays that meet it run against the axis.
    backward: bool,
}

impl Face {
    /// Tells faces apart.
    pub fn surface(&self) -> u16 {
        (self.block.min(0xfff) * 6 + self.axis * 2 + usize::from(self.backward)) as u16
    }
}

/// What a ray meets.
#[derive(Debug, Clone, Copy)]
pub struct Hit {
    /// Along the ray, in lengths of its direction.
    pub distance: f64,
    /// Reflectance times irradiance.
    pub radiance: Rgb,
}

/// What a ray meets of the net.
#[derive(Debug, Clone, Copy)]
pub struct NetHit {
    /// Along the ray.
    pub distance: f64,
    /// Share of the light that the net holds back.
    pub opacity: f32,
    /// Its radiance.
    pub radiance: Rgb,
}

/// Share of its area that the mesh's threads cover.
const MESH_OPACITY: f32 = 0.38;
/// White band along the top of the net.
const BAND_M: f64 = 0.015;
/// Half its thickness, with the cord inside it.
const HALF_TAPE_M: f64 = 0.004;
/// White lines along the sides of the table, and down its middle.
const LINE_M: f64 = 0.020;
const MIDDLE_LINE_M: f64 = 0.003;

impl Room {
    /// Chosen by `random` for a difficulty; `alike` is the colour of the ball, which some things share.
    pub fn new(difficulty: &Difficulty, light: Light, alike: Rgb, random: &mut Pcg64) -> Self {
        let mut pick = |list: &[Rgb]| list[random.random_range(0..list.len())];
        let (table, floor, wall) = (pick(&TABLES), pick(&FLOORS), pick(&WALLS));
        let clouds = |colour: Rgb, size: f32, swing: f32, random: &mut Pcg64| Paint {
            colour: colour.map(|c| c * (1.0 - swing)),
            other: colour.map(|c| (c * (1.0 + swing)).min(0.95)),
            texture: Texture::Clouds(size, random.random()),
            gloss: 0.0,
        };
        let floor = clouds(floor, random.random_range(0.05..0.6), 0.22, random);
        let walls = clouds(wall, random.random_range(0.2..1.5), 0.12, random);
        let half = Vector3::new(random.random_range(3.0..4.5), random.random_range(5.0..7.0), 0.0);
        let hall = (
            Vector3::new(-half.x, -half.y, FLOOR_Z_M),
            Vector3::new(half.x, half.y, random.random_range(2.2..3.5)),
        );
        let mut blocks = vec![Block {
            low: Vector3::new(-TABLE_HALF_WIDTH_M, -TABLE_HALF_LENGTH_M, -0.025),
            high: Vector3::new(TABLE_HALF_WIDTH_M, TABLE_HALF_LENGTH_M, 0.0),
            paint: clouds(table, 0.8, 0.04, random),
            kind: BlockKind::TableTop,
        }];
        for (x, y) in [(-0.6, -1.1), (0.6, -1.1), (-0.6, 1.1), (0.6, 1.1)] {
            blocks.push(Block::thing((x, y), (0.03, 0.03), (FLOOR_Z_M, -0.03), Paint::plain([0.04; 3])));
        }
        for x in [-NET_HALF_WIDTH_M, NET_HALF_WIDTH_M] {
            let post = Paint::plain([0.06, 0.06, 0.07]);
            blocks.push(Block::thing((x, 0.0), (0.012, 0.012), (-0.06, NET_HEIGHT_M + 0.005), post));
        }
        // The tape along the net's top has a thickness: cameras that look along the net see nothing else of it.
        let tape = (NET_HALF_WIDTH_M, HALF_TAPE_M);
        let heights = (NET_HEIGHT_M - BAND_M, NET_HEIGHT_M);
        blocks.push(Block::thing((0.0, 0.0), tape, heights, Paint::plain([0.82; 3])));
        for _ in 0..difficulty.clutter {
            blocks.push(Block::clutter(difficulty, alike, &hall, random));
        }
        let grey = random.random_range(0.02..0.12);
        Self { blocks, hall, floor, walls, light, net: [grey, grey, grey * 1.1] }
    }

    /// The cuboids.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// What the ray from `origin` meets first, of the cuboids in `among` and the hall; the net not counted. `inverse`
    /// holds the inverses of its direction.
    pub fn meet(&self, origin: &Vector3<f64>, inverse: &Vector3<f64>, among: &[u16]) -> Face {
        let (distance, axis) = leave(&self.hall.0, &self.hall.1, origin, inverse);
        let mut nearest = (distance, axis, usize::MAX);
        for index in among {
            let block = &self.blocks[usize::from(*index)];
            if let Some((distance, axis)) = enter(&block.low, &block.high, origin, inverse)
                && distance < nearest.0
            {
                nearest = (distance, axis, usize::from(*index));
            }
        }
        let (_, axis, block) = nearest;
        let backward = inverse[axis] < 0.0;
        // Cuboids are entered from outside, the hall is left from inside.
        let at_m = match self.blocks.get(block) {
            Some(block) => {
                if backward {
                    block.high[axis]
                } else {
                    block.low[axis]
                }
            }
            None => {
                if backward {
                    self.hall.0[axis]
                } else {
                    self.hall.1[axis]
                }
            }
        };
        Face { block, axis, at_m, backward }
    }

    /// What the ray from `origin` along `direction` sees of a face. `pixel_at_1m` is how wide a pixel is at one
    /// metre: fine lines fade with it.
    pub fn see(&self, face: &Face, origin: &Vector3<f64>, direction: &Vector3<f64>, pixel_at_1m: f64) -> Hit {
        let axis = face.axis;
        let distance = (face.at_m - origin[axis]) / direction[axis];
        // A camera outside the hall sees through its walls to nothing in particular.
        let distance = if distance >= 0.0 { distance } else { 1e3 };
        let at = origin + direction * distance;
        let mut normal = Vector3::zeros();
        normal[axis] = if face.backward { 1.0 } else { -1.0 };
        let (s, t) = match axis {
            0 => (at.y as f32, at.z as f32),
            1 => (at.x as f32, at.z as f32),
            _ => (at.x as f32, at.y as f32),
        };
        let mut irradiance = self.light.on(&normal) as f32;
        let reflectance = match self.blocks.get(face.block) {
            Some(block) if block.kind == BlockKind::TableTop && axis == 2 && normal.z > 0.0 => {
                let width = pixel_at_1m * distance * direction.norm();
                let line = lines(&at, width) as f32;
                let top = block.paint.at(s, t);
                std::array::from_fn(|c| top[c] + line * (0.8 - top[c]))
            }
            Some(block) => block.paint.at(s, t),
            None if axis == 2 && at.z < 0.0 => {
                irradiance *= under_table(&at) as f32;
                self.floor.at(s, t)
            }
            None => self.walls.at(s, t),
        };
        Hit { distance, radiance: reflectance.map(|r| r * irradiance) }
    }

    /// What the ray meets of the net.
    pub fn net(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<NetHit> {
        let distance = -origin.y / direction.y;
        if !(distance.is_finite() && distance > 0.0) {
            return None;
        }
        let at = origin + direction * distance;
        if at.x.abs() > NET_HALF_WIDTH_M || !(0.0..NET_HEIGHT_M).contains(&at.z) {
            return None;
        }
        let side = Vector3::new(0.0, -direction.y.signum(), 0.0);
        let irradiance = self.light.on(&side) as f32;
        let band = at.z > NET_HEIGHT_M - BAND_M;
        let colour = if band { [0.82; 3] } else { self.net };
        let opacity = if band { 1.0 } else { MESH_OPACITY };
        Some(NetHit { distance, opacity, radiance: colour.map(|c| c * irradiance) })
    }

    /// The light.
    pub const fn light(&self) -> &Light {
        &self.light
    }
}

impl Block {
    fn thing((x, y): (f64, f64), (hx, hy): (f64, f64), (low, high): (f64, f64), paint: Paint) -> Self {
        Self {
            low: Vector3::new(x - hx, y - hy, low),
            high: Vector3::new(x + hx, y + hy, high),
            paint,
            kind: BlockKind::Thing,
        }
    }

    /// A barrier, bench, box or poster somewhere beside the playing area.
    fn clutter(
        difficulty: &Difficulty,
        alike: Rgb,
        hall: &(Vector3<f64>, Vector3<f64>),
        random: &mut Pcg64,
    ) -> Self {
        let colour = if random.random_bool(0.5 * difficulty.alike) {
            alike.map(|c| c * random.random_range(0.7..1.0))
        } else {
            Rgb::from(std::array::from_fn(|_| random.random_range(0.02..0.85)))
        };
        let texture = match random.random_range(0..4) {
            0 => Texture::Plain,
            1 => Texture::Stripes(random.random_range(3.0..25.0)),
            2 => Texture::Checks(random.random_range(3.0..20.0)),
            _ => Texture::Clouds(random.random_range(0.05..0.4), random.random()),
        };
        let paint =
            Paint { colour, other: colour.map(|c| c * random.random_range(0.3..1.0)), texture, gloss: 0.0 };
        let sign = |random: &mut Pcg64| if random.random_bool(0.5) { 1.0 } else { -1.0 };
        let (sx, sy) = (sign(random), sign(random));
        let y = sy * random.random_range(0.0..hall.1.y - 0.8);
        // Nothing stands where the ball flies: 1.5 m beside the table, 3 m behind the net's ends.
        let x = if y.abs() < 2.9 {
            sx * random.random_range(2.0..hall.1.x - 0.2)
        } else {
            sx * random.random_range(0.0..hall.1.x - 0.2)
        };
        let half = (random.random_range(0.1..0.6), random.random_range(0.1..0.4));
        let height = random.random_range(0.1..1.0);
        Self::thing((x, y), half, (FLOOR_Z_M, FLOOR_Z_M + height), paint)
    }
}

/// Share of white at a point of the playing surface, whose pixels are `width_m` wide.
fn lines(at: &Vector3<f64>, width_m: f64) -> f64 {
    let inside = |from_edge: f64, line: f64| ((line - from_edge) / width_m + 0.5).clamp(0.0, 1.0);
    let side = inside(TABLE_HALF_WIDTH_M - at.x.abs(), LINE_M);
    let end = inside(TABLE_HALF_LENGTH_M - at.y.abs(), LINE_M);
    let middle = inside(at.x.abs(), 0.5 * MIDDLE_LINE_M) * (MIDDLE_LINE_M / width_m).min(1.0);
    side.max(end).max(middle)
}

/// Share of the light that reaches the floor under and about the table.
fn under_table(at: &Vector3<f64>) -> f64 {
    let outside = (at.x.abs() - TABLE_HALF_WIDTH_M).max(at.y.abs() - TABLE_HALF_LENGTH_M);
    0.35 + 0.65 * ((outside + 0.35) / 0.7).clamp(0.0, 1.0)
}

/// Where a ray from outside enters a cuboid, and through the face across which axis; `inverse` holds the inverses of
/// its direction.
fn enter(
    low: &Vector3<f64>,
    high: &Vector3<f64>,
    origin: &Vector3<f64>,
    inverse: &Vector3<f64>,
) -> Option<(f64, usize)> {
    let (mut near, mut far, mut axis) = (0.0_f64, f64::INFINITY, usize::MAX);
    for i in 0..3 {
        let (a, b) = ((low[i] - origin[i]) * inverse[i], (high[i] - origin[i]) * inverse[i]);
        let (a, b) = (a.min(b), a.max(b));
        if a > near {
            (near, axis) = (a, i);
        }
        far = far.min(b);
    }
    (axis != usize::MAX && near < far).then_some((near, axis))
}

/// Where a ray from inside leaves a cuboid.
fn leave(
    low: &Vector3<f64>,
    high: &Vector3<f64>,
    origin: &Vector3<f64>,
    inverse: &Vector3<f64>,
) -> (f64, usize) {
    let mut nearest = (f64::INFINITY, 2);
    for i in 0..3 {
        let wall = if inverse[i] > 0.0 { high[i] } else { low[i] };
        let distance = (wall - origin[i]) * inverse[i];
        if distance >= 0.0 && distance < nearest.0 {
            nearest = (distance, i);
        }
    }
    // A camera outside the hall sees through its walls to nothing in particular.
    if nearest.0.is_finite() { nearest } else { (1e3, 2) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_enter_and_leave_boxes_where_geometry_says() {
        let (low, high) = (Vector3::new(-1.0, -1.0, -1.0), Vector3::new(1.0, 2.0, 1.0));
        let from = Vector3::new(0.2, 0.3, 5.0);
        let down = Vector3::new(0.0, 0.0, -2.0);
        let inverse = |v: Vector3<f64>| v.map(|c| 1.0 / c);
        assert_eq!(enter(&low, &high, &from, &inverse(down)), Some((2.0, 2)));
        assert_eq!(enter(&low, &high, &from, &inverse(-down)), None);
        assert_eq!(enter(&low, &high, &(from + Vector3::x() * 2.0), &inverse(down)), None);
        let inside = Vector3::new(0.0, 0.0, 0.0);
        assert_eq!(leave(&low, &high, &inside, &inverse(Vector3::new(0.1, 1.0, 0.2))), (2.0, 1));
    }
}
