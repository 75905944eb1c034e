//! What the balls of one camera have in common, learnt from those that surely are balls.
//!
//! Every ball is seen in the light of the same room through the same lens: what one ball leaves open, many tell. The
//! parameters that balls share (the diffuse light by colour, the width of the blur) and those of each ball (its
//! outline and shading) are estimated together by least squares. Those of a ball are eliminated from its normal
//! equations at once, and what is left for the shared ones, their Schur complement, is summed over the balls, as in
//! the bundle adjustment of photogrammetry (Brown 1976): where a ball's outline and the light explain its pixels equally
//! well, it says nothing of the light.

use nalgebra::{SMatrix, SVector, Vector3};

#[cfg(target_arch = "x86_64")]
use super::lanes::{Avx2, Avx2Lanes};
#[cfg(target_arch = "aarch64")]
use super::lanes::{Neon, NeonLanes};
use super::{
    fit::{Fit, Model, OUTLINE, SHADING, shading_ties},
    lanes::{LANES, Lanes, Plain, PlainLanes},
    look::{BOX_PX, Look, TERMS, UNKNOWN_SLOPES, turned},
    patch::{CHANNELS, Patch},
    sphere::Place,
    sweep::Coverer,
};

/// Parameters that balls share: the diffuse light by colour, and the blur.
const SHARED: usize = CHANNELS * TERMS + 1;
/// Parameters of one ball.
const OWN: usize = CHANNELS * SHADING + OUTLINE;

/// Columns of a pixel: how the model follows outline, shading of its colour, diffuse light, blur; and the residual.
const COLUMNS: usize = OUTLINE + SHADING + TERMS + 2;
const DIFFUSE: usize = OUTLINE + SHADING;
const BLUR: usize = DIFFUSE + TERMS;
const RESIDUAL: usize = BLUR + 1;

/// Spread of the diffuse light's terms, as shares of the ball's level, and of the blur, px, before anything is known.
const DIFFUSE_SPREAD: f64 = 0.2;
const BLUR_SPREAD_PX: f64 = 0.5;
/// Narrowest and widest blur, px.
const BLUR_PX: (f32, f32) = (1.0, 4.0);

/// Share of what is known that a new ball replaces: about 200 balls are remembered.
const FORGOTTEN: f64 = 0.005;
/// Weight of a ball's pixels in what is learnt from it: the errors of neighbours are alike.
const TRUST: f64 = 0.02;

/// Spread of the slopes of a ball's light where that of balls before it is known, and balls until then.
const KNOWN_SLOPES: f64 = 0.07;
const ENOUGH_BALLS: f64 = 30.0;

/// Balls after which not every one is learnt from, but one in so many frames.
const MANY_BALLS: f64 = 100.0;
const ONE_OF_MANY: u64 = 4;

type SharedMatrix = SMatrix<f64, SHARED, SHARED>;
type SharedVector = SVector<f64, SHARED>;
type Products = [[[f64; COLUMNS]; COLUMNS]; CHANNELS];

/// What the balls of a camera have in common.
#[derive(Debug, Clone)]
pub struct Appearance {
    /// Direction of the main light, in the camera's frame.
    pub towards_light: Vector3<f64>,
    /// The shared parameters; the polynomials' are on the axes of the camera's frame.
    shared: SharedVector,
    /// Normal equations of all balls so far.
    normal: Box<SharedMatrix>,
    right: SharedVector,
    /// How many balls those were.
    balls: f64,
}

impl Appearance {
    /// Before any ball has been seen: one lamp that hangs `towards_light`.
    pub fn new(towards_light: Vector3<f64>) -> Self {
        let mut shared = SharedVector::zeros();
        shared[SHARED - 1] = f64::from(BOX_PX);
        let (normal, right) = (Box::new(SharedMatrix::zeros()), SharedVector::zeros());
        Self { towards_light, shared, normal, right, balls: 0.0 }
    }

    /// Whether the ball of frame `n` is worth the time that it takes to learn from it: of many, some are enough.
    pub fn is_due(&self, n: u64) -> bool {
        self.balls < MANY_BALLS || n.is_multiple_of(ONE_OF_MANY)
    }

    /// On the axes of a patch, in a main light from `towards_light`.
    pub fn look(&self, place: &Place, towards_light: &Vector3<f64>) -> Look {
        let axes = place.axes.map(|axis| [axis.x, axis.y, axis.z].map(|v| v as f32));
        let diffuse = std::array::from_fn(|channel| {
            turned(&std::array::from_fn(|term| self.shared[channel * TERMS + term] as f32), &axes)
        });
        let box_px = (self.shared[SHARED - 1] as f32).clamp(BLUR_PX.0, BLUR_PX.1);
        let unknown = (-self.balls / ENOUGH_BALLS).exp();
        let slope_spread = KNOWN_SLOPES + (UNKNOWN_SLOPES - KNOWN_SLOPES) * unknown;
        Look { box_px, light: place.light(towards_light), diffuse, slope_spread }
    }

    /// Learns from the ball that was fitted to the pixels of `patch`; `typical` is the size of its contrast.
    pub fn learn(&mut self, patch: &Patch, place: &Place, fit: &Fit, typical: &[f64; CHANNELS]) {
        let products = products(patch, place, fit);
        let Some((normal, right)) = complement(&products, fit, typical, &patch.look) else { return };
        let right = right + normal * self.shared;
        *self.normal = *self.normal * (1.0 - FORGOTTEN) + normal * TRUST;
        self.right = self.right * (1.0 - FORGOTTEN) + right * TRUST;
        let (mut a, mut b) = (*self.normal, self.right);
        for i in 0..SHARED {
            let (expected, spread) =
                if i + 1 == SHARED { (f64::from(BOX_PX), BLUR_SPREAD_PX) } else { (0.0, DIFFUSE_SPREAD) };
            a[(i, i)] += spread.powi(-2);
            b[i] += expected * spread.powi(-2);
        }
        if let Some(solved) = a.cholesky() {
            self.shared = solved.solve(&b);
        }
        self.balls += 1.0;
    }
}

/// The normal equations of the shared parameters, as changes to what they are, with those of the ball eliminated;
/// none where they are not finite.
fn complement(
    products: &Products,
    fit: &Fit,
    typical: &[f64; CHANNELS],
    look: &Look,
) -> Option<(SharedMatrix, SharedVector)> {
    const ALL: usize = OWN + SHARED;
    let mut a = [[0.0; ALL + 1]; ALL];
    for (channel, products) in products.iter().enumerate() {
        if products[OUTLINE][OUTLINE] <= 0.0 {
            continue;
        }
        // Where each column belongs.
        let place = |column: usize| match column {
            BLUR => ALL - 1,
            RESIDUAL => ALL,
            DIFFUSE.. => OWN + channel * TERMS + column - DIFFUSE,
            OUTLINE.. => channel * SHADING + column - OUTLINE,
            _ => CHANNELS * SHADING + column,
        };
        for i in 0..RESIDUAL {
            for j in 0..COLUMNS {
                a[place(i)][place(j)] += products[i.max(j)][i.min(j)];
            }
        }
        let (ties, right) = shading_ties(&fit.shading[channel], typical[channel], look);
        for i in 0..SHADING {
            for j in 0..SHADING {
                a[channel * SHADING + i][channel * SHADING + j] += ties[i][j];
            }
            a[channel * SHADING + i][ALL] += right[i];
        }
    }
    for own in 0..OWN {
        let pivot = a[own];
        // A grey frame has one colour.
        if pivot[own] <= 1e-12 {
            continue;
        }
        for row in &mut a[own + 1..] {
            let share = row[own] / pivot[own];
            for (value, pivot) in row[own..].iter_mut().zip(&pivot[own..]) {
                *value -= share * pivot;
            }
        }
    }
    let normal = SharedMatrix::from_fn(|i, j| a[OWN + i][OWN + j]);
    let right = SharedVector::from_fn(|i, _| a[OWN + i][ALL]);
    let known = (0..SHARED).all(|i| normal[(i, i)].is_finite() && right[i].is_finite());
    known.then_some((normal, right))
}

fn products(patch: &Patch, place: &Place, fit: &Fit) -> Products {
    let mut out = [[[0.0; COLUMNS]; COLUMNS]; CHANNELS];
    #[cfg(target_arch = "x86_64")]
    if let Some(level) = Avx2::detect() {
        // SAFETY: just asked.
        unsafe { products_avx2(level, patch, place, fit, &mut out) };
        return out;
    }
    #[cfg(target_arch = "aarch64")]
    if let Some(level) = Neon::detect() {
        products_body::<NeonLanes>(level, patch, place, fit, &mut out);
        return out;
    }
    products_body::<PlainLanes>(Plain, patch, place, fit, &mut out);
    out
}

/// # Safety
/// The processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn products_avx2(level: Avx2, patch: &Patch, place: &Place, fit: &Fit, out: &mut Products) {
    products_body::<Avx2Lanes>(level, patch, place, fit, out);
}

/// Sums of products of all columns by colour, in the lower triangle.
#[inline(always)]
fn products_body<L: Lanes>(level: L::Level, patch: &Patch, place: &Place, fit: &Fit, out: &mut Products) {
    /// Half the step over which the model's slope by the blur is taken, px.
    const STEP_PX: f32 = 0.1;
    let all = |value| L::all(level, value);
    let (sin, cos) = fit.sweep.angle.sin_cos();
    // The camera's axes on those of the path.
    let axes = [0, 1, 2].map(|i| {
        let [x, y, z] = place.axes.map(|axis| axis[i] as f32);
        [x * cos + y * sin, y * cos - x * sin, z].map(all)
    });
    let blurred = |by: f32| {
        let look = Look { box_px: patch.look.box_px + by, ..patch.look };
        Coverer::new(level, &fit.sweep, &look, 0)
    };
    let (wider, narrower) = (blurred(STEP_PX), blurred(-STEP_PX));
    for (channel, samples) in patch.channels.iter().enumerate() {
        let model = Model::new(level, (patch, &fit.sweep), channel, &fit.shading[channel], 1.0);
        let typical = all(fit.shading[channel][0] + 0.5 * fit.shading[channel][3]);
        let mut sums = [[all(0.0); COLUMNS]; COLUMNS];
        let mut columns = [all(0.0); COLUMNS];
        for at in (0..samples.len()).step_by(LANES) {
            let pixels = model.hold(samples, at);
            pixels.write_slopes(&mut columns);
            let [_, along, across, ..] = pixels.coverage.place;
            let towards = (all(1.0) - along * along - across * across).positive().sqrt();
            let [x, y, z] = axes.map(|[a, b, c]| a * along + b * across + c * towards);
            let share = pixels.alpha * typical;
            let terms = [x, y, z, x * x, x * y, x * z, y * y, y * z, z * z];
            for (column, term) in columns[DIFFUSE..].iter_mut().zip(terms) {
                *column = term * share;
            }
            let place = [L::load(level, &samples.x, at), L::load(level, &samples.y, at)];
            let [more, less] = [&wider, &narrower].map(|coverer| coverer.at(place[0], place[1]).alpha);
            columns[BLUR] = (more - less) * all(0.5 / STEP_PX) * pixels.contrast;
            columns[RESIDUAL] = pixels.residual;
            for (i, sums) in sums.iter_mut().enumerate() {
                for (j, sum) in sums.iter_mut().enumerate().take(i + 1) {
                    *sum = columns[i].times_plus(columns[j], *sum);
                }
            }
        }
        for (out, sums) in out[channel].iter_mut().zip(&sums) {
            for (out, sum) in out.iter_mut().zip(sums) {
                *out = f64::from(sum.sum());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::{patch::Rectifier, sweep::Sweep},
        *,
    };

    #[test]
    fn vectors_give_the_products_of_plain_rust() {
        let (sin, cos) = 0.6_f64.sin_cos();
        let place = Place {
            rectifier: Rectifier::plain([0.0; 2]),
            angle_per_px: None,
            axes: [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0), -Vector3::z()],
        };
        for seed in 0..10 {
            let patch = Patch::of_noise(seed);
            let fit = Fit {
                sweep: Sweep { centre: [0.3, -1.2], radius: 7.0, length: seed as f32, angle: 0.4 },
                shading: [[90.0, 4.0, -3.0, 60.0, 5.0, -8.0]; CHANNELS],
                covariance: [[0.0; OUTLINE]; OUTLINE],
                chi2: 1.0,
            };
            let mut plain = [[[0.0; COLUMNS]; COLUMNS]; CHANNELS];
            products_body::<PlainLanes>(Plain, &patch, &place, &fit, &mut plain);
            assert!(plain[1][BLUR][BLUR] > 0.0 && plain[2][DIFFUSE][DIFFUSE] > 0.0);
            assert_eq!(products(&patch, &place, &fit), plain);
        }
    }
}
