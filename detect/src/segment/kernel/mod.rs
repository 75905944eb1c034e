//! The loops that touch every pixel: explicit SIMD chosen at run time, with a plain version beside it that
//! gives the same bits.
//!
//! All work on whole mosaics: a *cell* is 2 × 2 pixels (one red, two green, one blue; or four grey ones), and
//! a *word* holds the verdict on 16 cells of one row of cells, 32 pixels wide, lowest bit leftmost.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod colour_gate;
#[cfg(target_arch = "aarch64")]
mod neon;
mod plain;
#[cfg(test)]
mod tests;

pub use colour_gate::{ColourGate, GATE_TESTS};

/// Pixels that one word covers.
pub const WORD_PX: usize = 32;

/// What is expected of a pixel where the background has a certain level, by the upper four bits of that
/// level: 16 entries fit one shuffle of a vector register.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(C, align(16))]
pub struct LevelTables {
    /// Added to the background's level when the light is brighter than when it was learnt, DN.
    pub brighter: [u8; 16],
    /// Subtracted from it when the light is dimmer, DN.
    pub dimmer: [u8; 16],
    /// A quarter of the summed absolute difference of a cell from which on it is foreground, DN.
    pub threshold: [u8; 16],
}

impl LevelTables {
    /// The level expected where the background's is `level`.
    #[inline(always)]
    pub fn expected(&self, level: u8) -> u8 {
        let i = usize::from(level >> 4);
        level.saturating_add(self.brighter[i]).saturating_sub(self.dimmer[i])
    }

    /// The threshold where the background's level is `level`.
    #[inline(always)]
    pub fn threshold(&self, level: u8) -> u8 {
        self.threshold[usize::from(level >> 4)]
    }
}

/// One row of the learnt background: its level, the level it may be changing to, and the evidence for that.
#[derive(Debug)]
pub struct BackgroundRow<'a> {
    /// The level, DN.
    pub level: &'a mut [u8],
    /// The other level that this pixel has had lately, DN.
    pub other: &'a mut [u8],
    /// Below 128: in how many looks `other` has been seen; from 128 on `other` is a former background,
    /// and the rest counts the looks that fit neither.
    pub evidence: &'a mut [u8],
}

/// Sums over a stretch of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Probe {
    /// Of the levels seen, DN.
    pub seen: u32,
    /// Of the background's levels, DN.
    pub level: u32,
    /// Of the absolute differences between what is seen and what is expected, DN.
    pub deviation: u32,
}

/// Which instructions the kernels use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kernel {
    /// Portable Rust.
    Plain,
    /// x86-64 with AVX2.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AArch64.
    #[cfg(target_arch = "aarch64")]
    Neon,
}

impl Kernel {
    /// The fastest that this machine has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            return Self::Avx2;
        }
        #[cfg(target_arch = "aarch64")]
        if std::arch::is_aarch64_feature_detected!("neon") {
            return Self::Neon;
        }
        Self::Plain
    }

    /// Marks the cells of a pair of rows that differ from the background.
    ///
    /// `zones` are the tables of stretches of `zone_px` pixels (a multiple of [`WORD_PX`]); the last one
    /// serves what is left. Writes one word per 32 pixels, the last one for what remains of the row. Memory
    /// `ahead_px` pixels further on, in frame and background, is asked for on the way.
    ///
    /// # Panics
    /// When the slices do not have one length, or `words` is too short for them.
    pub fn foreground(
        self,
        rows: [&[u8]; 2],
        background: [&[u8]; 2],
        zones: &[LevelTables],
        zone_px: usize,
        ahead_px: usize,
        words: &mut [u16],
    ) {
        check_foreground(rows, background, zones, zone_px, words);
        match self {
            Self::Plain => plain::foreground(rows, background, zones, zone_px, words, 0),
            // SAFETY: `detect` gives Avx2 only where the processor has it; the lengths are checked above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2::foreground(rows, background, zones, zone_px, ahead_px, words) },
            // SAFETY: `detect` gives Neon only where the processor has it; the lengths are checked above.
            #[cfg(target_arch = "aarch64")]
            Self::Neon => unsafe { neon::foreground(rows, background, zones, zone_px, ahead_px, words) },
        }
    }

    /// As [`Self::foreground`], but only where a word is not zero: others are left so, and their pixels not read.
    ///
    /// # Panics
    /// When the slices do not have one length, or `words` is too short for them.
    pub fn foreground_among(
        self,
        rows: [&[u8]; 2],
        background: [&[u8]; 2],
        zones: &[LevelTables],
        zone_px: usize,
        words: &mut [u16],
    ) {
        check_foreground(rows, background, zones, zone_px, words);
        match self {
            Self::Plain => plain::foreground_among(rows, background, zones, zone_px, words, 0),
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2::foreground_among(rows, background, zones, zone_px, words) },
            // SAFETY: as above.
            #[cfg(target_arch = "aarch64")]
            Self::Neon => unsafe { neon::foreground_among(rows, background, zones, zone_px, words) },
        }
    }

    /// Marks the cells among `words` whose colour passes `gate`; clears the others.
    ///
    /// # Panics
    /// When the rows differ in length, or `words` is too short for them.
    pub fn colour(self, rows: [&[u8]; 2], gate: &ColourGate, words: &mut [u16]) {
        let width = rows[0].len();
        assert!(rows[1].len() == width && words.len() >= width.div_ceil(WORD_PX));
        match self {
            Self::Plain => plain::colour(rows, gate, words, 0),
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2::colour(rows, gate, words) },
            // SAFETY: as above.
            #[cfg(target_arch = "aarch64")]
            Self::Neon => unsafe { neon::colour(rows, gate, words) },
        }
    }

    /// Lets a stretch of the background learn from a stretch of a frame's row; `patience` is the number of
    /// looks after which a new level is believed.
    ///
    /// # Panics
    /// When the slices do not have one length, or `patience` is not in 1..=100.
    pub fn learn(self, row: &[u8], background: BackgroundRow<'_>, tables: &LevelTables, patience: u8) {
        let width = row.len();
        assert!(background.level.len() == width && background.other.len() == width);
        assert!(background.evidence.len() == width && (1..=100).contains(&patience));
        match self {
            Self::Plain => plain::learn(row, background, tables, patience),
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2::learn(row, background, tables, patience) },
            // SAFETY: as above.
            #[cfg(target_arch = "aarch64")]
            Self::Neon => unsafe { neon::learn(row, background, tables, patience) },
        }
    }

    /// Asks for a stretch of memory that will be read soon.
    pub fn prefetch(self, bytes: &[u8]) {
        match self {
            // SAFETY: `detect` gives Avx2 only where the processor has it.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2::prefetch_all(bytes) },
            #[cfg(target_arch = "aarch64")]
            Self::Neon => neon::prefetch_all(bytes),
            // Rust has no portable way to ask.
            Self::Plain => {}
        }
    }

    /// Compares a stretch of a frame's row with the background's `level`.
    ///
    /// # Panics
    /// When the slices do not have one length.
    pub fn probe(self, row: &[u8], level: &[u8], tables: &LevelTables) -> Probe {
        assert!(row.len() == level.len());
        match self {
            Self::Plain => plain::probe(row, level, tables),
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2::probe(row, level, tables) },
            // SAFETY: as above.
            #[cfg(target_arch = "aarch64")]
            Self::Neon => unsafe { neon::probe(row, level, tables) },
        }
    }

    /// The sum of all bytes: the plain read of memory that the search is measured against.
    pub fn sum(self, bytes: &[u8]) -> u64 {
        match self {
            Self::Plain => plain::sum(bytes),
            // SAFETY: `detect` gives Avx2 only where the processor has it.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { avx2::sum(bytes) },
            // SAFETY: `detect` gives Neon only where the processor has it.
            #[cfg(target_arch = "aarch64")]
            Self::Neon => unsafe { neon::sum(bytes) },
        }
    }
}

fn check_foreground(
    rows: [&[u8]; 2],
    background: [&[u8]; 2],
    zones: &[LevelTables],
    zone_px: usize,
    words: &[u16],
) {
    let width = rows[0].len();
    assert!(rows[1].len() == width && background[0].len() == width && background[1].len() == width);
    assert!(words.len() >= width.div_ceil(WORD_PX) && !zones.is_empty());
    assert!(zone_px >= WORD_PX && zone_px.is_multiple_of(WORD_PX));
}
