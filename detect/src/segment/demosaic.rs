//! Interpolates the colours that a mosaic leaves out, for the comparison of raw and interpolated input.
//!
//! Row by row, in loops over whole slices without a branch, which the compiler turns into vectors: all that a pixel of
//! either kind may need is computed at each, and a mask of alternate columns chooses. Rows are copied first, with a
//! mirrored pixel at either end, so that borders are like all else.

use netcord_common::{FrameView, PixelFormat};

use super::options::InputMode;

/// Rows at hand: above the one that is written, itself, and two below, of which the second tells the first's green.
const ROWS: usize = 4;

/// A frame in which every pixel has become a cell of its own: red, green, green, blue, as a mosaic of twice
/// the size, so that the same search runs on it.
#[derive(Debug)]
pub struct Demosaic {
    input: InputMode,
    size: (usize, usize),
    cells: Vec<u8>,
    /// Levels as they are, DN; row y in place `y % ROWS`, one pixel more at either end.
    seen: [Vec<i16>; ROWS],
    /// Green at every pixel of these rows, without ends.
    green: [Vec<i16>; ROWS],
    /// What red and blue are interpolated from: their levels, or how they differ from green; with ends.
    chroma: [Vec<i16>; ROWS],
    /// No bits and all bits in turn: a mask of every other column.
    alternate: Vec<i16>,
    /// A row of zeros.
    nothing: Vec<i16>,
}

impl Demosaic {
    /// For frames of a size.
    pub fn new(input: InputMode, (width, height): (usize, usize)) -> Self {
        let rows = |length: usize| std::array::from_fn(|_| vec![0; length]);
        Self {
            input,
            size: (width, height),
            cells: vec![0; 4 * width * height],
            seen: rows(width + 2),
            green: rows(width),
            chroma: rows(width + 2),
            alternate: (0..=width).map(|x| if x % 2 == 1 { !0 } else { 0 }).collect(),
            nothing: vec![0; width],
        }
    }

    /// Interpolates a frame.
    pub fn run(&mut self, view: &FrameView<'_>) -> FrameView<'_> {
        let (width, height) = self.size;
        // Only mosaics come here: grey frames have nothing to be interpolated, and their segmenter does not ask.
        let red_at = view.format().red_at().unwrap_or((0, 0));
        for y in 0..height.min(2) {
            take(&mut self.seen[y], view.row(y));
        }
        self.interpolate_green(0, red_at);
        for y in 0..height {
            if y + 2 < height {
                take(&mut self.seen[(y + 2) % ROWS], view.row(y + 2));
            }
            if y + 1 < height {
                self.interpolate_green(y + 1, red_at);
            }
            self.write(y, red_at);
        }
        FrameView::new(&self.cells, (2 * width, 2 * height), 2 * width, PixelFormat::BayerRG8)
            .expect("the buffer was made for this size")
    }

    /// Green at every pixel of row `y`, and what its other colours are interpolated from.
    fn interpolate_green(&mut self, y: usize, red_at: (usize, usize)) {
        let width = self.size.0;
        let [above, here, below] = around(y, self.size.1).map(|place| &self.seen[place]);
        let (up, down) = (&above[1..][..width], &below[1..][..width]);
        let [left, own, right] = [0, 1, 2].map(|from| &here[from..][..width]);
        let is_green = green_columns(&self.alternate, y, red_at, width);
        let green = &mut self.green[y % ROWS][..width];
        let ends = &mut self.chroma[y % ROWS];
        let chroma = &mut ends[1..][..width];
        if self.input == InputMode::EdgeAware {
            for x in 0..width {
                let (sideways, upright) = (left[x] + right[x], up[x] + down[x]);
                let (across, along) = ((left[x] - right[x]).abs(), (up[x] - down[x]).abs());
                // Along the edge, if there is one (Laroche & Prescott 1994).
                let mean = (sideways + upright + 2) >> 2;
                let mean = if across > along { (upright + 1) >> 1 } else { mean };
                let mean = if along > across { (sideways + 1) >> 1 } else { mean };
                green[x] = choose(is_green[x], own[x], mean);
                // Differences to green are smooth where the colours themselves have an edge.
                chroma[x] = own[x] - green[x];
            }
        } else {
            for x in 0..width {
                let mean = (left[x] + right[x] + up[x] + down[x] + 2) >> 2;
                green[x] = choose(is_green[x], own[x], mean);
                chroma[x] = own[x];
            }
        }
        mirror_ends(ends);
    }

    /// The cells of row `y`.
    fn write(&mut self, y: usize, red_at: (usize, usize)) {
        let width = self.size.0;
        let green = &self.green[y % ROWS][..width];
        let base = if self.input == InputMode::EdgeAware { green } else { &self.nothing[..width] };
        let is_green = green_columns(&self.alternate, y, red_at, width);
        let chroma = around(y, self.size.1).map(|place| &self.chroma[place]);
        let [[a, b, c], [d, e, f], [g, h, i]] = chroma.map(|row| [0, 1, 2].map(|from| &row[from..][..width]));
        let (top, bottom) = self.cells[4 * width * y..][..4 * width].split_at_mut(2 * width);
        let top = &mut top.as_chunks_mut::<2>().0[..width];
        let bottom = &mut bottom.as_chunks_mut::<2>().0[..width];
        // Red where the row's other pixels are red.
        let own_is_red = if (y ^ red_at.1) & 1 == 0 { !0 } else { 0 };
        for x in 0..width {
            let beside = (d[x] + f[x] + 1) >> 1;
            let upright = (b[x] + h[x] + 1) >> 1;
            let corners = (a[x] + c[x] + g[x] + i[x] + 2) >> 2;
            let own = level(choose(is_green[x], beside, e[x]) + base[x]);
            let other = level(choose(is_green[x], upright, corners) + base[x]);
            let (red, blue) = (choose(own_is_red, own, other), choose(own_is_red, other, own));
            top[x] = [red as u8, green[x] as u8];
            bottom[x] = [green[x] as u8, blue as u8];
        }
    }
}

/// Places of the rows above row `y` of `height`, of itself and below; mirrored at the border, so that colours stay.
fn around(y: usize, height: usize) -> [usize; 3] {
    let last = height - 1;
    let above = if y == 0 { last.min(1) } else { y - 1 };
    let below = if y == last { last.saturating_sub(1) } else { y + 1 };
    [above, y, below].map(|y| y % ROWS)
}

/// All bits in the columns of row `y` that have green pixels.
fn green_columns(alternate: &[i16], y: usize, (rx, ry): (usize, usize), width: usize) -> &[i16] {
    &alternate[(rx + y + ry) % 2..][..width]
}

/// Copies a row of pixels between the ends.
fn take(row: &mut [i16], pixels: &[u8]) {
    for (level, pixel) in row[1..].iter_mut().zip(pixels) {
        *level = i16::from(*pixel);
    }
    mirror_ends(row);
}

/// Fills both ends with the nearest pixel of the colour that would be there.
fn mirror_ends(row: &mut [i16]) {
    let width = row.len() - 2;
    row[0] = row[width.min(2)];
    row[width + 1] = row[width.saturating_sub(1).max(1)];
}

/// `a` where the mask has all bits, `b` where it has none.
const fn choose(mask: i16, a: i16, b: i16) -> i16 {
    (a & mask) | (b & !mask)
}

/// What a pixel can be.
fn level(value: i16) -> i16 {
    value.clamp(0, 255)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Pixel by pixel, as the two ways are defined: red, green and blue.
    struct Oracle<'a> {
        view: FrameView<'a>,
        edge_aware: bool,
    }

    impl Oracle<'_> {
        fn at(&self, x: usize, y: usize) -> [u8; 3] {
            let (rx, ry) = self.view.format().red_at().expect("a mosaic");
            [self.chroma(x, y, (rx, ry)), self.green(x, y) as u8, self.chroma(x, y, (1 - rx, 1 - ry))]
        }

        fn seen(&self, x: usize, y: usize, step: (isize, isize)) -> i32 {
            let (u, v) = (mirrored(x, step.0, self.view.width()), mirrored(y, step.1, self.view.height()));
            i32::from(self.view.row(v)[u])
        }

        fn green(&self, x: usize, y: usize) -> i32 {
            let (rx, ry) = self.view.format().red_at().expect("a mosaic");
            if (x ^ rx ^ y ^ ry) & 1 == 1 {
                return self.seen(x, y, (0, 0));
            }
            let [left, right, up, down] = [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|s| self.seen(x, y, s));
            match ((left - right).abs(), (up - down).abs()) {
                (across, along) if self.edge_aware && across > along => (up + down + 1) / 2,
                (across, along) if self.edge_aware && along > across => (left + right + 1) / 2,
                _ => (left + right + up + down + 2) / 4,
            }
        }

        /// Red or blue, whose own pixels lie at `(sx, sy)` in the cell.
        fn chroma(&self, x: usize, y: usize, (sx, sy): (usize, usize)) -> u8 {
            let steps = |off: usize| if off & 1 == 1 { &[-1, 1][..] } else { &[0][..] };
            let (mut sum, mut n) = (0, 0);
            for dy in steps(y ^ sy) {
                for dx in steps(x ^ sx) {
                    let (u, v) = (mirrored(x, *dx, self.view.width()), mirrored(y, *dy, self.view.height()));
                    sum += self.seen(u, v, (0, 0)) - if self.edge_aware { self.green(u, v) } else { 0 };
                    n += 1;
                }
            }
            let mean = (sum + n / 2).div_euclid(n) + if self.edge_aware { self.green(x, y) } else { 0 };
            mean.clamp(0, 255) as u8
        }
    }

    /// The neighbour, mirrored at the border so that it keeps its colour.
    fn mirrored(at: usize, step: isize, size: usize) -> usize {
        match at.checked_add_signed(step) {
            Some(next) if next < size => next,
            _ => at.saturating_add_signed(-step).min(size - 1),
        }
    }

    #[test]
    fn rows_at_once_are_what_pixels_one_by_one_are() {
        let mut rng = Pcg64Mcg::seed_from_u64(12);
        let mosaics = || PixelFormat::ALL.into_iter().filter(|f| f.red_at().is_some());
        for (width, height) in [(64, 18), (37, 23), (3, 5), (2, 2), (1, 3), (4, 1), (1, 1)] {
            for (format, input) in
                mosaics().flat_map(|f| [InputMode::Bilinear, InputMode::EdgeAware].map(|i| (f, i)))
            {
                let mut demosaic = Demosaic::new(input, (width, height));
                // The second frame meets what the first one has left.
                for _ in 0..2 {
                    // Black, white and what is between them, with bytes behind each row that are none of it.
                    let stride = width + 3;
                    let bytes = (0..stride * height)
                        .map(|_| rng.random_range(-200..456_i32).clamp(0, 255) as u8)
                        .collect::<Vec<_>>();
                    let view = FrameView::new(&bytes, (width, height), stride, format).expect("fits");
                    let oracle = Oracle { view, edge_aware: input == InputMode::EdgeAware };
                    let cells = demosaic.run(&view);
                    for (x, y) in (0..width * height).map(|n| (n % width, n / width)) {
                        let (top, bottom) = (cells.row(2 * y), cells.row(2 * y + 1));
                        let found = [top[2 * x], top[2 * x + 1], bottom[2 * x + 1]];
                        let what = format!("{format} {input:?} {width} × {height} at ({x}, {y})");
                        assert_eq!(found, oracle.at(x, y), "{what}");
                        assert_eq!(bottom[2 * x], found[1], "{what}: both greens of a cell are one");
                    }
                }
            }
        }
    }

    /// A grey ramp must come out as the ramp, in every mosaic and both ways.
    #[test]
    fn a_ramp_stays_a_ramp() {
        let (width, height) = (24, 16);
        for format in PixelFormat::ALL.into_iter().filter(|f| f.red_at().is_some()) {
            for input in [InputMode::Bilinear, InputMode::EdgeAware] {
                let ramp = |x: usize, y: usize| (40 + 4 * x + 2 * y) as u8;
                let bytes = (0..width * height).map(|i| ramp(i % width, i / width)).collect::<Vec<_>>();
                let view = FrameView::new(&bytes, (width, height), width, format).expect("fits");
                let mut demosaic = Demosaic::new(input, (width, height));
                let cells = demosaic.run(&view);
                for y in 2..height - 2 {
                    for x in 2..width - 2 {
                        let found = [
                            cells.row(2 * y)[2 * x],
                            cells.row(2 * y)[2 * x + 1],
                            cells.row(2 * y + 1)[2 * x + 1],
                        ];
                        for level in found {
                            assert!(level.abs_diff(ramp(x, y)) <= 1, "{format} {input:?}: {found:?}");
                        }
                    }
                }
            }
        }
    }
}
