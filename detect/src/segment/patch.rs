use super::{
    lanes::LANES,
    look::{BOX_PX, Light, Look},
    sweep::Sweep,
};

/// Colours of a patch: red, green, blue; grey frames have only the first.
pub const CHANNELS: usize = 3;

/// Most pixels of one patch. Of larger regions only some cells are taken: this many give the centre to a
/// hundredth of a pixel already.
pub const MAX_SAMPLES: usize = 2400;

/// The map, to second order, between a neighbourhood of the image and coordinates in which the ball's outline is a
/// circle: a sphere seen off the axis is nearly an ellipse, on wide lenses by up to half again as long as wide, and
/// longer on its outer side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectifier {
    /// The pixel that becomes the origin.
    pub anchor: [f64; 2],
    /// Rows of the matrix from pixel offsets to rectified ones; its determinant is 1.
    pub forward: [[f64; 2]; 2],
    /// What is added to both rectified coordinates for x², x y and y² of the pixel offset.
    pub bend: [[f64; 3]; 2],
    /// What is added to both pixel offsets for x², x y and y² of the rectified one.
    pub unbend: [[f64; 3]; 2],
}

fn second_order(terms: &[[f64; 3]; 2], [x, y]: [f64; 2]) -> [f64; 2] {
    terms.map(|[xx, xy, yy]| x * (xx * x + xy * y) + yy * y * y)
}

impl Rectifier {
    /// Changes nothing but the origin.
    pub const fn plain(anchor: [f64; 2]) -> Self {
        Self { anchor, forward: [[1.0, 0.0], [0.0, 1.0]], bend: [[0.0; 3]; 2], unbend: [[0.0; 3]; 2] }
    }

    /// From the frame into the patch.
    pub fn rectify(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let offset = [u - self.anchor[0], v - self.anchor[1]];
        let ([x, y], [dx, dy]) = (self.rectify_offset(offset), second_order(&self.bend, offset));
        [x + dx, y + dy]
    }

    /// A small pixel offset in the patch.
    pub fn rectify_offset(&self, offset: [f64; 2]) -> [f64; 2] {
        self.forward.map(|row| row[0] * offset[0] + row[1] * offset[1])
    }

    /// The inverse matrix, from rectified offsets to pixel offsets.
    pub fn backward(&self) -> [[f64; 2]; 2] {
        let [[a, b], [c, d]] = self.forward;
        let determinant = a * d - b * c;
        [[d / determinant, -b / determinant], [-c / determinant, a / determinant]]
    }

    /// A small rectified offset in pixels.
    pub fn offset_px(&self, offset: [f64; 2]) -> [f64; 2] {
        self.backward().map(|row| row[0] * offset[0] + row[1] * offset[1])
    }

    /// From the patch into the frame.
    pub fn pixel(&self, rectified: [f64; 2]) -> [f64; 2] {
        let ([x, y], [dx, dy]) = (self.offset_px(rectified), second_order(&self.unbend, rectified));
        [self.anchor[0] + x + dx, self.anchor[1] + y + dy]
    }

    /// Half of the width and of the height, in pixels, of the image of a circle of `radius` in the patch.
    pub fn half_extent_px(&self, radius: f64) -> [f64; 2] {
        self.backward().map(|[a, b]| radius * a.hypot(b))
    }
}

/// The pixels of one colour, as columns; padded to whole vectors with pixels of weight zero.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// Rectified place.
    pub x: Vec<f32>,
    /// Rectified place.
    pub y: Vec<f32>,
    /// Level seen, DN.
    pub seen: Vec<f32>,
    /// Level expected of the background, DN.
    pub background: Vec<f32>,
    /// 1 / standard deviation of their difference, 1/DN.
    pub inverse_sigma: Vec<f32>,
}

impl Samples {
    fn with_capacity(n: usize) -> Self {
        let column = || Vec::with_capacity(n);
        Self { x: column(), y: column(), seen: column(), background: column(), inverse_sigma: column() }
    }

    /// How many, padding included.
    pub fn len(&self) -> usize {
        self.x.len()
    }

    fn clear(&mut self) {
        for column in self.columns() {
            column.clear();
        }
    }

    fn columns(&mut self) -> [&mut Vec<f32>; 5] {
        [&mut self.x, &mut self.y, &mut self.seen, &mut self.background, &mut self.inverse_sigma]
    }
}

/// The pixels around a candidate, apart by colour.
#[derive(Debug)]
pub struct Patch {
    /// By colour.
    pub channels: [Samples; CHANNELS],
    /// Cells of the frame that one cell of samples stands for.
    pub decimation: usize,
    /// Samples without padding.
    pub count: usize,
    /// How balls look there.
    pub look: Look,
}

/// One pixel as the patch takes it.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// Rectified place.
    pub rectified: [f32; 2],
    /// 0 red or grey, 1 green, 2 blue.
    pub channel: usize,
    /// Level seen, DN.
    pub seen: f32,
    /// Level expected of the background, DN.
    pub background: f32,
}

impl Patch {
    /// An empty patch, with room for all it will ever hold.
    pub fn new() -> Self {
        // A row of cells more than MAX_SAMPLES may come before decimation is seen to be needed, and padding.
        let room = MAX_SAMPLES + 4 * LANES;
        Self {
            channels: std::array::from_fn(|_| Samples::with_capacity(room)),
            decimation: 1,
            count: 0,
            look: Look::lit_by(Light::default(), BOX_PX),
        }
    }

    /// Forgets all samples.
    pub fn clear(&mut self, decimation: usize) {
        self.channels.iter_mut().for_each(Samples::clear);
        self.decimation = decimation;
        self.count = 0;
    }

    /// Adds a pixel; returns false where there is no more room.
    #[inline]
    pub fn push(&mut self, sample: &Sample) -> bool {
        let samples = &mut self.channels[sample.channel];
        if self.count >= MAX_SAMPLES {
            return false;
        }
        samples.x.push(sample.rectified[0]);
        samples.y.push(sample.rectified[1]);
        samples.seen.push(sample.seen);
        samples.background.push(sample.background);
        self.count += 1;
        true
    }

    /// Ends the gathering: weighs all samples by what `sigma` says of the level seen and that of the background,
    /// DN, and fills up the last vectors with samples of no weight.
    pub fn finish(&mut self, sigma: impl Fn(f32, f32) -> f32) {
        for samples in &mut self.channels {
            let Samples { seen, background, inverse_sigma, .. } = samples;
            inverse_sigma.extend(seen.iter().zip(&*background).map(|(s, b)| 1.0 / sigma(*s, *b)));
            let padded = samples.len().next_multiple_of(LANES);
            for column in samples.columns() {
                column.resize(padded, 0.0);
            }
        }
    }
}

#[cfg(test)]
impl Patch {
    /// Pixels of any level, on a square of 40 px around the origin: for tests of sums over them.
    pub fn of_noise(seed: u64) -> Self {
        use rand::{RngExt as _, SeedableRng as _};

        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        let mut patch = Self::new();
        for i in 0..1600 {
            let rectified = [(i % 40) as f32 - 19.5, (i / 40) as f32 - 19.5];
            let channel = rng.random_range(0..CHANNELS);
            let [seen, background] = [(); 2].map(|()| rng.random_range(0.0..255.9_f32).floor());
            patch.push(&Sample { rectified, channel, seen, background });
        }
        patch.finish(|seen, background| 1.0 + 0.01 * (seen + background));
        patch
    }
}

/// How far around a sweep pixels are looked at: the background beside the ball must be seen to be free.
pub fn margin(radius: f32) -> f32 {
    (0.35 * radius).clamp(2.5, 7.0)
}

/// Whether a rectified place lies on the sweep or within `margin` of it.
#[inline]
pub fn near(sweep: &Sweep, direction: [f32; 2], margin: f32, x: f32, y: f32) -> bool {
    let (dx, dy) = (x - sweep.centre[0], y - sweep.centre[1]);
    let s = (dx * direction[0] + dy * direction[1]).abs() - 0.5 * sweep.length;
    let w = dy * direction[0] - dx * direction[1];
    let s = s.max(0.0);
    let reach = sweep.radius + margin;
    s * s + w * w <= reach * reach
}
