//! The kernels in portable Rust: what the others are tested against, and the ends of rows for all.

use super::{BackgroundRow, ColourGate, LevelTables, Probe, WORD_PX};

/// From word `first_word` on.
pub fn foreground(
    rows: [&[u8]; 2],
    background: [&[u8]; 2],
    zones: &[LevelTables],
    zone_px: usize,
    words: &mut [u16],
    first_word: usize,
) {
    let count = rows[0].len().div_ceil(WORD_PX);
    words[first_word..count].fill(0xffff);
    foreground_among(rows, background, zones, zone_px, words, first_word);
}

/// From word `first_word` on, where words are not zero.
pub fn foreground_among(
    rows: [&[u8]; 2],
    background: [&[u8]; 2],
    zones: &[LevelTables],
    zone_px: usize,
    words: &mut [u16],
    first_word: usize,
) {
    let width = rows[0].len();
    for (word_index, word) in words.iter_mut().enumerate().take(width.div_ceil(WORD_PX)).skip(first_word) {
        if *word == 0 {
            continue;
        }
        let x0 = word_index * WORD_PX;
        let tables = &zones[(x0 / zone_px).min(zones.len() - 1)];
        let mut bits = 0;
        for cell in 0..WORD_PX / 2 {
            let x = x0 + 2 * cell;
            let (mut difference, mut threshold) = (0_u16, 0_u16);
            for y in 0..2 {
                for x in x..(x + 2).min(width) {
                    let level = background[y][x];
                    difference += u16::from(rows[y][x].abs_diff(tables.expected(level)));
                    threshold += u16::from(tables.threshold(level));
                }
            }
            bits |= u16::from(difference > threshold) << cell;
        }
        *word = bits;
    }
}

/// From word `first_word` on.
pub fn colour(rows: [&[u8]; 2], gate: &ColourGate, words: &mut [u16], first_word: usize) {
    let width = rows[0].len();
    for (word_index, word) in words.iter_mut().enumerate().take(width.div_ceil(WORD_PX)).skip(first_word) {
        let mut bits = *word;
        while bits != 0 {
            let cell = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let x = word_index * WORD_PX + 2 * cell;
            // The last word of a row may reach beyond its end, where there is nothing of any colour.
            if x >= width {
                *word &= !(1 << cell);
                continue;
            }
            let right = (x + 1).min(width - 1);
            if !gate.passes([rows[0][x], rows[0][right], rows[1][x], rows[1][right]]) {
                *word &= !(1 << cell);
            }
        }
    }
}

/// One pixel's step; see [`super::Kernel::learn`].
#[inline(always)]
pub fn learn_pixel(
    seen: u8,
    level: &mut u8,
    other: &mut u8,
    evidence: &mut u8,
    tables: &LevelTables,
    patience: u8,
) {
    let expected = tables.expected(*level);
    let tolerance = tables.threshold(*level).saturating_mul(2);
    if seen.abs_diff(expected) <= tolerance {
        // Steps of one: the level follows the median, which a passing ball does not move.
        *level = level.saturating_add(u8::from(seen > expected)).saturating_sub(u8::from(seen < expected));
        if *evidence < 128 {
            *evidence = evidence.saturating_sub(1);
        }
        return;
    }
    let former = *evidence >= 128;
    if seen.abs_diff(*other) <= tolerance {
        let enough = former || *evidence + 1 >= patience;
        if enough {
            core::mem::swap(level, other);
            *evidence = 128;
        } else {
            *evidence += 1;
        }
    } else if former && *evidence < 128 + patience {
        *evidence += 1;
    } else if former || *evidence == 0 {
        *other = seen;
        *evidence = 1;
    } else {
        *evidence -= 1;
    }
}

pub fn learn(row: &[u8], background: BackgroundRow<'_>, tables: &LevelTables, patience: u8) {
    let BackgroundRow { level, other, evidence } = background;
    for (((seen, level), other), evidence) in row.iter().zip(level).zip(other).zip(evidence) {
        learn_pixel(*seen, level, other, evidence, tables, patience);
    }
}

pub fn probe(row: &[u8], level: &[u8], tables: &LevelTables) -> Probe {
    let mut probe = Probe::default();
    for (seen, level) in row.iter().zip(level) {
        probe.seen += u32::from(*seen);
        probe.level += u32::from(*level);
        probe.deviation += u32::from(seen.abs_diff(tables.expected(*level)));
    }
    probe
}

pub fn sum(bytes: &[u8]) -> u64 {
    bytes.iter().map(|b| u64::from(*b)).sum()
}
