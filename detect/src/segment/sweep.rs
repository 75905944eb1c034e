//! The image of a ball that moves during the exposure: a disc swept along a short straight path.

use super::{
    lanes::Lanes,
    look::{Look, TERMS, turned},
};

/// Shortest path that the formulas are evaluated for, px: a path this short shifts no edge by more than
/// its own 1/24th of a square, and a shorter one loses digits.
pub const MIN_LENGTH_PX: f32 = 0.25;

/// A swept disc in the rectified coordinates of a patch, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sweep {
    /// Centre at mid-exposure.
    pub centre: [f32; 2],
    /// Radius of the disc.
    pub radius: f32,
    /// Length of the path of its centre.
    pub length: f32,
    /// Direction of the path, radians from x towards y.
    pub angle: f32,
}

impl Sweep {
    /// Area of the swept disc, px².
    pub fn area(&self) -> f32 {
        self.radius * (std::f32::consts::PI * self.radius + 2.0 * self.length)
    }

    /// The path of the centre, as a vector.
    pub fn path(&self) -> [f32; 2] {
        [self.length * self.angle.cos(), self.length * self.angle.sin()]
    }
}

/// What one pixel sees of the ball, with the derivatives that the fit needs.
#[derive(Debug, Clone, Copy)]
pub struct Coverage<L> {
    /// Share of pixel and exposure that the ball covers, 0–1.
    pub alpha: L,
    /// ∂alpha by: centre along the path, centre across it, radius, length, angle.
    pub slopes: [L; 5],
    /// What the ball's shading is made of, as means over the time of cover: light from all around; the place on
    /// the ball along and across the path, in units of the radius; the share of the main light that the surface
    /// there catches; and how that share grows as the light turns to either side. Light from all around, and the
    /// mean of the main one over the ball, bring their share of the diffuse light.
    pub place: [L; 6],
}

/// Evaluates [`Coverage`] for one sweep and colour.
#[derive(Debug, Clone, Copy)]
pub struct Coverer<L: Lanes> {
    level: L::Level,
    centre: [L; 2],
    direction: [L; 2],
    radius: L,
    radius2: L,
    inverse_radius: L,
    /// Keeps the derivative by the radius finite where it is not used.
    least_chord: L,
    half_length: L,
    /// Width of the box that stands for the pixel and the lens's blur, px.
    box_px: L,
    inverse_box: L,
    /// (L + box) / 2 and (L − box) / 2.
    ramps: [L; 2],
    inverse_length: L,
    /// The light's vectors, along the path, across it, and towards the camera.
    light: [[L; 3]; 3],
    /// The diffuse light, on the same axes.
    diffuse: [L; TERMS],
}

/// Gauss–Legendre nodes and weights over the width of a pixel.
const NODES: [(f32, f32); 3] = [(-0.387_298_35, 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.387_298_35, 5.0 / 18.0)];

impl<L: Lanes> Coverer<L> {
    #[inline(always)]
    pub fn new(level: L::Level, sweep: &Sweep, look: &Look, channel: usize) -> Self {
        let all = |value| L::all(level, value);
        let box_px = look.box_px;
        let length = sweep.length.max(MIN_LENGTH_PX);
        let (sin, cos) = sweep.angle.sin_cos();
        Self {
            level,
            centre: sweep.centre.map(&all),
            direction: [all(cos), all(sin)],
            radius: all(sweep.radius),
            radius2: all(sweep.radius * sweep.radius),
            inverse_radius: all(1.0 / sweep.radius),
            least_chord: all((0.5 * sweep.radius).sqrt()),
            half_length: all(0.5 * length),
            box_px: all(box_px),
            inverse_box: all(1.0 / box_px),
            ramps: [all(0.5 * (length + box_px)), all(0.5 * (length - box_px))],
            inverse_length: all(1.0 / length),
            light: look.light.map(|[x, y, z]| [x * cos + y * sin, y * cos - x * sin, z].map(all)),
            diffuse: turned(&look.diffuse[channel], &[[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
                .map(all),
        }
    }

    #[inline(always)]
    fn all(&self, value: f32) -> L {
        L::all(self.level, value)
    }

    /// The share of time and pixel that an edge at distance `x` has swept, its slope, and its derivative by
    /// the path's length: the integral of a box as long as the path convolved with a box one pixel long.
    #[inline(always)]
    fn edge(&self, x: L) -> (L, L, L) {
        let [outer, inner] = self.ramps;
        let half = self.all(0.5);
        let x = x.min(outer).max(self.all(0.0) - outer);
        let a = (x + outer).positive();
        let b = (x + inner).positive();
        let c = (x - inner).positive();
        let d = (x - outer).positive();
        let scale = self.inverse_length * self.inverse_box;
        let share = half * (a * a - b * b - c * c + d * d) * scale;
        let slope = (a - b - c + d) * scale;
        let by_length = (half * (a - b + c - d) * self.inverse_box - share) * self.inverse_length;
        (share, slope, by_length)
    }

    /// The share of the exposure during which the point at `s` along and `w` across the path is covered.
    #[inline(always)]
    fn swept(&self, s: L, w: L) -> L {
        let chord = (self.radius2 - w * w).positive().sqrt();
        self.edge(s + chord).0 - self.edge(s - chord).0
    }

    /// For pixels at `x`, `y`.
    ///
    /// A pixel is taken as a square whose sides lie along and across the path; exact along, three Gauss
    /// nodes across.
    #[inline(always)]
    pub fn at(&self, x: L, y: L) -> Coverage<L> {
        let (dx, dy) = (x - self.centre[0], y - self.centre[1]);
        let [cos, sin] = self.direction;
        let s = dx * cos + dy * sin;
        let w = dy * cos - dx * sin;
        let zero = self.all(0.0);
        let middle_chord = (self.radius2 - w * w).positive().sqrt();
        let (mut alpha, mut by_s, mut by_l, mut by_chord) = (zero, zero, zero, zero);
        for (node, weight) in NODES {
            let chord = if node == 0.0 {
                middle_chord
            } else {
                let w = self.all(node).times_plus(self.box_px, w);
                (self.radius2 - w * w).positive().sqrt()
            };
            let weight = self.all(weight);
            let (far, far_slope, far_length) = self.edge(s + chord);
            let (near, near_slope, near_length) = self.edge(s - chord);
            alpha = weight.times_plus(far - near, alpha);
            by_s = weight.times_plus(far_slope - near_slope, by_s);
            by_l = weight.times_plus(far_length - near_length, by_l);
            by_chord = weight.times_plus(far_slope + near_slope, by_chord);
        }
        // alpha is an integral over the pixel's width: its derivative by a shift across the path is the
        // difference of the two ends, however steep the rim.
        let end = self.all(0.5) * self.box_px;
        let by_w = (self.swept(s, w + end) - self.swept(s, w - end)) * self.inverse_box;
        // The chord depends on r² − w² only, so that ∂/∂r = −(r / w) ∂/∂w: off the middle this is the one
        // without a pole. Near the middle the chord hardly differs from node to node.
        let off_middle = w * w - self.all(0.25) * self.radius2;
        let (numerator, denominator) = (
            by_chord.unless_positive(off_middle),
            middle_chord.max(self.least_chord).unless_positive(off_middle),
        );
        let numerator = numerator - by_w.where_positive(off_middle);
        let denominator = denominator + w.where_positive(off_middle);
        let by_r = numerator * self.radius * denominator.recip();

        // Where on the ball: the part of the chord that lay over this pixel during the exposure.
        let chord = middle_chord;
        let low = (s - self.half_length).max(zero - chord);
        let high = (s + self.half_length).min(chord);
        let middle = (self.all(0.5) * (low + high)).max(zero - chord).min(chord) * self.inverse_radius;
        let extent = (high - low).positive() * self.inverse_radius;
        let across = (w * self.inverse_radius).max(self.all(-1.0)).min(self.all(1.0));
        // Two Gauss nodes over that part.
        let spread = extent * self.all(0.288_675_13);
        let rest = self.all(1.0) - across * across;
        let half = self.all(0.5);
        let (mut caught, mut diffuse) = ([zero; 3], zero);
        for along in [middle - spread, middle + spread] {
            let towards = (rest - along * along).positive().sqrt();
            let towards_of = |[x, w, z]: [L; 3]| along * x + across * w + towards * z;
            let cosine = towards_of(self.light[0]);
            caught[0] = caught[0] + half * cosine.positive();
            for i in 1..3 {
                caught[i] = caught[i] + half * towards_of(self.light[i]).where_positive(cosine);
            }
            let [x, y, z, xx, xy, xz, yy, yz, zz] = self.diffuse;
            let by_along = xx.times_plus(along, xy.times_plus(across, xz.times_plus(towards, x)));
            let by_across = yy.times_plus(across, yz.times_plus(towards, y));
            let by_towards = zz.times_plus(towards, z);
            let sum = by_along * along + by_across * across + by_towards * towards;
            diffuse = half.times_plus(sum, diffuse);
        }
        let [a, b, c] = caught;
        // A lamp lights one half of all directions.
        let (around, a) = (self.all(1.0) + diffuse, half.times_plus(diffuse, a));
        Coverage {
            alpha,
            slopes: [zero - by_s, zero - by_w, by_r, by_l, by_s * w - by_w * s],
            place: [around, middle, across, a, b, c],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::{
            lanes::{Plain, PlainLanes},
            look::Light,
        },
        *,
    };

    fn at(sweep: &Sweep, x: f32, y: f32) -> Coverage<PlainLanes> {
        let [x, y] = [x, y].map(|place| PlainLanes::all(Plain, place));
        Coverer::new(Plain, sweep, &Look::lit_by(Light::default(), 1.0), 0).at(x, y)
    }

    fn alpha(sweep: &Sweep, x: f32, y: f32) -> f32 {
        at(sweep, x, y).alpha.to_array()[0]
    }

    /// Counts sub-pixels and instants.
    fn brute_force(sweep: &Sweep, x: f32, y: f32) -> f32 {
        let (n, times) = (24, 96);
        let [px, py] = sweep.path();
        let mut inside = 0;
        for t in 0..times {
            let t = (t as f32 + 0.5) / times as f32 - 0.5;
            for i in 0..n * n {
                let u = x + ((i % n) as f32 + 0.5) / n as f32 - 0.5 - sweep.centre[0] - t * px;
                let v = y + ((i / n) as f32 + 0.5) / n as f32 - 0.5 - sweep.centre[1] - t * py;
                inside += i32::from(u * u + v * v < sweep.radius * sweep.radius);
            }
        }
        inside as f32 / (n * n * times) as f32
    }

    #[test]
    fn coverage_is_what_counting_sub_pixels_gives() {
        for (radius, length, angle) in [(2.0, 0.0, 0.0), (5.3, 9.0, 0.0), (7.5, 30.0, 0.6), (3.0, 2.0, -1.1)]
        {
            let sweep = Sweep { centre: [0.3, -0.2], radius, length, angle };
            let reach = (radius + 0.5 * length + 2.0) as i32;
            let (mut worst, mut total, mut expected_total) = (0.0_f32, 0.0, 0.0);
            for y in -reach..=reach {
                for x in -reach..=reach {
                    let expected = brute_force(&sweep, x as f32, y as f32);
                    let found = alpha(&sweep, x as f32, y as f32);
                    worst = worst.max((found - expected).abs());
                    total += found;
                    expected_total += expected;
                }
            }
            assert!(worst < 0.07, "radius {radius}, length {length}: {worst}");
            assert!((total / expected_total - 1.0_f32).abs() < 1.2e-2, "{total} {expected_total}");
        }
    }

    #[test]
    fn slopes_are_those_of_finite_differences() {
        let sweep = Sweep { centre: [0.3, -0.2], radius: 6.0, length: 12.0, angle: 0.5 };
        let h = 2e-2;
        let (sin, cos) = sweep.angle.sin_cos();
        let moved = |i: usize, sign: f32| {
            let mut s = sweep;
            match i {
                0 => s.centre = [s.centre[0] + sign * h * cos, s.centre[1] + sign * h * sin],
                1 => s.centre = [s.centre[0] - sign * h * sin, s.centre[1] + sign * h * cos],
                2 => s.radius += sign * h,
                3 => s.length += sign * h,
                _ => s.angle += sign * 3.0 * h,
            }
            s
        };
        // Summed over the image against a smooth weight: single pixels at the rim have kinks.
        for i in 0..5 {
            let (mut analytic, mut numeric) = (0.0, 0.0);
            let step = if i == 4 { 3.0 * h } else { h };
            for y in -16..=16 {
                for x in -16..=16 {
                    let (x, y) = (x as f32, y as f32);
                    let weight = 1.0 + 0.1 * x - 0.07 * y + 0.01 * x * y;
                    let at = at(&sweep, x, y);
                    analytic += weight * at.slopes[i].to_array()[0];
                    numeric +=
                        weight * (alpha(&moved(i, 1.0), x, y) - alpha(&moved(i, -1.0), x, y)) / (2.0 * step);
                }
            }
            let scale = f32::max(numeric.abs(), 1.0);
            // A turn moves the pixels' own squares too, which the model turns with the path.
            let tolerance = if i == 4 { 0.2 } else { 0.1 };
            assert!((analytic - numeric).abs() < tolerance * scale, "slope {i}: {analytic} {numeric}");
        }
    }
}
