//! Holds a fitted ball against what is seen on all sides of its outline.
//!
//! The fit takes what is behind the ball from a plane through its surroundings, and calls what strays from that plane
//! noise; in front of a bookshelf nearly everything is noise then, and any bright stripe a ball. Here each stretch of
//! the outline is asked for itself: does something end there, by as much as the ball should stand out?

use netcord_common::FrameView;

use super::{
    colour::cell_colour,
    fit::Fit,
    grid::Grid,
    lanes::{LANES, Lanes as _, Plain, PlainLanes},
    look::{Light, Look},
    patch::Rectifier,
    sweep::{Coverer, Sweep},
};

/// Stretches of the outline, alike in length: at least, at most, and how long one is, px.
const STRETCHES: (usize, usize) = (6, 16);
const STRETCH_PX: f32 = 5.0;
/// Width of a cell with the blur of an ordinary lens, px.
const CELL_PX: f32 = 2.3;
/// Cells that are looked at, at most; of larger balls some.
const MOST_CELLS: usize = 4000;

/// What is seen along a fitted outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outline {
    /// Of what the ball changes against what is seen outside each stretch, the share that the fitted ball explains;
    /// 1 at best.
    pub explained: f32,
    /// The step in brightness over the outline as a share of the ball's contrast: 1 where the ball ends there, 0 where
    /// what is inside goes on outside. Of the stretches, the least; and what an eighth, a quarter and a half of them do
    /// not exceed. A stretch that cannot be seen counts as half.
    pub steps: [f32; 4],
    /// Root mean square of what is seen around, along the ball's contrast and as a share of it.
    pub busy: f32,
    /// Red of the ball as a share of that of the brighter surfaces around it (a quarter of the stretches has brighter
    /// ones); none where no such red is known: in grey frames, and before lamps and windows, which are no surfaces.
    pub red: Option<f32>,
}

/// One cell near the outline.
#[derive(Debug, Clone, Copy)]
struct Cell {
    stretch: usize,
    seen: [f32; 3],
    alpha: f32,
    ball: [f32; 3],
}

impl Outline {
    /// None where less than half of it lies in the frame.
    pub fn look(
        view: &FrameView<'_>,
        grid: Grid,
        rectifier: &Rectifier,
        fit: &Fit,
        light: &Light,
        [floor, shot]: [f32; 2],
    ) -> Option<Self> {
        let sweep = fit.sweep;
        let reach = (0.6 * sweep.radius).max(3.0) + 1.5;
        let cells = gather(view, grid, rectifier, fit, light, reach);
        let contrast = cells.iter().fold(([0.0_f32; 3], 0.0_f32), |(mut sum, weight), cell| {
            for c in 0..3 {
                sum[c] += cell.alpha * cell.ball[c];
            }
            (sum, weight + cell.alpha)
        });
        if contrast.1 < 1.0 {
            return None;
        }
        let level = contrast.0.map(|sum| sum / contrast.1);
        let outside = |cell: &&Cell| cell.alpha < FREE;
        let all = median(cells.iter().filter(outside))?;
        let c = [0, 1, 2].map(|i| level[i] - all[i]);
        let square = c.iter().map(|c| c * c).sum::<f32>().max(1.0);
        let along = |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|i| (a[i] - b[i]) * c[i]).sum::<f32>() / square;

        let (mut busy, mut free) = (0.0_f32, 0.0_f32);
        for cell in cells.iter().filter(outside) {
            busy += along(&cell.seen, &all).powi(2);
            free += 1.0;
        }
        let (mut left, mut noise, mut changed) = (0.0_f32, 0.0_f32, 0.0_f32);
        let count = stretches(&sweep);
        let mut steps = [0.5; STRETCHES.1];
        let mut seen_stretches = 0;
        let mut reds = [0.0; STRETCHES.1];
        for (stretch, step) in steps.iter_mut().enumerate().take(count) {
            let here = || cells.iter().filter(move |cell| cell.stretch == stretch);
            let Some(behind) = median(here().filter(outside)) else { continue };
            reds[stretch] = behind[0];
            let (mut product, mut squares) = (0.0_f32, 0.0_f32);
            for cell in here().filter(|cell| cell.alpha >= FREE) {
                let model =
                    [0, 1, 2].map(|i| (behind[i] + cell.alpha * (cell.ball[i] - behind[i])).min(255.0));
                for i in 0..3 {
                    // Green is the mean of two pixels; a grey cell, of four.
                    let pixels = if view.format().red_at().is_none() { 4.0 } else { [1.0, 2.0, 1.0][i] };
                    left += (cell.seen[i] - model[i]).powi(2);
                    noise += (floor + shot * model[i].max(0.0)) / pixels;
                    changed += (cell.seen[i] - behind[i]).powi(2);
                }
                product += cell.alpha * along(&cell.seen, &behind);
                squares += cell.alpha * cell.alpha;
            }
            if squares > 0.05 {
                *step = product / squares;
                seen_stretches += 1;
            }
        }
        if 2 * seen_stretches < count {
            return None;
        }
        let steps = &mut steps[..count];
        steps.sort_unstable_by(f32::total_cmp);
        let steps = [0, count / 8, count / 4, count / 2].map(|place| steps[place]);
        let reds = &mut reds[..count];
        reds.sort_unstable_by(f32::total_cmp);
        let red_around = reds[count - 1 - count / 4];
        let is_known = view.format().red_at().is_some() && (LEAST_RED..SATURATED).contains(&red_around);
        Some(Self {
            red: is_known.then(|| level[0] / red_around),
            explained: 1.0 - (left - noise).max(HIDDEN_BY_NOISE * noise) / changed.max(1.0),
            steps,
            busy: (busy / free.max(1.0)).sqrt(),
        })
    }
}

/// Share of the noise that may hide what the ball does not explain: where there is hardly anything but noise, all is
/// explained by anything.
const HIDDEN_BY_NOISE: f32 = 0.3;
/// Levels between which red tells of a surface, DN: below there is hardly any light, above the pixel is full.
const LEAST_RED: f32 = 20.0;
const SATURATED: f32 = 250.0;
/// Cover below which a cell shows what is around, 0–1.
const FREE: f32 = 0.03;

fn gather(
    view: &FrameView<'_>,
    grid: Grid,
    rectifier: &Rectifier,
    fit: &Fit,
    light: &Light,
    reach: f32,
) -> Vec<Cell> {
    let sweep = fit.sweep;
    let [half_width, half_height] = rectifier.half_extent_px(f64::from(sweep.radius + reach));
    let path = rectifier.offset_px(sweep.path().map(f64::from));
    let centre = rectifier.pixel(sweep.centre.map(f64::from));
    let (half_width, half_height) = (half_width + 0.5 * path[0].abs(), half_height + 0.5 * path[1].abs());
    let columns = grid.range(centre[0] - half_width, centre[0] + half_width, view.width() & !1);
    let rows = grid.range(centre[1] - half_height, centre[1] + half_height, view.height() & !1);
    let step = 2 * (columns.len() * rows.len() / 4 / MOST_CELLS + 1);
    let coverer = Coverer::<PlainLanes>::new(Plain, &sweep, &Look::lit_by(*light, CELL_PX), 0);
    let (sin, cos) = sweep.angle.sin_cos();
    let mut cells = Vec::with_capacity(columns.len() * rows.len() / (step * step) + LANES);
    let (mut xs, mut ys) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    let mut waiting: [([f32; 3], usize); LANES] = [([0.0; 3], 0); LANES];
    let mut count = 0;
    let mut flush =
        |count: usize, xs: &[f32; LANES], ys: &[f32; LANES], waiting: &[([f32; 3], usize); LANES]| {
            let coverage = coverer.at(PlainLanes::load(Plain, xs, 0), PlainLanes::load(Plain, ys, 0));
            let (alpha, place) = (coverage.alpha.to_array(), coverage.place.map(|place| place.to_array()));
            for lane in 0..count {
                let ball = fit.shading.map(|terms| {
                    terms.iter().zip(&place).map(|(term, place)| term * place[lane]).sum::<f32>()
                });
                let (seen, stretch) = waiting[lane];
                // Grey frames have one channel.
                let ball = if view.format().red_at().is_none() { [ball[0]; 3] } else { ball };
                cells.push(Cell { stretch, seen, alpha: alpha[lane], ball });
            }
        };
    for y in rows.step_by(step) {
        for x in columns.clone().step_by(step) {
            let middle = |at: usize| 0.5 * (grid.place(at) + grid.place(at + 1));
            let [u, v] = rectifier.rectify([middle(x), middle(y)]).map(|p| p as f32);
            let (dx, dy) = (u - sweep.centre[0], v - sweep.centre[1]);
            let (s, w) = (dx * cos + dy * sin, dy * cos - dx * sin);
            let beyond = (s.abs() - 0.5 * sweep.length).max(0.0);
            if beyond.hypot(w) > sweep.radius + reach {
                continue;
            }
            (xs[count], ys[count]) = (u, v);
            waiting[count] = (cell_colour(view, x, y), stretch(&sweep, s, w));
            count += 1;
            if count == LANES {
                flush(count, &xs, &ys, &waiting);
                count = 0;
            }
        }
    }
    flush(count, &xs, &ys, &waiting);
    cells
}

/// How many stretches an outline has.
fn stretches(sweep: &Sweep) -> usize {
    let length = std::f32::consts::TAU * sweep.radius + 2.0 * sweep.length;
    ((length / STRETCH_PX) as usize).clamp(STRETCHES.0, STRETCHES.1)
}

/// Which stretch of the outline is nearest to a place `s` along and `w` across the path.
fn stretch(sweep: &Sweep, s: f32, w: f32) -> usize {
    let (r, l) = (sweep.radius, sweep.length);
    let half_turn = std::f32::consts::PI * r;
    let at = if s > 0.5 * l {
        r * (w.atan2(s - 0.5 * l) + std::f32::consts::FRAC_PI_2)
    } else if s < -0.5 * l {
        // From the upper end of the path's other side on, in the same sense of rotation.
        half_turn + l + r * ((-w).atan2(-(s + 0.5 * l)) + std::f32::consts::FRAC_PI_2)
    } else if w > 0.0 {
        half_turn + 0.5 * l - s
    } else {
        2.0 * half_turn + l + s + 0.5 * l
    };
    let share = at / (2.0 * half_turn + 2.0 * l);
    let count = stretches(sweep);
    ((share * count as f32) as usize).min(count - 1)
}

/// The median of each colour.
fn median<'a>(cells: impl Iterator<Item = &'a Cell> + Clone) -> Option<[f32; 3]> {
    let mut column = Vec::with_capacity(64);
    let mut out = [0.0; 3];
    for (c, out) in out.iter_mut().enumerate() {
        column.clear();
        column.extend(cells.clone().map(|cell| cell.seen[c]));
        if column.len() < 2 {
            return None;
        }
        let middle = column.len() / 2;
        *out = *column.select_nth_unstable_by(middle, f32::total_cmp).1;
    }
    Some(out)
}
