use std::ops::Range;

use netcord_common::FrameView;

use super::{
    background::{Background, ZONE_PX},
    kernel::{ColourGate, Kernel, WORD_PX},
};

/// Of so many rows of cells one is always looked at; the others only beside what it marks. A ball of 4 px, the
/// smallest that is looked for, is as high as this many rows of cells, so that none lies between two looks.
const ROWS_PER_LOOK: usize = 2;

/// The cells of a frame that differ from the background, as a bitmap: 16 cells to a word, lowest bit leftmost.
#[derive(Debug)]
pub struct Foreground {
    kernel: Kernel,
    words: Vec<u16>,
    words_per_row: usize,
    /// What is marked above or below a row, with an empty word at either end.
    both: Vec<u16>,
}

impl Foreground {
    /// Of frames of `width` × `height` pixels.
    pub fn new(kernel: Kernel, (width, height): (usize, usize)) -> Self {
        let words_per_row = width.div_ceil(WORD_PX);
        Self {
            kernel,
            words: vec![0; words_per_row * height.div_ceil(2)],
            words_per_row,
            both: vec![0; words_per_row + 2],
        }
    }

    /// All words, row of cells by row of cells.
    pub fn words(&self) -> &[u16] {
        &self.words
    }

    /// Words of a row of cells.
    pub const fn words_per_row(&self) -> usize {
        self.words_per_row
    }

    /// Marks what differs in the whole frame. Half of its rows are read only beside what differs in the others.
    pub fn mark(&mut self, view: &FrameView<'_>, background: &Background) {
        let cells = view.height() / 2;
        for cell_y in (0..cells).step_by(ROWS_PER_LOOK) {
            self.look(view, background, cell_y);
            // At once: what was read beside it is still near.
            if let Some(between) = cell_y.checked_sub(1) {
                self.fill_in(view, background, between, true);
            }
        }
        if cells > 0 && cells.is_multiple_of(ROWS_PER_LOOK) {
            self.fill_in(view, background, cells - 1, false);
        }
    }

    /// Marks a row of cells, all of it.
    fn look(&mut self, view: &FrameView<'_>, background: &Background, cell_y: usize) {
        let words = &mut self.words[cell_y * self.words_per_row..][..self.words_per_row];
        let y = 2 * cell_y;
        self.kernel.foreground(
            [view.row(y), view.row(y + 1)],
            [background.row(y), background.row(y + 1)],
            background.tables(y),
            ZONE_PX,
            2 * ROWS_PER_LOOK * view.width(),
            words,
        );
    }

    /// Marks a row of cells beside the marks of the row above it and, where there is one, of the row below.
    fn fill_in(&mut self, view: &FrameView<'_>, background: &Background, cell_y: usize, has_below: bool) {
        let (before, rest) = self.words[(cell_y - 1) * self.words_per_row..].split_at_mut(self.words_per_row);
        let (words, after) = rest.split_at_mut(self.words_per_row);
        let after = if has_below { &after[..self.words_per_row] } else { &*before };
        if !mark_neighbours(before, after, &mut self.both, words) {
            return;
        }
        let y = 2 * cell_y;
        self.kernel.foreground_among(
            [view.row(y), view.row(y + 1)],
            [background.row(y), background.row(y + 1)],
            background.tables(y),
            ZONE_PX,
            words,
        );
    }

    /// Marks what differs in some columns and rows, and nothing else in these rows.
    pub fn mark_within(
        &mut self,
        view: &FrameView<'_>,
        background: &Background,
        columns: &Range<usize>,
        rows: &Range<usize>,
    ) {
        let first_word = columns.start / WORD_PX;
        // Tables belong to whole zones.
        let first_zone = columns.start / ZONE_PX;
        let (x0, x1) = (first_zone * ZONE_PX, columns.end.next_multiple_of(WORD_PX).min(view.width()));
        for y in rows.clone().step_by(2) {
            let words = &mut self.words[y / 2 * self.words_per_row..][..self.words_per_row];
            words.fill(0);
            words[first_word..x1.div_ceil(WORD_PX)].fill(0xffff);
            self.kernel.foreground_among(
                [&view.row(y)[x0..x1], &view.row(y + 1)[x0..x1]],
                [&background.row(y)[x0..x1], &background.row(y + 1)[x0..x1]],
                &background.tables(y)[first_zone..],
                ZONE_PX,
                &mut words[x0 / WORD_PX..],
            );
        }
    }

    /// Writes to `coloured` which of the marked cells in some columns and rows pass a gate; all of them count as
    /// marked where `everywhere` is set.
    pub fn pass(
        &self,
        view: &FrameView<'_>,
        gate: &ColourGate,
        (columns, rows): (&Range<usize>, &Range<usize>),
        everywhere: bool,
        coloured: &mut [u16],
    ) {
        let x = columns.start / WORD_PX * WORD_PX..columns.end.next_multiple_of(WORD_PX).min(view.width());
        for y in rows.clone().step_by(2) {
            let row = y / 2 * self.words_per_row..(y / 2 + 1) * self.words_per_row;
            let words = &mut coloured[row.clone()];
            if everywhere {
                words.fill(0xffff);
            } else {
                words.copy_from_slice(&self.words[row]);
            }
            let cells = [&view.row(y)[x.clone()], &view.row(y + 1)[x.clone()]];
            self.kernel.colour(cells, gate, &mut words[x.start / WORD_PX..]);
        }
    }
}

/// Sets all bits of the words beside which, above or below, something is marked, and clears the others; whether
/// any is set. `both` is room for two words more than a row has.
fn mark_neighbours(above: &[u16], below: &[u16], both: &mut [u16], words: &mut [u16]) -> bool {
    let n = words.len();
    for ((both, above), below) in both[1..=n].iter_mut().zip(above).zip(below) {
        *both = above | below;
    }
    let mut any = 0;
    for (i, word) in words.iter_mut().enumerate() {
        // What is marked at a word's edge reaches into the next one.
        let near = both[i] >> 15 | both[i + 1] | both[i + 2] & 1;
        *word = if near == 0 { 0 } else { 0xffff };
        any |= near;
    }
    any != 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_beside_marks_are_looked_at_and_no_others() {
        let above = [0, 0x8000, 0, 0, 0, 0];
        let below = [0, 0, 0, 0, 1, 0];
        let (mut words, mut both) = ([7; 6], [0; 8]);
        assert!(mark_neighbours(&above, &below, &mut both, &mut words));
        assert_eq!(words, [0, 0xffff, 0xffff, 0xffff, 0xffff, 0]);
        assert!(!mark_neighbours(&[0; 6], &[0; 6], &mut both, &mut words));
        assert_eq!(words, [0; 6]);
    }
}
