//! The kernels with NEON: 32 pixels (two registers) at a time.

use core::arch::aarch64::{
    uint8x16_t, uint16x8_t, vabdq_u8, vaddlvq_u8, vaddq_u16, vaddvq_u16, vandq_u16, vcgtq_s16, vcgtq_u16,
    vdupq_n_s16, vdupq_n_u16, vld1q_u8, vld1q_u16, vmlaq_s16, vpaddlq_u8, vqaddq_u8, vqsubq_u8, vqtbl1q_u8,
    vreinterpretq_s16_u16, vreinterpretq_u16_u8, vshrq_n_u8, vshrq_n_u16,
};

use super::{ColourGate, LevelTables, WORD_PX, plain};

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
    debug_assert!(at + 16 <= slice.len());
    // SAFETY: by this function's own contract.
    unsafe { vld1q_u8(slice.as_ptr().add(at)) }
}

/// Eight lanes of all ones or zeros as 8 bits.
#[target_feature(enable = "neon")]
fn lanes_to_bits(lanes: uint16x8_t) -> u16 {
    const BITS: [u16; 8] = [1, 2, 4, 8, 16, 32, 64, 128];
    // SAFETY: the array has 8 entries.
    let bits = unsafe { vld1q_u16(BITS.as_ptr()) };
    vaddvq_u16(vandq_u16(lanes, bits))
}

/// # Safety
/// The processor has NEON; all rows have one length, and `words` a word for every 32 pixels of it.
#[target_feature(enable = "neon")]
pub unsafe fn foreground(
    rows: [&[u8]; 2],
    background: [&[u8]; 2],
    zones: &[LevelTables],
    zone_px: usize,
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
            let mut bits = 0;
            for half in 0..2 {
                let at = word_index * WORD_PX + half * 16;
                let mut difference = vdupq_n_u16(0);
                let mut threshold = vdupq_n_u16(0);
                for y in 0..2 {
                    // SAFETY: at + 16 ≤ whole_words × 32 ≤ width, which is the length of all four rows.
                    let (seen, level) = unsafe { (load(rows[y], at), load(background[y], at)) };
                    let index = vshrq_n_u8::<4>(level);
                    let brighter = vqaddq_u8(level, vqtbl1q_u8(tables.brighter, index));
                    let expected = vqsubq_u8(brighter, vqtbl1q_u8(tables.dimmer, index));
                    difference = vaddq_u16(difference, vpaddlq_u8(vabdq_u8(seen, expected)));
                    threshold = vaddq_u16(threshold, vpaddlq_u8(vqtbl1q_u8(tables.threshold, index)));
                }
                bits |= lanes_to_bits(vcgtq_u16(difference, threshold)) << (8 * half);
            }
            words[word_index] = bits;
            word_index += 1;
        }
    }
    plain::foreground(rows, background, zones, zone_px, words, whole_words);
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
        let mut bits = 0;
        for half in 0..2 {
            let at = word_index * WORD_PX + half * 16;
            // SAFETY: at + 16 ≤ whole_words × 32 ≤ the length of both rows.
            let (top, bottom) = unsafe { (load(rows[0], at), load(rows[1], at)) };
            let (top, bottom) = (vreinterpretq_u16_u8(top), vreinterpretq_u16_u8(bottom));
            let places = [
                vandq_u16(top, low),
                vshrq_n_u16::<8>(top),
                vandq_u16(bottom, low),
                vshrq_n_u16::<8>(bottom),
            ];
            let mut pass = vdupq_n_u16(0xffff);
            for (weights, bound) in gate.weights.iter().zip(&gate.bounds) {
                let mut sum = vdupq_n_s16(0);
                for (place, weight) in places.iter().zip(weights) {
                    sum = vmlaq_s16(sum, vreinterpretq_s16_u16(*place), vdupq_n_s16(*weight));
                }
                pass = vandq_u16(pass, vcgtq_s16(sum, vdupq_n_s16(*bound)));
            }
            bits |= lanes_to_bits(pass) << (8 * half);
        }
        *word &= bits;
    }
    plain::colour(rows, gate, words, whole_words);
}

/// # Safety
/// The processor has NEON.
#[target_feature(enable = "neon")]
pub unsafe fn sum(bytes: &[u8]) -> u64 {
    let whole = bytes.len() / 16 * 16;
    let mut total = 0;
    for at in (0..whole).step_by(16) {
        // SAFETY: at + 16 ≤ whole ≤ the length.
        total += u64::from(vaddlvq_u8(unsafe { load(bytes, at) }));
    }
    total + plain::sum(&bytes[whole..])
}
