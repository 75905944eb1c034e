//! The kernels with NEON: 16 pixels at a time.

use core::arch::{
    aarch64::{
        uint8x16_t, uint16x8_t, vabdq_u8, vaddq_u8, vaddq_u16, vaddvq_u16, vaddvq_u32, vaddvq_u64, vandq_u8,
        vandq_u16, vbicq_u8, vbslq_u8, vceqzq_u8, vcgeq_u8, vcgtq_s16, vcgtq_u8, vcgtq_u16, vcleq_u8,
        vcltq_u8, vdupq_n_s16, vdupq_n_u8, vdupq_n_u16, vdupq_n_u32, vdupq_n_u64, vld1q_u8, vld1q_u16,
        vmlaq_s16, vorrq_u8, vorrq_u16, vpadalq_u16, vpadalq_u32, vpaddlq_u8, vpaddlq_u16, vqaddq_u8,
        vqsubq_u8, vqtbl1q_u8, vreinterpretq_s16_u16, vreinterpretq_u16_u8, vshrq_n_u8, vshrq_n_u16,
        vst1q_u8, vsubq_u8,
    },
    asm,
};

use super::{BackgroundRow, ColourGate, LevelTables, Probe, WORD_PX, plain};

/// Pixels of one register.
const REGISTER_PX: usize = 16;

/// Bytes that one request for memory brings, on all but a few processors.
const CACHE_LINE: usize = 64;

/// The tables of one zone.
#[derive(Clone, Copy)]
struct Tables {
    brighter: uint8x16_t,
    dimmer: uint8x16_t,
    threshold: uint8x16_t,
}

#[target_feature(enable = "neon")]
fn load_tables(tables: &LevelTables) -> Tables {
    // SAFETY: each array has 16 bytes.
    unsafe {
        Tables {
            brighter: vld1q_u8(tables.brighter.as_ptr()),
            dimmer: vld1q_u8(tables.dimmer.as_ptr()),
            threshold: vld1q_u8(tables.threshold.as_ptr()),
        }
    }
}

/// # Safety
/// `slice` has 16 bytes from `at` on.
#[target_feature(enable = "neon")]
unsafe fn load(slice: &[u8], at: usize) -> uint8x16_t {
    debug_assert!(at + REGISTER_PX <= slice.len());
    // SAFETY: by this function's own contract.
    unsafe { vld1q_u8(slice.as_ptr().add(at)) }
}

/// # Safety
/// `slice` has 16 bytes from `at` on.
#[target_feature(enable = "neon")]
unsafe fn store(slice: &mut [u8], at: usize, value: uint8x16_t) {
    debug_assert!(at + REGISTER_PX <= slice.len());
    // SAFETY: by this function's own contract.
    unsafe { vst1q_u8(slice.as_mut_ptr().add(at), value) }
}

/// Asks for the cache line `at` bytes from the slice's beginning, which may lie beyond its end.
#[inline(always)]
fn prefetch(slice: &[u8], at: usize) {
    let address = slice.as_ptr().wrapping_add(at);
    // `core::arch` has no stable name for it.
    // SAFETY: a hint that reads nothing and cannot fault, whatever the address.
    unsafe { asm!("prfm pldl1keep, [{}]", in(reg) address, options(nomem, nostack, preserves_flags)) };
}

/// Asks for all of a stretch of memory.
pub fn prefetch_all(bytes: &[u8]) {
    for at in (0..bytes.len()).step_by(CACHE_LINE) {
        prefetch(bytes, at);
    }
    prefetch(bytes, bytes.len().saturating_sub(1));
}

#[target_feature(enable = "neon")]
fn index_of(level: uint8x16_t) -> uint8x16_t {
    vshrq_n_u8::<4>(level)
}

#[target_feature(enable = "neon")]
fn expected(level: uint8x16_t, index: uint8x16_t, tables: &Tables) -> uint8x16_t {
    let brighter = vqaddq_u8(level, vqtbl1q_u8(tables.brighter, index));
    vqsubq_u8(brighter, vqtbl1q_u8(tables.dimmer, index))
}

/// 16 lanes of all ones or zeros as 16 bits.
#[target_feature(enable = "neon")]
fn lanes_to_bits(lanes: [uint16x8_t; 2]) -> u16 {
    const BITS: [[u16; 8]; 2] =
        [[1, 2, 4, 8, 16, 32, 64, 128], [256, 512, 1024, 2048, 4096, 8192, 16_384, 32_768]];
    // SAFETY: each array has 8 entries.
    let bits = unsafe { [vld1q_u16(BITS[0].as_ptr()), vld1q_u16(BITS[1].as_ptr())] };
    // No two lanes share a bit: their sum is their union.
    vaddvq_u16(vorrq_u16(vandq_u16(lanes[0], bits[0]), vandq_u16(lanes[1], bits[1])))
}

/// The marks of 16 cells of a pair of rows.
///
/// # Safety
/// All rows have 32 bytes from `at` on.
#[target_feature(enable = "neon")]
unsafe fn marks(rows: [&[u8]; 2], background: [&[u8]; 2], at: usize, tables: &Tables) -> u16 {
    let mut exceeds = [vdupq_n_u16(0); 2];
    for (half, exceeds) in exceeds.iter_mut().enumerate() {
        let at = at + half * REGISTER_PX;
        let mut difference = vdupq_n_u16(0);
        let mut threshold = vdupq_n_u16(0);
        for y in 0..2 {
            // SAFETY: by this function's own contract.
            let (seen, level) = unsafe { (load(rows[y], at), load(background[y], at)) };
            let index = index_of(level);
            let d = vabdq_u8(seen, expected(level, index, tables));
            let t = vqtbl1q_u8(tables.threshold, index);
            difference = vaddq_u16(difference, vpaddlq_u8(d));
            threshold = vaddq_u16(threshold, vpaddlq_u8(t));
        }
        *exceeds = vcgtq_u16(difference, threshold);
    }
    lanes_to_bits(exceeds)
}

/// # Safety
/// The processor has NEON; all rows have one length, and `words` a word for every 32 pixels of it.
#[target_feature(enable = "neon")]
pub unsafe fn foreground(
    rows: [&[u8]; 2],
    background: [&[u8]; 2],
    zones: &[LevelTables],
    zone_px: usize,
    ahead: usize,
    words: &mut [u16],
) {
    let whole_words = rows[0].len() / WORD_PX;
    let zone_words = zone_px / WORD_PX;
    let mut word_index = 0;
    for (zone, tables) in zones.iter().enumerate() {
        let end =
            if zone + 1 == zones.len() { whole_words } else { ((zone + 1) * zone_words).min(whole_words) };
        let tables = load_tables(tables);
        while word_index < end {
            let at = word_index * WORD_PX;
            if at.is_multiple_of(CACHE_LINE) {
                for y in 0..2 {
                    prefetch(rows[y], at + ahead);
                    prefetch(background[y], at + ahead);
                }
            }
            // SAFETY: at + 32 ≤ whole_words × 32 ≤ width, which is the length of all four rows.
            words[word_index] = unsafe { marks(rows, background, at, &tables) };
            word_index += 1;
        }
    }
    plain::foreground(rows, background, zones, zone_px, words, whole_words);
}

/// # Safety
/// The processor has NEON; all rows have one length, and `words` a word for every 32 pixels of it.
#[target_feature(enable = "neon")]
pub unsafe fn foreground_among(
    rows: [&[u8]; 2],
    background: [&[u8]; 2],
    zones: &[LevelTables],
    zone_px: usize,
    words: &mut [u16],
) {
    let whole_words = rows[0].len() / WORD_PX;
    for (word_index, word) in words.iter_mut().enumerate().take(whole_words) {
        if *word == 0 {
            continue;
        }
        let at = word_index * WORD_PX;
        let tables = load_tables(&zones[(at / zone_px).min(zones.len() - 1)]);
        // SAFETY: at + 32 ≤ whole_words × 32 ≤ width, which is the length of all four rows.
        *word = unsafe { marks(rows, background, at, &tables) };
    }
    plain::foreground_among(rows, background, zones, zone_px, words, whole_words);
}

/// # Safety
/// The processor has NEON; both rows have one length, and `words` a word for every 32 pixels of it.
#[target_feature(enable = "neon")]
pub unsafe fn colour(rows: [&[u8]; 2], gate: &ColourGate, words: &mut [u16]) {
    let whole_words = rows[0].len() / WORD_PX;
    let low = vdupq_n_u16(0xff);
    for (word_index, word) in words.iter_mut().enumerate().take(whole_words) {
        if *word == 0 {
            continue;
        }
        let mut passes = [vdupq_n_u16(0xffff); 2];
        for (half, pass) in passes.iter_mut().enumerate() {
            let at = word_index * WORD_PX + half * REGISTER_PX;
            // SAFETY: at + 16 ≤ whole_words × 32 ≤ the length of both rows.
            let (top, bottom) = unsafe { (load(rows[0], at), load(rows[1], at)) };
            let (top, bottom) = (vreinterpretq_u16_u8(top), vreinterpretq_u16_u8(bottom));
            let places = [
                vandq_u16(top, low),
                vshrq_n_u16::<8>(top),
                vandq_u16(bottom, low),
                vshrq_n_u16::<8>(bottom),
            ];
            for (weights, bound) in gate.weights.iter().zip(&gate.bounds) {
                let mut sum = vdupq_n_s16(0);
                for (place, weight) in places.iter().zip(weights) {
                    sum = vmlaq_s16(sum, vreinterpretq_s16_u16(*place), vdupq_n_s16(*weight));
                }
                *pass = vandq_u16(*pass, vcgtq_s16(sum, vdupq_n_s16(*bound)));
            }
        }
        *word &= lanes_to_bits(passes);
    }
    plain::colour(rows, gate, words, whole_words);
}

/// # Safety
/// The processor has NEON; all slices have one length.
#[target_feature(enable = "neon")]
pub unsafe fn learn(row: &[u8], background: BackgroundRow<'_>, tables: &LevelTables, patience: u8) {
    let BackgroundRow { level, other, evidence } = background;
    let whole = row.len() / REGISTER_PX * REGISTER_PX;
    let t = load_tables(tables);
    let one = vdupq_n_u8(1);
    let former_start = vdupq_n_u8(128);
    let patience_lanes = vdupq_n_u8(patience);
    let former_end = vaddq_u8(former_start, patience_lanes);
    for at in (0..whole).step_by(REGISTER_PX) {
        // SAFETY: at + 16 ≤ whole ≤ the length of all four slices.
        let (seen, l, o, e) =
            unsafe { (load(row, at), load(level, at), load(other, at), load(evidence, at)) };
        let index = index_of(l);
        let expected = expected(l, index, &t);
        let threshold = vqtbl1q_u8(t.threshold, index);
        let tolerance = vqaddq_u8(threshold, threshold);
        let is_background = vcleq_u8(vabdq_u8(seen, expected), tolerance);
        let is_other = vbicq_u8(vcleq_u8(vabdq_u8(seen, o), tolerance), is_background);
        let former = vcgeq_u8(e, former_start);

        let above = vandq_u8(vcgtq_u8(seen, expected), one);
        let below = vandq_u8(vcltq_u8(seen, expected), one);
        let followed = vqsubq_u8(vqaddq_u8(l, above), below);
        let forgotten = vbslq_u8(former, e, vqsubq_u8(e, one));

        let one_more = vqaddq_u8(e, one);
        let enough = vorrq_u8(former, vcgeq_u8(one_more, patience_lanes));
        let swap = vandq_u8(is_other, enough);

        let waits = vandq_u8(former, vcltq_u8(e, former_end));
        let starts = vbicq_u8(vorrq_u8(former, vceqzq_u8(e)), waits);
        let of_neither = vbslq_u8(waits, one_more, vbslq_u8(starts, one, vsubq_u8(e, one)));

        let new_level = vbslq_u8(swap, o, vbslq_u8(is_background, followed, l));
        let restart = vbicq_u8(starts, vorrq_u8(is_background, is_other));
        let new_other = vbslq_u8(swap, l, vbslq_u8(restart, seen, o));
        let of_other = vbslq_u8(enough, former_start, one_more);
        let new_evidence = vbslq_u8(is_other, of_other, vbslq_u8(is_background, forgotten, of_neither));
        // SAFETY: as for the loads.
        unsafe {
            store(level, at, new_level);
            store(other, at, new_other);
            store(evidence, at, new_evidence);
        }
    }
    let rest = BackgroundRow {
        level: &mut level[whole..],
        other: &mut other[whole..],
        evidence: &mut evidence[whole..],
    };
    plain::learn(&row[whole..], rest, tables, patience);
}

/// # Safety
/// The processor has NEON; both slices have one length.
#[target_feature(enable = "neon")]
pub unsafe fn probe(row: &[u8], level: &[u8], tables: &LevelTables) -> Probe {
    let whole = row.len() / REGISTER_PX * REGISTER_PX;
    let t = load_tables(tables);
    let mut sums = [vdupq_n_u32(0); 3];
    for at in (0..whole).step_by(REGISTER_PX) {
        // SAFETY: at + 16 ≤ whole ≤ the length of both slices.
        let (seen, l) = unsafe { (load(row, at), load(level, at)) };
        let deviation = vabdq_u8(seen, expected(l, index_of(l), &t));
        for (sum, values) in sums.iter_mut().zip([seen, l, deviation]) {
            *sum = vpadalq_u16(*sum, vpaddlq_u8(values));
        }
    }
    let [seen, level_sum, deviation] = sums.map(|s| vaddvq_u32(s));
    let rest = plain::probe(&row[whole..], &level[whole..], tables);
    Probe { seen: seen + rest.seen, level: level_sum + rest.level, deviation: deviation + rest.deviation }
}

/// # Safety
/// The processor has NEON.
#[target_feature(enable = "neon")]
pub unsafe fn sum(bytes: &[u8]) -> u64 {
    const AT_ONCE: usize = 4 * REGISTER_PX;
    let whole = bytes.len() / AT_ONCE * AT_ONCE;
    let mut sums = [vdupq_n_u64(0); 4];
    for at in (0..whole).step_by(AT_ONCE) {
        for (i, sum) in sums.iter_mut().enumerate() {
            // SAFETY: at + 4 × 16 ≤ whole ≤ the length.
            let part = unsafe { load(bytes, at + i * REGISTER_PX) };
            *sum = vpadalq_u32(*sum, vpaddlq_u16(vpaddlq_u8(part)));
        }
    }
    sums.map(|s| vaddvq_u64(s)).iter().sum::<u64>() + plain::sum(&bytes[whole..])
}
