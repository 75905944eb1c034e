//! Fits a swept disc with smooth shading in front of the known background to the pixels of a patch.
//!
//! Minimised is the robust (Cauchy) sum of squares of `seen − [(1 − α) background + α (ball)]` over all
//! pixels, α being the share of pixel and exposure that the swept disc covers, and the ball's level what a
//! matt sphere shows that is lit from all around and by one main light, by colour. The direction of the light
//! is refined by the fit, to first order. It is the edge of the occlusion that
//! tells the outline, and not the bright part of the ball: where the ball's underside is as dark as the floor
//! behind it, the rest of the outline decides.
//!
//! The shading enters linearly and is eliminated in every step (variable projection after Golub & Pereyra
//! 1973, in Kaufman's form: the derivatives of the shading by the outline are left out). Steps are damped
//! after Levenberg and Marquardt.

#[cfg(target_arch = "x86_64")]
use super::lanes::{Avx2, Avx2Lanes};
#[cfg(target_arch = "aarch64")]
use super::lanes::{Neon, NeonLanes};
use super::{
    lanes::{LANES, Lanes, Plain, PlainLanes},
    look::Look,
    patch::{CHANNELS, Patch, Samples},
    sweep::{Coverage, Coverer, MIN_LENGTH_PX, Sweep},
};

/// Parameters of the outline: centre along and across the path, radius, length, angle.
pub const OUTLINE: usize = 5;
/// Parameters of the shading of one colour.
pub const SHADING: usize = 6;

/// What is known of the outline before the pixels are looked at.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Prior {
    /// Expected radius and its standard deviation, px.
    pub radius: Option<(f32, f32)>,
}

/// The result of a fit.
#[derive(Debug, Clone, Copy)]
pub struct Fit {
    /// The outline.
    pub sweep: Sweep,
    /// Shading by colour; on the axes of the path, in units of the radius.
    pub shading: [[f32; SHADING]; CHANNELS],
    /// Covariance of the centre along and across the path, the radius, the length and the angle.
    pub covariance: [[f64; OUTLINE]; OUTLINE],
    /// Mean of the robust squared residual over the pixels, in units of their variance.
    pub chi2: f32,
}

/// Sums over a patch that a step needs.
struct Sums {
    outline: [[f64; OUTLINE]; OUTLINE],
    outline_residual: [f64; OUTLINE],
    mixed: [[[f64; SHADING]; OUTLINE]; CHANNELS],
    shading: [[[f64; SHADING]; SHADING]; CHANNELS],
    shading_residual: [[f64; SHADING]; CHANNELS],
    /// Robust cost.
    cost: f64,
    weight: f64,
}

/// Residuals beyond this many standard deviations count as something else in front of the ball or beside it.
const ROBUST_SIGMAS: f32 = 3.0;

/// The level from which on a pixel is saturated, DN.
const SATURATED: f32 = 253.5;

/// What a pixel adds to the normal equations, each times the root of its weight: how the model follows the outline,
/// how it follows the shading of its colour, and the residual.
const COLUMNS: usize = OUTLINE + SHADING + 1;
/// Where the shading's columns begin, and the residual's.
const SHADES: usize = OUTLINE;
const RESIDUAL: usize = OUTLINE + SHADING;

/// Vectors whose columns are held at a time: they stay in the nearest cache until all products are summed.
const BLOCK: usize = 32;

/// Columns of one tile of products.
const TILE: usize = 3;

/// Columns of up to [`BLOCK`] vectors of pixels.
type Columns<L> = [[L; COLUMNS]; BLOCK];

/// Sums of products of columns, in the lower triangle.
type Products<L> = [[L; COLUMNS]; COLUMNS];

/// Adds the products of columns from `I` on with those from `J` on, [`TILE`] of each, over a block. So few sums at a time stay in registers,
/// where all of them together would be loaded and stored for every vector.
#[inline(always)]
fn add_products<L: Lanes, const I: usize, const J: usize>(
    zero: L,
    block: &[[L; COLUMNS]],
    products: &mut Products<L>,
) {
    let mut sums = [[zero; TILE]; TILE];
    for columns in block {
        for (i, sums) in sums.iter_mut().enumerate() {
            for (j, sum) in sums.iter_mut().enumerate() {
                *sum = columns[I + i].times_plus(columns[J + j], *sum);
            }
        }
    }
    for (i, sums) in sums.iter().enumerate() {
        for (j, sum) in sums.iter().enumerate() {
            products[I + i][J + j] = products[I + i][J + j] + *sum;
        }
    }
}

/// The lower triangle of all products of a block, in tiles.
#[inline(always)]
fn add_all_products<L: Lanes>(zero: L, block: &[[L; COLUMNS]], products: &mut Products<L>) {
    add_products::<L, 0, 0>(zero, block, products);
    add_products::<L, 3, 0>(zero, block, products);
    add_products::<L, 6, 0>(zero, block, products);
    add_products::<L, 9, 0>(zero, block, products);
    add_products::<L, 3, 3>(zero, block, products);
    add_products::<L, 6, 3>(zero, block, products);
    add_products::<L, 9, 3>(zero, block, products);
    add_products::<L, 6, 6>(zero, block, products);
    add_products::<L, 9, 6>(zero, block, products);
    add_products::<L, 9, 9>(zero, block, products);
}

/// What is expected of the pixels of one colour.
pub struct Model<L: Lanes> {
    level: L::Level,
    coverer: Coverer<L>,
    shading: [L; SHADING],
    /// 1 / square of the residual, in standard deviations, at which a pixel's weight is a half.
    softness: L,
}

/// A vector of pixels held against the model; all but the cover is times the root of the pixels' weights.
pub struct Held<L> {
    /// Their cover.
    pub coverage: Coverage<L>,
    /// By how much the ball differs from what is behind it.
    pub contrast: L,
    /// Share of the ball in what is seen.
    pub alpha: L,
    /// Seen less expected.
    pub residual: L,
    /// Robust square residuals, in units of their variance.
    cost: L,
    /// Robust weights.
    robust: L,
}

impl<L: Lanes> Model<L> {
    #[inline(always)]
    pub fn new(
        level: L::Level,
        (patch, sweep): (&Patch, &Sweep),
        channel: usize,
        shading: &[f32; SHADING],
        scale: f32,
    ) -> Self {
        Self {
            level,
            coverer: Coverer::new(level, sweep, &patch.look, channel),
            shading: shading.map(|term| L::all(level, term)),
            softness: L::all(level, 1.0 / (ROBUST_SIGMAS * ROBUST_SIGMAS * scale * scale)),
        }
    }

    /// Holds the pixels from `at` on against it.
    #[inline(always)]
    pub fn hold(&self, samples: &Samples, at: usize) -> Held<L> {
        let level = self.level;
        let one = L::all(level, 1.0);
        let saturated = L::all(level, SATURATED);
        let coverage = self.coverer.at(L::load(level, &samples.x, at), L::load(level, &samples.y, at));
        let background = L::load(level, &samples.background, at);
        let seen = L::load(level, &samples.seen, at);
        let inverse_sigma = L::load(level, &samples.inverse_sigma, at);
        let mut ball = L::all(level, 0.0);
        for (term, place) in self.shading.iter().zip(&coverage.place) {
            ball = term.times_plus(*place, ball);
        }
        let contrast = ball - background;
        let model = coverage.alpha.times_plus(contrast, background);
        // A saturated pixel says only that the ball is at least this bright.
        let informs = one - one.where_positive(seen - saturated).where_positive(model - saturated);
        let residual = (seen - model) * informs;
        let z = residual * inverse_sigma;
        let square = z * z;
        // Both factors of a product carry the root of the weight.
        let robust_root = square.times_plus(self.softness, one).sqrt().recip();
        let robust = robust_root * robust_root;
        let root = robust_root * inverse_sigma * informs;
        Held {
            contrast: contrast * root,
            alpha: coverage.alpha * root,
            residual: residual * root,
            cost: square * robust,
            robust: robust.where_positive(inverse_sigma),
            coverage,
        }
    }
}

impl<L: Lanes> Held<L> {
    /// How the model follows the outline, and then the shading, into the first columns.
    #[inline(always)]
    pub fn write_slopes(&self, columns: &mut [L]) {
        for (column, slope) in columns.iter_mut().zip(self.coverage.slopes) {
            *column = slope * self.contrast;
        }
        for (column, place) in columns[SHADES..].iter_mut().zip(self.coverage.place) {
            *column = place * self.alpha;
        }
    }
}

#[inline(always)]
fn accumulate_body<L: Lanes>(
    level: L::Level,
    patch: &Patch,
    sweep: &Sweep,
    shading: &[[f32; SHADING]; CHANNELS],
    scale: f32,
    sums: &mut Sums,
) {
    let zero = L::all(level, 0.0);
    let mut columns: Columns<L> = [[zero; COLUMNS]; BLOCK];
    let (mut cost, mut weight_sum) = (zero, zero);
    for (channel, samples) in patch.channels.iter().enumerate() {
        let model = Model::new(level, (patch, sweep), channel, &shading[channel], scale);
        let mut products: Products<L> = [[zero; COLUMNS]; COLUMNS];
        for first in (0..samples.len()).step_by(LANES * BLOCK) {
            let vectors = ((samples.len() - first) / LANES).min(BLOCK);
            for (vector, columns) in columns[..vectors].iter_mut().enumerate() {
                let pixels = model.hold(samples, first + vector * LANES);
                cost = cost + pixels.cost;
                weight_sum = weight_sum + pixels.robust;
                pixels.write_slopes(columns);
                columns[RESIDUAL] = pixels.residual;
            }
            add_all_products(zero, &columns[..vectors], &mut products);
        }
        sums.add(channel, &products);
    }
    sums.cost = f64::from(cost.sum());
    sums.weight = f64::from(weight_sum.sum());
}

/// # Safety
/// The processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn accumulate_avx2(
    level: Avx2,
    patch: &Patch,
    sweep: &Sweep,
    shading: &[[f32; SHADING]; CHANNELS],
    scale: f32,
    sums: &mut Sums,
) {
    accumulate_body::<Avx2Lanes>(level, patch, sweep, shading, scale, sums);
}

impl Fit {
    /// By how much the main light should be turned towards its two side directions, rad.
    pub fn light_turn(&self) -> [f32; 2] {
        let (mut strength, mut turn) = (1e-6, [0.0; 2]);
        for terms in &self.shading {
            let light = terms[3].max(0.0);
            strength += light * light;
            turn[0] += light * terms[4];
            turn[1] += light * terms[5];
        }
        turn.map(|t| (t / strength).clamp(-0.6, 0.6))
    }
}

impl Sums {
    const EMPTY: Self = Self {
        outline: [[0.0; OUTLINE]; OUTLINE],
        outline_residual: [0.0; OUTLINE],
        mixed: [[[0.0; SHADING]; OUTLINE]; CHANNELS],
        shading: [[[0.0; SHADING]; SHADING]; CHANNELS],
        shading_residual: [[0.0; SHADING]; CHANNELS],
        cost: 0.0,
        weight: 0.0,
    };

    /// Adds one colour's products.
    fn add<L: Lanes>(&mut self, channel: usize, products: &Products<L>) {
        let product = |i: usize, j: usize| f64::from(products[i.max(j)][i.min(j)].sum());
        for i in 0..OUTLINE {
            for j in 0..OUTLINE {
                self.outline[i][j] += product(i, j);
            }
            self.outline_residual[i] += product(RESIDUAL, i);
            for j in 0..SHADING {
                self.mixed[channel][i][j] = product(SHADES + j, i);
            }
        }
        for i in 0..SHADING {
            for j in 0..SHADING {
                self.shading[channel][i][j] = product(SHADES + i, SHADES + j);
            }
            self.shading_residual[channel][i] = product(RESIDUAL, SHADES + i);
        }
    }

    fn over(patch: &Patch, sweep: &Sweep, shading: &[[f32; SHADING]; CHANNELS], scale: f32) -> Self {
        let mut sums = Self::EMPTY;
        #[cfg(target_arch = "x86_64")]
        if let Some(level) = Avx2::detect() {
            // SAFETY: just asked.
            unsafe { accumulate_avx2(level, patch, sweep, shading, scale, &mut sums) };
            return sums;
        }
        #[cfg(target_arch = "aarch64")]
        if let Some(level) = Neon::detect() {
            accumulate_body::<NeonLanes>(level, patch, sweep, shading, scale, &mut sums);
            return sums;
        }
        accumulate_body::<PlainLanes>(Plain, patch, sweep, shading, scale, &mut sums);
        sums
    }
}

/// Solves A X = B in place for symmetric positive definite A, B having `columns` columns; false when A is
/// not positive definite.
fn cholesky_solve<const N: usize, const M: usize>(a: &mut [[f64; N]; N], b: &mut [[f64; M]; N]) -> bool {
    for i in 0..N {
        for j in 0..=i {
            let sum = a[i][j] - (0..j).map(|k| a[i][k] * a[j][k]).sum::<f64>();
            if i == j {
                if sum <= 1e-12 * a[i][i].abs() || !sum.is_finite() {
                    return false;
                }
                a[i][i] = sum.sqrt();
            } else {
                a[i][j] = sum / a[j][j];
            }
        }
    }
    for column in 0..M {
        for i in 0..N {
            let sum = b[i][column] - (0..i).map(|k| a[i][k] * b[k][column]).sum::<f64>();
            b[i][column] = sum / a[i][i];
        }
        for i in (0..N).rev() {
            let sum = b[i][column] - (i + 1..N).map(|k| a[k][i] * b[k][column]).sum::<f64>();
            b[i][column] = sum / a[i][i];
        }
    }
    true
}

/// The shading's share of a step: what it would be with the outline as it is, and how it follows the outline.
struct Eliminated {
    /// Normal matrix of the outline with the shading eliminated.
    reduced: [[f64; OUTLINE]; OUTLINE],
    right: [f64; OUTLINE],
    /// Per colour: A⁻¹ [mixedᵀ | residual].
    solved: [[[f64; OUTLINE + 1]; SHADING]; CHANNELS],
}

/// Spreads of the shading's terms, in units of the ball's contrast: the level is free; its slopes, by which light
/// from all around differs from place to place, are small, and smaller where that light has been learnt; the lamp's
/// direction is nearly known.
const fn spreads(slope: f64) -> [f64; SHADING] {
    [20.0, slope, slope, 2.0, 0.3, 0.3]
}

/// Light from all around against that of the lamp, and how much a hall may differ from it. Without this a dark
/// half of a small ball could as well be the background beside a smaller one, or a larger one's.
const AMBIENT: (f64, f64) = (0.35, 0.25);

/// What ties the shading of one colour to what is likely, as normal matrix and right side.
pub fn shading_ties(
    shading: &[f32; SHADING],
    typical: f64,
    look: &Look,
) -> ([[f64; SHADING]; SHADING], [f64; SHADING]) {
    let (mut a, mut b) = ([[0.0; SHADING]; SHADING], [0.0; SHADING]);
    let spreads = spreads(look.slope_spread);
    for j in 0..SHADING {
        let tie = (spreads[j] * typical).powi(-2);
        a[j][j] = tie;
        b[j] = if j == 0 { 0.0 } else { -tie * f64::from(shading[j]) };
    }
    let [ambient, lamp] = [0, 3].map(|j| f64::from(shading[j]));
    let (ratio, spread) = AMBIENT;
    let weight = (spread * (typical + ambient.max(0.0) + lamp.max(0.0))).powi(-2);
    let off = ambient - ratio * lamp;
    a[0][0] += weight;
    a[0][3] -= weight * ratio;
    a[3][0] -= weight * ratio;
    a[3][3] += weight * ratio * ratio;
    b[0] -= weight * off;
    b[3] += weight * ratio * off;
    (a, b)
}

fn eliminate(
    sums: &Sums,
    shading: &[[f32; SHADING]; CHANNELS],
    typical: &[f64; CHANNELS],
    look: &Look,
) -> Option<Eliminated> {
    let mut out = Eliminated {
        reduced: sums.outline,
        right: sums.outline_residual,
        solved: [[[0.0; OUTLINE + 1]; SHADING]; CHANNELS],
    };
    for channel in 0..CHANNELS {
        if sums.shading[channel][0][0] <= 0.0 {
            continue;
        }
        let mut a = sums.shading[channel];
        let mut b = [[0.0; OUTLINE + 1]; SHADING];
        let (ties, right) = shading_ties(&shading[channel], typical[channel], look);
        for j in 0..SHADING {
            for i in 0..OUTLINE {
                b[j][i] = sums.mixed[channel][i][j];
            }
            b[j][OUTLINE] = sums.shading_residual[channel][j] + right[j];
            for k in 0..SHADING {
                a[j][k] += ties[j][k];
            }
        }
        if !cholesky_solve(&mut a, &mut b) {
            return None;
        }
        for i in 0..OUTLINE {
            for k in 0..SHADING {
                let mixed = sums.mixed[channel][i][k];
                for j in 0..OUTLINE {
                    out.reduced[i][j] -= mixed * b[k][j];
                }
                out.right[i] -= mixed * b[k][OUTLINE];
            }
        }
        out.solved[channel] = b;
    }
    Some(out)
}

/// Most steps of one fit.
const MAX_STEPS: usize = 7;

/// A step of the centre shorter than this is the last one, px: steps shrink quadratically, so that what
/// remains after it is far below a hundredth of a pixel.
const CONVERGED_PX: f64 = 0.06;

/// Robust scales of the first steps: they narrow as the fit comes closer.
const SCALES: [f32; 2] = [4.0, 1.6];

/// Mean robust square residual from which on nothing round is there, in units of the variance; at most it is
/// [`ROBUST_SIGMAS`]².
const HOPELESS_CHI2: f64 = 6.0;

/// Fits the outline and its path, starting from `start`. `typical` is the size of its contrast by colour, DN.
/// None where the pixels do not determine it, or are those of something else.
pub fn fit(patch: &Patch, start: Sweep, prior: &Prior, typical: &[f64; CHANNELS]) -> Option<Fit> {
    let mut shading = [[0.0_f32; SHADING]; CHANNELS];
    // The shading first, with the outline held: no robust weights, since nothing is known yet.
    let sums = Sums::over(patch, &start, &shading, 1e3);
    let eliminated = eliminate(&sums, &shading, typical, &patch.look)?;
    apply_shading(&mut shading, &eliminated, &[0.0; OUTLINE]);
    descend(patch, Guess { sweep: start, shading }, 0, prior, typical)
}

/// Fits again from a result for other pixels or other light.
pub fn fit_again(patch: &Patch, from: &Fit, prior: &Prior, typical: &[f64; CHANNELS]) -> Option<Fit> {
    let guess = Guess { sweep: from.sweep, shading: from.shading };
    descend(patch, guess, SCALES.len(), prior, typical)
}

/// Steps from a guess to the least cost, beginning with step `first`.
fn descend(
    patch: &Patch,
    start: Guess,
    first: usize,
    prior: &Prior,
    typical: &[f64; CHANNELS],
) -> Option<Fit> {
    let ties = Ties::around(&start.sweep, prior);
    let mut at = start;
    let mut best: Option<Best> = None;
    let mut damping = 1e-4;
    for round in first..MAX_STEPS {
        let scale = SCALES.get(round).copied().unwrap_or(1.0);
        let sums = Sums::over(patch, &at.sweep, &at.shading, scale);
        let cost = sums.cost + ties.cost(&at.sweep);
        let chi2 = sums.cost / sums.weight.max(1.0);
        // Costs of two scales cannot be compared.
        let worse = round > SCALES.len() && best.as_ref().is_some_and(|best| cost > best.cost * 1.000_1);
        if worse {
            damping *= 100.0;
        } else {
            if round > SCALES.len() && chi2 > HOPELESS_CHI2 {
                return None;
            }
            let eliminated = eliminate(&sums, &at.shading, typical, &patch.look)?;
            best = Some(Best { guess: at, cost, chi2, eliminated });
        }
        let best = best.as_ref()?;
        let step = outline_step(&best.eliminated, &best.guess.sweep, &ties, damping)?;
        let (sweep, taken) = moved(&best.guess.sweep, &step);
        at = Guess { sweep, shading: best.guess.shading };
        apply_shading(&mut at.shading, &best.eliminated, &taken);
        if scale <= 1.0 && !worse && taken[0].hypot(taken[1]) + taken[2].abs() < CONVERGED_PX {
            break;
        }
    }
    let best = best?;
    let covariance = outline_covariance(&best.eliminated, &best.guess.sweep, &ties)?;
    Some(Fit { sweep: at.sweep, shading: at.shading, covariance, chi2: best.chi2 as f32 })
}

/// An outline with its shading.
#[derive(Clone, Copy)]
struct Guess {
    sweep: Sweep,
    shading: [[f32; SHADING]; CHANNELS],
}

/// The best guess so far, with what the pixels say of it.
struct Best {
    guess: Guess,
    cost: f64,
    chi2: f64,
    eliminated: Eliminated,
}

/// What holds parameters that the pixels may leave open: a ball at rest has no direction, and on small ones
/// radius and path look alike.
struct Ties {
    /// Value and weight (1 / variance) by parameter of the sweep: radius, length, angle.
    by_parameter: [(f32, f64); 3],
}

impl Ties {
    fn around(start: &Sweep, prior: &Prior) -> Self {
        let radius = prior
            .radius
            .map_or((start.radius, 0.0), |(radius, sigma)| (radius, 1.0 / f64::from(sigma * sigma)));
        let reach = f64::from(0.15 * start.radius + 0.5 * start.length);
        Self { by_parameter: [radius, (start.length, 1.0 / (reach * reach)), (start.angle, 1.0)] }
    }

    fn offsets(&self, sweep: &Sweep) -> [f64; 3] {
        let now = [sweep.radius, sweep.length, sweep.angle];
        std::array::from_fn(|i| f64::from(self.by_parameter[i].0 - now[i]))
    }

    fn cost(&self, sweep: &Sweep) -> f64 {
        self.offsets(sweep).iter().zip(&self.by_parameter).map(|(d, (_, weight))| weight * d * d).sum()
    }
}

fn apply_shading(shading: &mut [[f32; SHADING]; CHANNELS], eliminated: &Eliminated, taken: &[f64; OUTLINE]) {
    for (shading, solved) in shading.iter_mut().zip(&eliminated.solved) {
        for (term, solved) in shading.iter_mut().zip(solved) {
            let follows: f64 = solved[..OUTLINE].iter().zip(taken).map(|(s, t)| s * t).sum();
            *term += (solved[OUTLINE] - follows) as f32;
        }
    }
}

/// The normal matrix with the ties.
fn normal(
    eliminated: &Eliminated,
    sweep: &Sweep,
    ties: &Ties,
) -> ([[f64; OUTLINE]; OUTLINE], [f64; OUTLINE]) {
    let (mut a, mut b) = (eliminated.reduced, eliminated.right);
    for (i, offset) in ties.offsets(sweep).into_iter().enumerate() {
        let weight = ties.by_parameter[i].1;
        a[i + 2][i + 2] += weight;
        b[i + 2] += weight * offset;
    }
    (a, b)
}

fn outline_step(eliminated: &Eliminated, sweep: &Sweep, ties: &Ties, damping: f64) -> Option<[f64; OUTLINE]> {
    let (mut a, b) = normal(eliminated, sweep, ties);
    for (i, row) in a.iter_mut().enumerate() {
        row[i] += damping * row[i].abs() + 1e-9;
    }
    let mut x = b.map(|b| [b]);
    cholesky_solve(&mut a, &mut x).then(|| x.map(|[x]| x))
}

fn outline_covariance(
    eliminated: &Eliminated,
    sweep: &Sweep,
    ties: &Ties,
) -> Option<[[f64; OUTLINE]; OUTLINE]> {
    let (mut a, _) = normal(eliminated, sweep, ties);
    let mut inverse = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    cholesky_solve(&mut a, &mut inverse).then_some(inverse)
}

/// The sweep after a step, which is cut short where it would leave the neighbourhood in which the
/// derivatives mean anything; and the step as taken.
fn moved(from: &Sweep, step: &[f64; OUTLINE]) -> (Sweep, [f64; OUTLINE]) {
    let (radius, length) = (f64::from(from.radius), f64::from(from.length));
    let most = [
        0.5 * radius + 0.2 * length,
        0.5 * radius,
        0.3 * radius,
        0.4 * (length + radius),
        0.5 * radius / (0.5 * length + radius),
    ];
    let share = step.iter().zip(most).fold(1.0_f64, |share, (s, most)| share.min(most / s.abs().max(1e-12)));
    let mut taken = step.map(|s| s * share);
    taken[2] = taken[2].max(0.8 - radius);
    taken[3] = taken[3].max(f64::from(MIN_LENGTH_PX) - length);
    let (sin, cos) = f64::from(from.angle).sin_cos();
    let sweep = Sweep {
        centre: [
            from.centre[0] + (cos * taken[0] - sin * taken[1]) as f32,
            from.centre[1] + (sin * taken[0] + cos * taken[1]) as f32,
        ],
        radius: from.radius + taken[2] as f32,
        length: from.length + taken[3] as f32,
        angle: from.angle + taken[4] as f32,
    };
    (sweep, taken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_give_the_sums_of_plain_rust() {
        let shading = [[90.0, 4.0, -3.0, 60.0, 5.0, -8.0]; CHANNELS];
        for seed in 0..20 {
            let patch = Patch::of_noise(seed);
            let sweep = Sweep { centre: [0.3, -1.2], radius: 7.0, length: seed as f32, angle: 0.4 };
            let mut plain = Sums::EMPTY;
            accumulate_body::<PlainLanes>(Plain, &patch, &sweep, &shading, 1.6, &mut plain);
            let vectors = Sums::over(&patch, &sweep, &shading, 1.6);
            assert!(plain.weight > 0.0 && plain.outline[0][0] > 0.0);
            assert_eq!(
                (vectors.outline, vectors.outline_residual, vectors.mixed),
                (plain.outline, plain.outline_residual, plain.mixed)
            );
            assert_eq!(
                (vectors.shading, vectors.shading_residual, vectors.cost, vectors.weight),
                (plain.shading, plain.shading_residual, plain.cost, plain.weight)
            );
        }
    }
}
