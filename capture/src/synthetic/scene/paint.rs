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
    pub fn at(&self, s: f32, t: f32) -> Rgb {
        let share = match self.texture {
            Texture::Plain => return self.colour,
            Texture::Stripes(per_m) => Texture::stripes(per_m, t),
            Texture::Checks(per_m) => Texture::checks(per_m, s, t),
            Texture::Clouds(size_m, seed) => {
                let k = 1.0 / size_m;
                let (s, t) = (s * k, t * k);
                0.7 * value_noise(s, t, seed) + 0.3 * value_noise(s * 5.3, t * 5.3, seed ^ 0x55)
            }
        };
        std::array::from_fn(|c| self.colour[c] + share * (self.other[c] - self.colour[c]))
    }
}

impl Texture {
    /// Share of the second colour in stripes.
    #[inline]
    pub fn stripes(per_m: f32, t: f32) -> f32 {
        (0.5 + 2.0 * wave(per_m * t)).clamp(0.0, 1.0)
    }

    /// Share of the second colour in squares.
    #[inline]
    pub fn checks(per_m: f32, s: f32, t: f32) -> f32 {
        (0.5 + 8.0 * wave(0.5 * per_m * s) * wave(0.5 * per_m * t)).clamp(0.0, 1.0)
    }
}

/// A wave of length one between −1 and 1, of parabolas in place of a sine.
#[inline]
fn wave(x: f32) -> f32 {
    /// Adding and taking away 1.5 × 2²³ rounds to a whole number, without a call.
    const ROUND: f32 = 12_582_912.0;
    let x = x - ((x + ROUND) - ROUND);
    8.0 * x * (1.0 - 2.0 * x.abs())
}

/// Values 0–1 at whole coordinates, smoothly joined between them.
fn value_noise(s: f32, t: f32, seed: u32) -> f32 {
    let (i, j) = (floor(s), floor(t));
    let ease = |x: f32| x * x * (3.0 - 2.0 * x);
    let (fs, ft) = (ease(s - i as f32), ease(t - j as f32));
    let at = |di: i32, dj: i32| {
        let h = scatter((i + di) as u32, (j + dj) as u32, seed);
        (h >> 8) as f32 / (1_u32 << 24) as f32
    };
    let top = at(0, 0) + fs * (at(1, 0) - at(0, 0));
    let bottom = at(0, 1) + fs * (at(1, 1) - at(0, 1));
    top + ft * (bottom - top)
}

/// The next whole number below, without a call.
fn floor(x: f32) -> i32 {
    let whole = x as i32;
    whole - i32::from(x < whole as f32)
}

/// Thirty-two bits that look random: two rounds of xor-shift and multiply, after Wellons' search for such
/// constants (lowbias32).
fn scatter(i: u32, j: u32, seed: u32) -> u32 {
    let h = i.wrapping_mul(0x9e37_79b1) ^ j.wrapping_mul(0x85eb_ca77) ^ seed;
    let h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
    let h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}
