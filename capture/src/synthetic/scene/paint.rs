use std::f64::consts::PI;

use crate::synthetic::render::hash;

/// Reflectance of red, green and blue, 0–1.
pub type Rgb = [f32; 3];

/// How a surface looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Paint {
    /// Reflectance.
    pub colour: Rgb,
    /// A second colour, mixed in by the texture.
    pub other: Rgb,
    /// How the two are mixed.
    pub texture: Texture,
    /// Share of a lamp that a highlight throws back, 0–1.
    pub gloss: f32,
}

/// Where a surface shows its second colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Texture {
    /// Nowhere.
    Plain,
    /// In stripes along the second coordinate, so many in a metre (or in a body's radius).
    Stripes(f32),
    /// In squares, so many in a metre.
    Checks(f32),
    /// In clouds of this size in metres, with this seed.
    Clouds(f32, u32),
}

impl Paint {
    /// One colour without texture.
    pub const fn plain(colour: Rgb) -> Self {
        Self { colour, other: colour, texture: Texture::Plain, gloss: 0.0 }
    }

    /// The reflectance at `(s, t)`, in metres on the surface.
    pub fn at(&self, s: f64, t: f64) -> Rgb {
        let share = match self.texture {
            Texture::Plain => return self.colour,
            Texture::Stripes(per_m) => {
                (0.5 + 2.0 * (f64::from(per_m) * t * 2.0 * PI).sin()).clamp(0.0, 1.0) as f32
            }
            Texture::Checks(per_m) => {
                let k = f64::from(per_m) * PI;
                (0.5 + 8.0 * (k * s).sin() * (k * t).sin()).clamp(0.0, 1.0) as f32
            }
            Texture::Clouds(size_m, seed) => {
                let k = 1.0 / size_m;
                let (s, t) = (s as f32 * k, t as f32 * k);
                0.7 * value_noise(s, t, seed) + 0.3 * value_noise(s * 5.3, t * 5.3, seed ^ 0x55)
            }
        };
        std::array::from_fn(|c| self.colour[c] + share * (self.other[c] - self.colour[c]))
    }
}

/// Values 0–1 at whole coordinates, smoothly joined between them.
fn value_noise(s: f32, t: f32, seed: u32) -> f32 {
    let (i, j) = (s.floor(), t.floor());
    let ease = |x: f32| x * x * (3.0 - 2.0 * x);
    let (fs, ft) = (ease(s - i), ease(t - j));
    let at = |di: i64, dj: i64| {
        let (i, j) = ((i as i64 + di) as u64, (j as i64 + dj) as u64);
        let h = hash(i.wrapping_mul(0x0100_0000_01b3) ^ (j << 32) ^ u64::from(seed));
        (h >> 40) as f32 / (1_u64 << 24) as f32
    };
    let top = at(0, 0) + fs * (at(1, 0) - at(0, 0));
    let bottom = at(0, 1) + fs * (at(1, 1) - at(0, 1));
    top + ft * (bottom - top)
}
