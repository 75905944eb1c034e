//! What colour the ball may have, in the light of the scene.

use netcord_common::{FrameView, PixelFormat, rig::BallColour};

use super::kernel::ColourGate;

/// The light of the scene, as far as its pixels tell: what a grey thing would look like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneLight {
    /// Median of R / G over the frame, and of B / G.
    pub ratios: [f32; 2],
    /// Median level of green, DN.
    pub level: f32,
    /// Level of green that one cell in 50 exceeds, DN.
    pub bright: f32,
}

impl Default for SceneLight {
    fn default() -> Self {
        Self { ratios: [1.0; 2], level: 60.0, bright: 160.0 }
    }
}

/// Cells looked at, along and across.
const LATTICE: (usize, usize) = (48, 32);

impl SceneLight {
    /// From a lattice of cells of a frame.
    pub fn of(view: &FrameView<'_>) -> Self {
        const N: usize = LATTICE.0 * LATTICE.1;
        let mut columns = [[0.0_f32; N]; 3];
        let mut n = 0;
        for j in 0..LATTICE.1 {
            for i in 0..LATTICE.0 {
                let x = (i * (view.width() - 2) / LATTICE.0) & !1;
                let y = (j * (view.height() - 2) / LATTICE.1) & !1;
                let [r, g, b] = cell_colour(view, x, y);
                // One is added to both: black tells nothing, and must not tell wild ratios.
                columns[0][n] = (r + 1.0) / (g + 1.0);
                columns[1][n] = (b + 1.0) / (g + 1.0);
                columns[2][n] = g;
                n += 1;
            }
        }
        let [red, blue, green] = &mut columns;
        let at = |column: &mut [f32; N], share: f64| {
            let place = (share * (N - 1) as f64) as usize;
            *column.select_nth_unstable_by(place, f32::total_cmp).1
        };
        Self {
            ratios: [at(red, 0.5), at(blue, 0.5)],
            level: at(green, 0.5).max(1.0),
            bright: at(green, 0.98).max(2.0),
        }
    }
}

/// Red, mean green and blue of the cell whose top left pixel is (x, y), both even; grey three times.
pub fn cell_colour(view: &FrameView<'_>, x: usize, y: usize) -> [f32; 3] {
    let at = |dx: usize, dy: usize| f32::from(view.row(y + dy)[x + dx]);
    match view.format().red_at() {
        None => [0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)); 3],
        Some((rx, ry)) => {
            let green = 0.5 * (at(1 - rx, ry) + at(rx, 1 - ry));
            [at(rx, ry), green, at(1 - rx, 1 - ry)]
        }
    }
}

/// What is known of the ball's colour: where its ratios R / G and B / G lie, as logarithms against the
/// scene's, with their spread. Learnt from detections that shape alone makes certain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallModel {
    /// ln of (R / G), (B / G) against the scene's medians.
    pub mean: [f32; 2],
    /// Standard deviation of both.
    pub spread: f32,
    /// Level of green, DN; none where it is not known.
    pub level: Option<f32>,
}

/// The orange of table tennis balls against grey: about (0.95, 0.5, 0.12) of the light is thrown back.
/// Sensors see it paler, and scenes are not grey: the spread says so.
const ORANGE: BallModel = BallModel { mean: [0.6, -0.95], spread: 0.45, level: None };
/// White throws back all alike.
const WHITE: BallModel = BallModel { mean: [0.0, 0.0], spread: 0.22, level: None };

/// The colours that are looked for.
#[derive(Debug, Clone)]
pub struct ColourModel {
    format: PixelFormat,
    told: BallColour,
    learnt: Option<(BallModel, u32)>,
}

impl ColourModel {
    /// What a rig file tells.
    pub const fn new(format: PixelFormat, told: BallColour) -> Self {
        Self { format, told, learnt: None }
    }

    /// The models to try.
    pub fn models(&self) -> impl Iterator<Item = BallModel> + '_ {
        let told: &[BallModel] = match self.told {
            BallColour::Orange => &[ORANGE],
            BallColour::White => &[WHITE],
            BallColour::Auto => &[ORANGE, WHITE],
        };
        let learnt = self.learnt.filter(|(_, n)| *n >= CONFIDENT).map(|(model, _)| model);
        learnt.into_iter().chain(told.iter().copied().filter(move |_| learnt.is_none()))
    }

    /// Gates for cells that may be the ball's bright part.
    pub fn gates(&self, light: &SceneLight) -> impl Iterator<Item = ColourGate> + '_ {
        let light = *light;
        let format = self.format;
        self.models().map(move |model| {
            // Half of the hue that sets an orange ball apart from grey must be there.
            let tolerance = (2.2 * model.spread).min(0.5);
            let ratio = |i: usize, sign: f32| light.ratios[i] * (model.mean[i] + sign * tolerance).exp();
            let orange = model.mean[0] > 0.25;
            // White is told by being brighter than its surroundings; orange by hue.
            let least = match model.level {
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
                    ([1.0, 0.5, 0.0], least * (light.ratios[0] + 1.0)),
                ],
            )
        })
    }

    /// How well levels R, G, B fit the ball, 0–1: the density of the nearest model, 1 at its mean.
    pub fn likeness(&self, light: &SceneLight, rgb: [f32; 3]) -> f32 {
        if self.format == PixelFormat::Mono8 {
            return 1.0;
        }
        let place = place(light, rgb);
        self.models()
            .map(|model| {
                let d2 = place.iter().zip(model.mean).map(|(p, m)| (p - m).powi(2)).sum::<f32>();
                // Tails of a Cauchy: coloured light and reflections of the floor are not normal errors.
                1.0 / (1.0 + d2 / (2.0 * model.spread).powi(2))
            })
            .fold(0.0, f32::max)
    }

    /// Takes note of a ball that was certain by its shape.
    pub fn learn(&mut self, light: &SceneLight, rgb: [f32; 3]) {
        let place = place(light, rgb);
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

fn place(light: &SceneLight, [r, g, b]: [f32; 3]) -> [f32; 2] {
    let ln = |x: f32, ratio: f32| ((x.max(0.0) + 1.0) / (g.max(0.0) + 1.0) / ratio).ln();
    [ln(r, light.ratios[0]), ln(b, light.ratios[1])]
}
