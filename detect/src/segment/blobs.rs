//! Groups marked cells into connected blobs.

use std::{cmp::Ordering, ops::Range};

/// Runs of marked cells that one search can hold. A frame that has more shows another scene.
const MAX_RUNS: usize = 24_000;
/// Blobs that one search can hold.
pub const MAX_BLOBS: usize = 4_096;

/// Cells that may lie between two runs of one blob: where the ball happens to look like what is behind it,
/// its mark is broken. In a row they are filled, and count as marked.
const GAP: u16 = 2;

/// Cells that touch each other, or nearly so.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blob {
    /// How many cells.
    pub cells: u32,
    /// Left column, in cells.
    pub x0: u16,
    /// Top row, in cells.
    pub y0: u16,
    /// Right column, exclusive.
    pub x1: u16,
    /// Bottom row, exclusive.
    pub y1: u16,
    /// Sums over the cells of x, y, x², x y, y², with the blob's first run as the origin.
    sums: [f64; 5],
    origin: [u16; 2],
}

impl Blob {
    const EMPTY: Self =
        Self { cells: 0, x0: u16::MAX, y0: u16::MAX, x1: 0, y1: 0, sums: [0.0; 5], origin: [0; 2] };

    /// Centre, in cells.
    pub fn centre(&self) -> [f64; 2] {
        let n = f64::from(self.cells);
        [f64::from(self.origin[0]) + self.sums[0] / n, f64::from(self.origin[1]) + self.sums[1] / n]
    }

    /// Second moments about the centre, in cells²: xx, xy, yy; each cell as a square.
    pub fn moments(&self) -> [f64; 3] {
        let n = f64::from(self.cells);
        let [x, y, xx, xy, yy] = self.sums.map(|s| s / n);
        [xx - x * x + 1.0 / 12.0, xy - x * y, yy - y * y + 1.0 / 12.0]
    }

    /// Whether it is no wider and no higher than `most` cells.
    const fn fits(&self, most: u16) -> bool {
        self.x1 - self.x0 <= most && self.y1 - self.y0 <= most
    }

    /// Takes in a run, but for the moments.
    fn grow(&mut self, run: &Run) {
        self.cells += u32::from(run.x1 - run.x0);
        self.x0 = self.x0.min(run.x0);
        self.x1 = self.x1.max(run.x1);
        self.y0 = self.y0.min(run.row);
        self.y1 = self.y1.max(run.row + 1);
    }

    /// Adds a run's moments: closed sums over x = a … b − 1.
    fn add_moments(&mut self, run: &Run) {
        let [x, y] = self.origin.map(f64::from);
        let (a, b, y) = (f64::from(run.x0) - x, f64::from(run.x1) - x, f64::from(run.row) - y);
        let n = b - a;
        let sum_x = 0.5 * n * (a + b - 1.0);
        let squares = |m: f64| (m - 1.0) * m * (2.0 * m - 1.0) / 6.0;
        let sum_xx = squares(b) - squares(a);
        let added = [sum_x, n * y, sum_xx, sum_x * y, n * y * y];
        for (sum, added) in self.sums.iter_mut().zip(added) {
            *sum += added;
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Run {
    row: u16,
    x0: u16,
    x1: u16,
    parent: u32,
}

/// Finds blobs, in memory taken once.
#[derive(Debug)]
pub struct BlobFinder {
    runs: Vec<Run>,
    blobs: Vec<Blob>,
    place: Vec<u32>,
    overflow: bool,
    most: u16,
    larger: bool,
    cells: u64,
}

impl BlobFinder {
    /// For blobs of up to `most` cells in width and height, with room for all that it will ever hold.
    pub fn new(most: u16) -> Self {
        Self {
            runs: Vec::with_capacity(MAX_RUNS),
            blobs: Vec::with_capacity(MAX_BLOBS),
            place: Vec::with_capacity(MAX_RUNS),
            most,
            ..Self::empty()
        }
    }

    /// With room for nothing: what stands in the place of one that is lent.
    pub const fn empty() -> Self {
        Self {
            runs: Vec::new(),
            blobs: Vec::new(),
            place: Vec::new(),
            overflow: false,
            most: 0,
            larger: false,
            cells: 0,
        }
    }

    /// The blobs of the last search that are no larger than asked for.
    pub fn blobs(&self) -> &[Blob] {
        &self.blobs
    }

    /// Whether there were larger ones.
    pub const fn saw_larger(&self) -> bool {
        self.larger
    }

    /// Cells of all blobs, the larger ones too.
    pub const fn cells(&self) -> u64 {
        self.cells
    }

    /// Whether there were more than could be held.
    pub const fn overflowed(&self) -> bool {
        self.overflow
    }

    /// Finds the blobs in `rows` of a bitmap of cells with `words_per_row` words in each row.
    pub fn find(&mut self, words: &[u16], words_per_row: usize, rows: Range<usize>) {
        self.runs.clear();
        self.blobs.clear();
        self.place.clear();
        (self.overflow, self.larger, self.cells) = (false, false, 0);
        // First runs of this row and of the two rows above it.
        let (mut above2, mut above) = (0, 0);
        for row in rows {
            let first = self.runs.len();
            self.runs_of_row(&words[row * words_per_row..][..words_per_row], row as u16);
            self.connect(above2, above, first);
            self.connect(above, first, first);
            (above2, above) = (above, first);
            if self.overflow {
                break;
            }
        }
        self.gather();
    }

    fn runs_of_row(&mut self, words: &[u16], row: u16) {
        if words.iter().fold(0, |any, word| any | word) == 0 {
            return;
        }
        let first = self.runs.len();
        let (groups, rest) = words.as_chunks::<4>();
        let mut last = [0; 4];
        last[..rest.len()].copy_from_slice(rest);
        let group = |i: usize| match i.cmp(&groups.len()) {
            Ordering::Less => bits_of(&groups[i]),
            Ordering::Equal => bits_of(&last),
            Ordering::Greater => 0,
        };
        let (mut before, mut here) = (0, group(0));
        for i in 0..=groups.len() {
            let after = group(i + 1);
            let mut bits = close_gaps(before, here, after);
            (before, here) = (here, after);
            let base = (i * 64) as u16;
            while bits != 0 {
                let start = bits.trailing_zeros();
                let length = (bits >> start).trailing_ones();
                let (x0, x1) = (base + start as u16, base + (start + length) as u16);
                bits &= if start + length >= 64 { 0 } else { !0 << (start + length) };
                let count = self.runs.len();
                if count > first && self.runs[count - 1].x1 == x0 {
                    self.runs[count - 1].x1 = x1;
                    continue;
                }
                if count == MAX_RUNS {
                    self.overflow = true;
                    return;
                }
                self.runs.push(Run { row, x0, x1, parent: count as u32 });
            }
        }
    }

    /// Joins the runs `upper..lower` with those of the present row, which begin at `present`.
    fn connect(&mut self, upper: usize, lower: usize, present: usize) {
        if lower == upper {
            return;
        }
        let mut from = upper;
        for i in present..self.runs.len() {
            let run = self.runs[i];
            while from < lower && self.runs[from].x1 + GAP < run.x0 {
                from += 1;
            }
            let mut other = from;
            let mut own = self.root(i);
            while other < lower && self.runs[other].x0 <= run.x1 + GAP {
                own = self.join(other, own);
                other += 1;
            }
        }
    }

    fn root(&mut self, mut i: usize) -> usize {
        while self.runs[i].parent as usize != i {
            let grandparent = self.runs[self.runs[i].parent as usize].parent;
            self.runs[i].parent = grandparent;
            i = grandparent as usize;
        }
        i
    }

    /// Joins a run's blob with the one of root `own`; their common root.
    fn join(&mut self, run: usize, own: usize) -> usize {
        let other = self.root(run);
        // The smaller index stays root: results do not depend on the order of joins.
        let (low, high) = if other < own { (other, own) } else { (own, other) };
        self.runs[high].parent = low as u32;
        low
    }

    fn gather(&mut self) {
        for i in 0..self.runs.len() {
            let root = self.root(i);
            let run = self.runs[i];
            let place = if root == i {
                let place = self.blobs.len();
                if place == MAX_BLOBS {
                    self.overflow = true;
                    return;
                }
                self.blobs.push(Blob { origin: [run.x0, run.row], ..Blob::EMPTY });
                place as u32
            } else {
                self.place[root]
            };
            self.place.push(place);
            self.blobs[place as usize].grow(&run);
        }
        self.cells = self.blobs.iter().map(|blob| u64::from(blob.cells)).sum();
        // Most runs are those of bodies, whose moments nobody asks for.
        for (run, place) in self.runs.iter().zip(&self.place) {
            let blob = &mut self.blobs[*place as usize];
            if blob.fits(self.most) {
                blob.add_moments(run);
            }
        }
        let all = self.blobs.len();
        self.blobs.retain(|blob| blob.fits(self.most));
        self.larger = self.blobs.len() < all;
    }
}

/// 64 cells, lowest bit leftmost.
fn bits_of(words: &[u16; 4]) -> u64 {
    let [a, b, c, d] = words.map(u64::from);
    a | b << 16 | c << 32 | d << 48
}

/// `here` with the gaps filled that are no wider than [`GAP`], those across the borders of its neighbours too.
fn close_gaps(before: u64, here: u64, after: u64) -> u64 {
    if here == 0 && (before >> 62 == 0 || after & 3 == 0) {
        return 0;
    }
    // What is marked one and two cells to the left and to the right.
    let (left1, left2) = (here << 1 | before >> 63, here << 2 | before >> 62);
    let (right1, right2) = (here >> 1 | after << 63, here >> 2 | after << 62);
    here | left1 & (right1 | right2) | left2 & right1
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Flood fill over the same neighbourhood, as an independent second opinion.
    fn flood(cells: &[Vec<bool>]) -> Vec<(u32, f64, f64, f64)> {
        let (h, w) = (cells.len(), cells[0].len());
        let mut seen = vec![vec![false; w]; h];
        let mut out = Vec::new();
        for y in 0..h {
            for x in 0..w {
                if !cells[y][x] || seen[y][x] {
                    continue;
                }
                let mut stack = vec![(x, y)];
                seen[y][x] = true;
                let mut members = Vec::new();
                while let Some((x, y)) = stack.pop() {
                    members.push((x as f64, y as f64));
                    for v in y.saturating_sub(2)..(y + 3).min(h) {
                        for u in x.saturating_sub(3)..(x + 4).min(w) {
                            // In other rows a gap of two cells beside, in the own row too.
                            if cells[v][u] && !seen[v][u] {
                                seen[v][u] = true;
                                stack.push((u, v));
                            }
                        }
                    }
                }
                let n = members.len() as f64;
                let cx = members.iter().map(|m| m.0).sum::<f64>() / n;
                let cy = members.iter().map(|m| m.1).sum::<f64>() / n;
                let xy = members.iter().map(|m| (m.0 - cx) * (m.1 - cy)).sum::<f64>() / n;
                out.push((members.len() as u32, cx, cy, xy));
            }
        }
        out
    }

    /// A row whose gaps of up to two cells are filled.
    fn filled(row: &[bool]) -> Vec<bool> {
        let at = |x: isize| usize::try_from(x).is_ok_and(|x| row.get(x).is_some_and(|marked| *marked));
        (0..row.len() as isize)
            .map(|x| at(x) || (at(x - 1) && (at(x + 1) || at(x + 2))) || (at(x - 2) && at(x + 1)))
            .collect()
    }

    #[test]
    fn blobs_are_those_of_a_flood_fill() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        for density in [0.01, 0.04, 0.1, 0.4] {
            let (w, h) = (150_usize, 60_usize);
            let cells = (0..h)
                .map(|_| (0..w).map(|_| rng.random_bool(density)).collect())
                .collect::<Vec<Vec<bool>>>();
            let words_per_row = w.div_ceil(16);
            let mut words = vec![0_u16; words_per_row * h];
            for (y, row) in cells.iter().enumerate() {
                for x in (0..w).filter(|x| row[*x]) {
                    words[y * words_per_row + x / 16] |= 1 << (x % 16);
                }
            }
            let mut finder = BlobFinder::new(u16::MAX);
            finder.find(&words, words_per_row, 0..h);
            let cells = cells.iter().map(|row| filled(row)).collect::<Vec<_>>();
            let mut found = finder
                .blobs()
                .iter()
                .map(|b| (b.cells, b.centre()[0], b.centre()[1], b.moments()[1]))
                .collect::<Vec<_>>();
            let mut expected = flood(&cells);
            let order = |a: &(u32, f64, f64, f64), b: &(u32, f64, f64, f64)| {
                (a.0, a.1 as i64, a.2 as i64).cmp(&(b.0, b.1 as i64, b.2 as i64))
            };
            found.sort_by(order);
            expected.sort_by(order);
            assert_eq!(found.len(), expected.len(), "density {density}");
            for (f, e) in found.iter().zip(&expected) {
                assert_eq!(f.0, e.0);
                assert!((f.1 - e.1).abs() < 1e-9 && (f.2 - e.2).abs() < 1e-9 && (f.3 - e.3).abs() < 1e-6);
            }
        }
    }
}
