//! What colour the ball may have, in the light of the scene.

use netcord_common::{
    FrameView, PixelFormat,
    rig::{BallColour, LearntColour},
};

use nalgebra::{Matrix3, Vector3};

use super::kernel::ColourGate;

/// The light of the scene, as far as its pixels tell: what a grey thing would look like. Two witnesses are asked,
/// since neither is always right: the frame's median (after Buchsbaum 1980), which a large blue floor misleads,
/// and its brightest cells (after Land 1977), which a coloured lamp or a yellow wall misleads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneLight {
    /// R / G and B / G of grey, by witness.
    pub grey: [[f32; 2]; 2],
    /// Median level of green, DN.
    pub level: f32,
    /// Level of green that one cell in 50 exceeds, DN.
    pub bright: f32,
}

impl Default for SceneLight {
    fn default() -> Self {
        Self { grey: [[1.0; 2]; 2], level: 60.0, bright: 160.0 }
    }
}

/// Cells looked at, along and across.
const LATTICE: (usize, usize) = (64, 40);
/// The brightest of them, which may be white.
const BRIGHTEST: usize = LATTICE.0 * LATTICE.1 / 50;

impl SceneLight {
    /// From a lattice of cells of a frame.
    pub fn of(view: &FrameView<'_>) -> Self {
        const N: usize = LATTICE.0 * LATTICE.1;
        let mut cells = [[0.0_f32; 3]; N];
        for (n, cell) in cells.iter_mut().enumerate() {
            let x = (n % LATTICE.0 * (view.width() - 2) / LATTICE.0) & !1;
            let y = (n / LATTICE.0 * (view.height() - 2) / LATTICE.1) & !1;
            *cell = cell_colour(view, x, y);
        }
        // Dimmest first; saturated cells have lost their hue.
        let brightness = |c: &[f32; 3]| {
            if c.iter().any(|level| *level > 250.0) { 0.0 } else { c[0] + 2.0 * c[1] + c[2] }
        };
        let whole = ratios(&cells);
        cells.select_nth_unstable_by(N - BRIGHTEST, |a, b| brightness(a).total_cmp(&brightness(b)));
        let brightest = ratios(&cells[N - BRIGHTEST..]);
        let mut green = cells.map(|c| c[1]);
        let mut at = |share: f64| {
            let place = (share * (N - 1) as f64) as usize;
            *green.select_nth_unstable_by(place, f32::total_cmp).1
        };
        Self { grey: [whole, brightest], level: at(0.5).max(1.0), bright: at(0.98).max(2.0) }
    }
}

/// Medians of R / G and B / G.
fn ratios(cells: &[[f32; 3]]) -> [f32; 2] {
    const N: usize = LATTICE.0 * LATTICE.1;
    [0, 2].map(|channel| {
        let mut column = [0.0_f32; N];
        for (ratio, cell) in column.iter_mut().zip(cells) {
            // One is added to both: black tells nothing, and must not tell wild ratios.
            *ratio = (cell[channel] + 1.0) / (cell[1] + 1.0);
        }
        *column[..cells.len()].select_nth_unstable_by(cells.len() / 2, f32::total_cmp).1
    })
}

/// Red, mean green and blue of the cell whose top left pixel is (x, y), both even; grey three times.
pub fn cell_colour(view: &FrameView<'_>, x: usize, y: usize) -> [f32; 3] {
    colour_of(view.format(), |dx, dy| f32::from(view.row(y + dy)[x + dx]))
}

/// Red, mean green and blue of a cell whose levels `at` tells; grey three times.
pub fn colour_of(format: PixelFormat, at: impl Fn(usize, usize) -> f32) -> [f32; 3] {
    match format.red_at() {
        None => [0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)); 3],
        Some((rx, ry)) => {
            let green = 0.5 * (at(1 - rx, ry) + at(rx, 1 - ry));
            [at(rx, ry), green, at(1 - rx, 1 - ry)]
        }
    }
}

/// What is known of the ball's colour: where the logarithms of its R / G and B / G lie, with their spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallModel {
    /// ln of (R / G), (B / G).
    pub mean: [f32; 2],
    /// Standard deviation of both.
    pub spread: f32,
    /// Level of green, DN; none where it is not known.
    pub level: Option<f32>,
}

impl BallModel {
    /// In a light in which grey has these ratios.
    fn in_light(self, grey: [f32; 2]) -> Self {
        Self { mean: [0, 1].map(|i| self.mean[i] + grey[i].ln()), ..self }
    }
}

/// The orange of table tennis balls against grey: about (0.95, 0.5, 0.12) of the light is thrown back.
/// Sensors see it paler, and scenes are not grey: the spread says so.
const ORANGE: BallModel = BallModel { mean: [0.6, -0.95], spread: 0.45, level: None };
/// White throws back all alike.
const WHITE: BallModel = BallModel { mean: [0.0, 0.0], spread: 0.22, level: None };

/// A colour that was learnt from marked frames of the camera itself, and so in its own light.
#[derive(Debug, Clone, Copy)]
struct Marked {
    gate: ColourGate,
    /// See [`place_of`].
    mean: Vector3<f32>,
    /// Inverse of the covariance.
    weight: Matrix3<f32>,
    diameter_px: [f32; 2],
}

impl Marked {
    fn new(format: PixelFormat, colour: &LearntColour) -> Self {
        let [a, b, c, d, e, f] = colour.covariance.map(|x| x as f32);
        let covariance = Matrix3::new(a, b, c, b, d, e, c, e, f);
        Self {
            gate: ColourGate::learnt(format, colour.tests()),
            mean: Vector3::from(colour.mean.map(|x| x as f32)),
            // The rig file's is positive definite.
            weight: covariance.try_inverse().unwrap_or_else(Matrix3::identity),
            diameter_px: colour.diameter_px.map(|x| x as f32),
        }
    }

    /// As [`ColourModel::likeness`].
    fn likeness(&self, rgb: [f32; 3]) -> f32 {
        let away = Vector3::from(place_of(rgb)) - self.mean;
        let square = away.dot(&(self.weight * away));
        // Tails of a Cauchy again; three degrees of freedom.
        1.0 / (1.0 + (square / LIKELY_SQUARE).powi(2))
    }
}

/// Square distance from a learnt colour's mean, in units of its covariance, at which the likeness is a half: one ball
/// in a thousand is farther away.
const LIKELY_SQUARE: f32 = 16.3;

/// The colours that are looked for.
#[derive(Debug, Clone)]
pub struct ColourModel {
    format: PixelFormat,
    told: &'static [BallModel],
    marked: Option<Marked>,
    learnt: Option<(BallModel, u32)>,
}

/// Most models that are tried at a time.
pub const MAX_MODELS: usize = 4;

impl ColourModel {
    /// What a rig file tells; a colour that was learnt there goes before one that is told.
    pub fn new(format: PixelFormat, told: BallColour, marked: Option<&LearntColour>) -> Self {
        let told: &[BallModel] = match told {
            BallColour::Orange => &[ORANGE],
            BallColour::White => &[WHITE],
            BallColour::Auto => &[ORANGE, WHITE],
        };
        Self { format, told, marked: marked.map(|colour| Marked::new(format, colour)), learnt: None }
    }

    /// The models to try in a light: what was learnt, or else what was told, as each witness sees it.
    fn models(&self, grey: [[f32; 2]; 2]) -> impl Iterator<Item = BallModel> + '_ {
        let told = if self.marked.is_some() { &[] } else { self.told };
        let learnt = self.learnt.filter(|(_, n)| *n >= CONFIDENT).map(|(model, _)| model);
        let told = told.iter().flat_map(move |model| grey.map(|grey| model.in_light(grey)));
        learnt.into_iter().chain(told.filter(move |_| learnt.is_none()))
    }

    /// Gates for cells that may be the ball's bright part; those `in_a_crowd` are narrower, since there the ball
    /// has to be told from what moves around it, too.
    pub fn gates(&self, light: &SceneLight, in_a_crowd: bool) -> impl Iterator<Item = ColourGate> + '_ {
        let light = *light;
        let format = self.format;
        let marked = self.marked().map(|marked| marked.gate);
        let told = self.models(light.grey).map(move |model| {
            // Half of the hue that sets an orange ball apart from grey must be there.
            let tolerance = (if in_a_crowd { 1.6 } else { 2.2 } * model.spread).min(0.5);
            let ratio = |i: usize, sign: f32| (model.mean[i] + sign * tolerance).exp();
            let orange = model.mean[0] - model.mean[1] > 0.8;
            // White is told by being brighter than its surroundings; orange by hue.
            let least = match model.level {
                Some(level) if in_a_crowd => 0.6 * level,
                Some(level) => 0.35 * level,
                None if orange => 0.25 * light.level,
                None => (1.2 * light.level).min(0.75 * light.bright),
            };
            let low_blue = if orange { 0.0 } else { ratio(1, -1.0) };
            ColourGate::new(
                format,
                &[
                    ([1.0, -0.5 * ratio(0, -1.0), 0.0], 0.0),
                    ([-1.0, 0.5 * 1.6 * ratio(0, 1.0), 0.0], 0.0),
                    ([0.0, -0.5 * low_blue, 1.0], -1.0),
                    ([0.0, 0.5 * ratio(1, 1.0), -1.0], 0.0),
                    ([1.0, 0.5, 0.0], least * (model.mean[0].exp() + 1.0)),
                ],
            )
        });
        marked.into_iter().chain(told)
    }

    /// What was marked, until enough balls have been seen in the light of this very moment.
    fn marked(&self) -> Option<&Marked> {
        self.marked.as_ref().filter(|_| self.learnt.is_none_or(|(_, n)| n < CONFIDENT))
    }

    /// Diameters of the smallest and the largest ball that was marked, px; none where no colour was learnt.
    pub fn diameter_px(&self) -> Option<[f32; 2]> {
        self.marked.map(|marked| marked.diameter_px)
    }

    /// How well levels R, G, B fit the ball, 0–1: the density of the nearest model, 1 at its mean; `unsure`
    /// is how far off the levels may be, one standard deviation, DN.
    pub fn likeness(&self, light: &SceneLight, rgb: [f32; 3], unsure: [f32; 3]) -> f32 {
        if let Some(marked) = self.marked() {
            return marked.likeness(rgb);
        }
        if self.format == PixelFormat::Mono8 {
            return 1.0;
        }
        let place = place(rgb);
        let doubt = doubt(rgb, unsure);
        self.models(light.grey)
            .map(|model| {
                let d2 = (0..2)
                    .map(|i| (place[i] - model.mean[i]).powi(2) / (model.spread.powi(2) + doubt[i]))
                    .sum::<f32>();
                // Tails of a Cauchy: coloured light and reflections of the floor are not normal errors.
                1.0 / (1.0 + 0.25 * d2)
            })
            .fold(0.0, f32::max)
    }

    /// Forgets what balls have shown.
    pub fn unlearn(&mut self) {
        self.learnt = None;
    }

    /// Takes note of a ball that was certain by its shape.
    pub fn learn(&mut self, rgb: [f32; 3]) {
        let place = place(rgb);
        let (mut model, n) = self.learnt.unwrap_or((BallModel { mean: place, spread: 0.2, level: None }, 0));
        let share = (1.0 / (n + 1) as f32).max(0.02);
        for (mean, place) in model.mean.iter_mut().zip(place) {
            *mean += share * (place - *mean);
        }
        let level = model.level.unwrap_or(rgb[1]);
        model.level = Some(level + share * (rgb[1] - level));
        self.learnt = Some((model, n.saturating_add(1)));
    }
}

/// Detections from which on what was learnt replaces what was told.
const CONFIDENT: u32 = 12;

/// What a ball's levels are off by, DN: black levels, what the lens scatters, and what the fit takes for background.
const LEVEL_SIGMA: f32 = 1.5;

/// Variance of a place by that and by what the levels are `unsure` by, DN: the logarithm of a few levels says little.
/// Blue of an orange ball is such.
fn doubt(rgb: [f32; 3], unsure: [f32; 3]) -> [f32; 2] {
    let [red, green, blue] = std::array::from_fn(|i| {
        let sigma = LEVEL_SIGMA.hypot(unsure[i]);
        (sigma / (rgb[i].max(0.0) + 1.0)).powi(2)
    });
    [red + green, blue + green]
}

fn place(rgb: [f32; 3]) -> [f32; 2] {
    let [red, blue, _] = place_of(rgb);
    [red, blue]
}

/// Where levels R, G, B lie: ln ((R + 1) / (G + 1)), ln ((B + 1) / (G + 1)) and ln (G + 1).
pub fn place_of(rgb: [f32; 3]) -> [f32; 3] {
    let [r, g, b] = rgb.map(|x| (x.max(0.0) + 1.0).ln());
    [r - g, b - g, g]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn learnt(rgb: [f32; 3]) -> ColourModel {
        let mut model = ColourModel::new(PixelFormat::BayerRG8, BallColour::Orange, None);
        (0..CONFIDENT).for_each(|_| model.learn(rgb));
        model
    }

    #[test]
    fn a_level_or_two_of_nearly_no_blue_are_no_other_colour_but_a_share_of_much_is() {
        let light = SceneLight::default();
        let dim = learnt([60.0, 33.0, 7.0]);
        assert!(dim.likeness(&light, [60.0, 33.0, 7.0], [0.0; 3]) > 0.99);
        // Blue at 3 of 33: what a fit is off by.
        assert!(dim.likeness(&light, [60.0, 33.0, 3.0], [0.0; 3]) > 0.6);
        // The same ratios where levels are well known.
        let bright = learnt([240.0, 132.0, 31.0]);
        assert!(bright.likeness(&light, [240.0, 132.0, 15.0], [0.0; 3]) < 0.35);
        // Grey and green are no orange however dim it is.
        for other in [[33.0, 33.0, 33.0], [25.0, 42.0, 32.0], [12.0, 12.0, 12.0]] {
            assert!(
                dim.likeness(&light, other, [0.0; 3]) < 0.15,
                "{other:?}: {}",
                dim.likeness(&light, other, [0.0; 3])
            );
        }
    }
}
