use std::ops::Range;

use netcord_common::{FrameView, PixelFormat};

use super::{
    colour::colour_of,
    kernel::{BackgroundRow, Kernel, LevelTables},
    noise::Noise,
};

/// Width of a zone of its own light, px.
pub const ZONE_PX: usize = 256;
/// Height of a zone, rows.
pub const ZONE_ROWS: usize = 160;

/// Stretches of pixels per zone that tell its light, and their length.
const PROBES: usize = 8;
const PROBE_PX: usize = 64;

/// Once learnt, a row is looked at every so many frames: 320 ms at 100 Hz.
const PERIOD: usize = 32;
/// In the beginning more often.
const FIRST_PERIOD: usize = 4;
/// Frames that the beginning lasts.
const FIRST_FRAMES: u64 = 64;

/// From this change of light on, the background itself is brought to the new light: the tables by which a
/// smaller change is followed are rounded to sixteen levels.
const RELIGHT: f32 = 0.12;
/// Change of light that no entry of a table shows.
const SAME_LIGHT: f32 = 0.002;
/// Zones that are brought to new light in one frame, at most: where lamps flicker all of them ask for it at once,
/// and the tables serve until it is their turn.
const RELIT_AT_ONCE: usize = 4;

/// How many standard deviations a pixel's share in the threshold of a cell is. Four pure-noise pixels sum
/// to (3.2 ± 1.2) σ, so that 4 × 2.6 σ is six deviations above.
const THRESHOLD_SIGMAS: f32 = 2.6;

/// Frames after which the background is taken as known.
const KNOWN_AFTER: u64 = 12;

/// Seconds until a level that stays is believed to be the background.
const PATIENCE_S: f64 = 2.0;

/// How many probes ahead memory is asked for.
const PROBES_AHEAD: usize = 12;

/// A stretch of a row.
struct PlaceOfProbe {
    y: usize,
    x: Range<usize>,
}

/// A rectangle of pixels, half open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PixelBox {
    /// Left.
    pub x0: usize,
    /// Top.
    pub y0: usize,
    /// Right, exclusive.
    pub x1: usize,
    /// Bottom, exclusive.
    pub y1: usize,
}

/// What a camera sees when no ball is there, by pixel, and how light and noise make frames differ from it.
#[derive(Debug)]
pub struct Background {
    kernel: Kernel,
    size: (usize, usize),
    level: Vec<u8>,
    other: Vec<u8>,
    evidence: Vec<u8>,
    zones: (usize, usize),
    /// Light of each zone against that in which its background was learnt.
    light: Vec<f32>,
    tables: Vec<LevelTables>,
    noise: Noise,
    frames: u64,
    patience: u8,
    /// The light for which the tables of each zone were made.
    tabled: Vec<f32>,
    /// What the probes saw last, against the background, zone by zone.
    ratios: Vec<f32>,
    /// Room for a median.
    sorted: Vec<f32>,
}

impl Background {
    /// Nothing known yet of a camera of `width` × `height` pixels that runs at `rate_hz`.
    pub fn new(kernel: Kernel, (width, height): (usize, usize), rate_hz: f64) -> Self {
        let zones = (width.div_ceil(ZONE_PX), height.div_ceil(ZONE_ROWS));
        let pixels = width * height;
        Self {
            kernel,
            size: (width, height),
            level: vec![0; pixels],
            other: vec![0; pixels],
            evidence: vec![0; pixels],
            zones,
            light: vec![1.0; zones.0 * zones.1],
            tables: vec![LevelTables::default(); zones.0 * zones.1],
            noise: Noise::new(),
            frames: 0,
            patience: (PATIENCE_S * rate_hz / PERIOD as f64).round().clamp(4.0, 100.0) as u8,
            tabled: vec![1.0; zones.0 * zones.1],
            ratios: vec![1.0; zones.0 * zones.1 * PROBES],
            sorted: Vec::with_capacity(zones.0 * zones.1 * PROBES),
        }
    }

    /// Whether enough frames have been seen to tell what is new in one.
    pub fn is_known(&self) -> bool {
        self.frames >= KNOWN_AFTER
    }

    /// Frames learnt from so far.
    pub const fn frames(&self) -> u64 {
        self.frames
    }

    /// Takes a frame as the background: the first one, or one of another scene.
    pub fn start_over(&mut self, view: &FrameView<'_>) {
        let (width, height) = self.size;
        for y in 0..height {
            self.level[y * width..][..width].copy_from_slice(view.row(y));
            self.other[y * width..][..width].copy_from_slice(view.row(y));
        }
        self.evidence.fill(0);
        self.light.fill(1.0);
        self.ratios.fill(1.0);
        self.frames = 1;
        (0..self.light.len()).for_each(|zone| self.make_table(zone));
    }

    /// The level of a row.
    pub fn row(&self, y: usize) -> &[u8] {
        &self.level[y * self.size.0..][..self.size.0]
    }

    /// The tables of the zones that row `y` lies in, from left to right.
    pub fn tables(&self, y: usize) -> &[LevelTables] {
        &self.tables[self.zone(0, y)..][..self.zones.0]
    }

    fn zone(&self, x: usize, y: usize) -> usize {
        (y / ZONE_ROWS).min(self.zones.1 - 1) * self.zones.0 + (x / ZONE_PX).min(self.zones.0 - 1)
    }

    /// The level expected at a pixel in the light of the present frame, DN.
    #[inline]
    pub fn expected(&self, x: usize, y: usize) -> f32 {
        (f32::from(self.level[y * self.size.0 + x]) * self.light[self.zone(x, y)]).min(255.0)
    }

    /// The levels expected at the four pixels of a cell whose top left one is (x, y), both even, row by row, DN.
    #[inline]
    pub fn expected_cell(&self, x: usize, y: usize) -> [f32; 4] {
        // Zones are made of whole cells.
        let light = self.light[self.zone(x, y)];
        let at = y * self.size.0 + x;
        [at, at + 1, at + self.size.0, at + self.size.0 + 1]
            .map(|at| (f32::from(self.level[at]) * light).min(255.0))
    }

    /// Red, mean green and blue expected of a cell whose top left pixel is (x, y), both even, DN.
    pub fn expected_colour(&self, format: PixelFormat, x: usize, y: usize) -> [f32; 3] {
        colour_of(format, |dx, dy| self.expected(x + dx, y + dy))
    }

    /// The noise of differences.
    pub const fn noise(&self) -> &Noise {
        &self.noise
    }

    /// Finds out how the light of a frame differs from the background's, zone by zone, from stretches spread
    /// over the frame (0.7 % of it; twice as much in the beginning). Mains flicker and dimmed lamps change all of a
    /// zone alike, which things that move do not: medians tell them apart.
    pub fn look_at_light(&mut self, view: &FrameView<'_>) {
        // Of each zone's probes every other one looks at this frame.
        let (first, step) = if self.is_known() { (self.frames as usize % 2, 2) } else { (0, 1) };
        for n in (first..self.ratios.len()).step_by(step) {
            // Scattered reads: each waits for memory unless it has been asked for a little before.
            if let Some(probe) = self.probe_place(n + step * PROBES_AHEAD) {
                self.kernel.prefetch(&view.row(probe.y)[probe.x.clone()]);
                self.kernel.prefetch(&self.row(probe.y)[probe.x]);
            }
            self.probe(view, n);
        }
        let whole = self.median_of_probes(first, step, |ratio, _| ratio).unwrap_or(1.0);
        if step == 2 {
            // What the others saw is a frame old: by so much has the light changed since.
            let change = self.median_of_probes(first, step, |ratio, last| ratio / last).unwrap_or(1.0);
            self.ratios.iter_mut().skip(1 - first).step_by(2).for_each(|ratio| *ratio *= change);
        }
        for zone in 0..self.light.len() {
            let last = self.light[zone];
            let found = self.light_by_probes(zone, whole, last).unwrap_or(whole);
            // Eight probes are a noisy witness; the whole frame is a steady one.
            self.light[zone] =
                if (found / whole - 1.0).abs() < 0.03 { 0.7 * whole + 0.3 * found } else { found };
        }
        let refit = self.frames.is_multiple_of(8) || self.frames < 8;
        if refit {
            self.noise.refit();
        }
        if self.is_known() {
            let zones = self.light.len();
            let first = self.frames as usize * RELIT_AT_ONCE;
            let mut relit = 0;
            for zone in (0..zones).map(|n| (first + n) % zones) {
                if (self.light[zone] - 1.0).abs() > RELIGHT && relit < RELIT_AT_ONCE {
                    self.relight(zone);
                    relit += 1;
                }
            }
        }
        for zone in 0..self.light.len() {
            if refit || (self.light[zone] - self.tabled[zone]).abs() > SAME_LIGHT {
                self.make_table(zone);
            }
        }
    }

    /// As [`Self::look_at_light`], for the zones of a few columns and rows only: enough for a search window, and
    /// there at once.
    pub fn look_at_light_within(
        &mut self,
        view: &FrameView<'_>,
        columns: &Range<usize>,
        rows: &Range<usize>,
    ) {
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        for y in (rows.start / ZONE_ROWS)..=((rows.end - 1) / ZONE_ROWS) {
            for x in (columns.start / ZONE_PX)..=((columns.end - 1) / ZONE_PX) {
                let zone = self.zone(x * ZONE_PX, y * ZONE_ROWS);
                for n in zone * PROBES..(zone + 1) * PROBES {
                    if let Some(probe) = self.probe_place(n + PROBES_AHEAD / 2) {
                        self.kernel.prefetch(&view.row(probe.y)[probe.x.clone()]);
                        self.kernel.prefetch(&self.row(probe.y)[probe.x]);
                    }
                    self.probe(view, n);
                }
                let last = self.light[zone];
                if let Some(found) = self.light_by_probes(zone, last, last) {
                    self.light[zone] =
                        if (found / last - 1.0).abs() < 0.03 { 0.5 * (last + found) } else { found };
                    self.make_table(zone);
                }
            }
        }
    }

    /// The median over every `step`th probe from `first` on of something made of what it saw and of its zone's last
    /// light.
    fn median_of_probes(&mut self, first: usize, step: usize, of: impl Fn(f32, f32) -> f32) -> Option<f32> {
        self.sorted.clear();
        let probes = self.ratios.iter().enumerate().skip(first).step_by(step);
        self.sorted.extend(probes.map(|(n, ratio)| of(*ratio, self.light[n / PROBES])));
        median_of(&mut self.sorted)
    }

    /// Looks at one stretch.
    fn probe(&mut self, view: &FrameView<'_>, n: usize) {
        let Some(PlaceOfProbe { y, x }) = self.probe_place(n) else { return };
        let seen = &view.row(y)[x.clone()];
        let count = seen.len() as f32;
        let sums = self.kernel.probe(seen, &self.row(y)[x], &self.tables[n / PROBES]);
        let (seen_mean, level_mean) = (sums.seen as f32 / count, sums.level as f32 / count);
        // Half a level added to both: dark stretches tell little and must not tell wild ratios.
        let ratio = (seen_mean + 0.5) / (level_mean + 0.5);
        self.ratios[n] = if level_mean < 3.0 || seen_mean > 250.0 { f32::NAN } else { ratio };
        self.noise.look(seen_mean, sums.deviation as f32 / count);
    }

    /// A zone's light by its probes. Those count that lie near the frame's own change or the zone's last one: the
    /// others see something that moves. None where that is most of them.
    fn light_by_probes(&self, zone: usize, whole: f32, last: f32) -> Option<f32> {
        let near = |r: f32| (r / whole - 1.0).abs() < 0.25 || (r / last - 1.0).abs() < 0.1;
        let mut kept = [0.0; PROBES];
        let mut count = 0;
        for ratio in &self.ratios[zone * PROBES..][..PROBES] {
            if near(*ratio) {
                kept[count] = *ratio;
                count += 1;
            }
        }
        if count * 2 >= PROBES { median_of(&mut kept[..count]) } else { None }
    }

    /// Where probe `n` lies in the present frame: a lattice that shifts with the frames, so that in time all of
    /// each zone is looked at.
    fn probe_place(&self, n: usize) -> Option<PlaceOfProbe> {
        let (width, height) = self.size;
        let (zone, probe) = (n / PROBES, n % PROBES);
        let (zone_x, zone_y) = (zone % self.zones.0, zone / self.zones.0);
        let rows = height.checked_sub(zone_y * ZONE_ROWS)?.min(ZONE_ROWS);
        let columns = (width - zone_x * ZONE_PX).min(ZONE_PX);
        let shift = (self.frames as usize).wrapping_mul(7) + probe * rows / PROBES;
        // Whole lines of the cache, where frames begin with one.
        let room = (columns / PROBE_PX).max(1);
        let x = zone_x * ZONE_PX + (probe * 3 + self.frames as usize) % room * PROBE_PX;
        let y = zone_y * ZONE_ROWS + shift % rows.max(1);
        (zone < self.light.len()).then_some(PlaceOfProbe { y, x: x..(x + PROBE_PX).min(width) })
    }

    /// Brings the background of a zone to the present light.
    fn relight(&mut self, zone: usize) {
        let (width, height) = self.size;
        let (zone_x, zone_y) = (zone % self.zones.0, zone / self.zones.0);
        let light = self.light[zone];
        let (x0, x1) = (zone_x * ZONE_PX, ((zone_x + 1) * ZONE_PX).min(width));
        for y in zone_y * ZONE_ROWS..((zone_y + 1) * ZONE_ROWS).min(height) {
            for plane in [&mut self.level, &mut self.other] {
                for level in &mut plane[y * width + x0..y * width + x1] {
                    *level = (f32::from(*level) * light + 0.5).min(255.0) as u8;
                }
            }
        }
        self.light[zone] = 1.0;
        self.ratios[zone * PROBES..][..PROBES].iter_mut().for_each(|ratio| *ratio /= light);
    }

    fn make_table(&mut self, zone: usize) {
        let light = self.light[zone];
        self.tabled[zone] = light;
        let tables = &mut self.tables[zone];
        let rounding = 8.0 * (light - 1.0).abs();
        for i in 0..16 {
            let level = (16 * i + 8) as f32;
            let change = level * (light - 1.0);
            // Casts to u8 round down and saturate.
            tables.brighter[i] = (change + 0.5) as u8;
            tables.dimmer[i] = (0.5 - change) as u8;
            let threshold = THRESHOLD_SIGMAS * self.noise.sigma(level * light) + 0.6 * rounding;
            tables.threshold[i] = (threshold as u8).saturating_add(1).clamp(2, 60);
        }
    }

    /// Learns from a frame, except inside `kept`: boxes of what may be the ball. One row in sixteen is looked
    /// at in each frame.
    pub fn learn(&mut self, view: &FrameView<'_>, kept: &[PixelBox]) {
        let (width, height) = self.size;
        let period = if self.frames < FIRST_FRAMES { FIRST_PERIOD } else { PERIOD };
        let first = (self.frames as usize * 5) % period;
        for y in (first..height).step_by(period) {
            if y + period < height {
                let next = (y + period) * width..(y + period + 1) * width;
                self.kernel.prefetch(view.row(y + period));
                for plane in [&self.level, &self.other, &self.evidence] {
                    self.kernel.prefetch(&plane[next.clone()]);
                }
            }
            let mut x = 0;
            while x < width {
                // To the end of the zone, or to the next box, or from inside a box to its end.
                let zone_end = ((x / ZONE_PX + 1) * ZONE_PX).min(width);
                let inside = kept.iter().find(|b| (b.y0..b.y1).contains(&y) && (b.x0..b.x1).contains(&x));
                if let Some(inside) = inside {
                    x = inside.x1.min(width);
                    continue;
                }
                let end = kept
                    .iter()
                    .filter(|b| (b.y0..b.y1).contains(&y) && b.x0 > x)
                    .map(|b| b.x0)
                    .fold(zone_end, usize::min);
                let zone = self.zone(x, y);
                let at = y * width;
                let background = BackgroundRow {
                    level: &mut self.level[at + x..at + end],
                    other: &mut self.other[at + x..at + end],
                    evidence: &mut self.evidence[at + x..at + end],
                };
                self.kernel.learn(&view.row(y)[x..end], background, &self.tables[zone], self.patience);
                x = end;
            }
        }
        self.frames += 1;
    }

    /// Takes the frame as the background inside a box: what was there has turned out to have gone.
    pub fn replace(&mut self, view: &FrameView<'_>, area: &PixelBox) {
        let width = self.size.0;
        for y in area.y0..area.y1.min(self.size.1) {
            for x in area.x0..area.x1.min(width) {
                let light = self.light[self.zone(x, y)];
                let at = y * width + x;
                self.other[at] = self.level[at];
                self.evidence[at] = 0;
                self.level[at] = (f32::from(view.row(y)[x]) / light).round().min(255.0) as u8;
            }
        }
    }
}

/// The median of what is finite, whose order changes; none where nothing is.
fn median_of(values: &mut [f32]) -> Option<f32> {
    let mut count = 0;
    for i in 0..values.len() {
        if values[i].is_finite() {
            values.swap(i, count);
            count += 1;
        }
    }
    let kept = &mut values[..count];
    (!kept.is_empty()).then(|| *kept.select_nth_unstable_by(count / 2, f32::total_cmp).1)
}
