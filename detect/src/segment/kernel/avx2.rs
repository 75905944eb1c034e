//! The kernels with AVX2: 32 pixels at a time. All loads and stores are unaligned.

use core::arch::x86_64::{
    __m128i, __m256i, _MM_HINT_T0, _mm_load_si128, _mm_prefetch, _mm256_add_epi16, _mm256_add_epi64,
    _mm256_adds_epu8, _mm256_and_si256, _mm256_andnot_si256, _mm256_blendv_epi8, _mm256_broadcastsi128_si256,
    _mm256_cmpeq_epi8, _mm256_cmpgt_epi16, _mm256_extract_epi64, _mm256_loadu_si256, _mm256_maddubs_epi16,
    _mm256_max_epu8, _mm256_min_epu8, _mm256_movemask_epi8, _mm256_mullo_epi16, _mm256_or_si256,
    _mm256_packs_epi16, _mm256_sad_epu8, _mm256_set1_epi8, _mm256_set1_epi16, _mm256_setzero_si256,
    _mm256_shuffle_epi8, _mm256_srli_epi16, _mm256_storeu_si256, _mm256_sub_epi8, _mm256_subs_epu8,
};

use super::{BackgroundRow, ColourGate, LevelTables, Probe, WORD_PX, plain};

/// The tables of one zone, in both halves of registers.
#[derive(Clone, Copy)]
struct Tables {
    brighter: __m256i,
    dimmer: __m256i,
    threshold: __m256i,
}

#[target_feature(enable = "avx2")]
fn load_tables(tables: &LevelTables) -> Tables {
    let twice = |table: &[u8; 16]| {
        // SAFETY: the array is 16 bytes, and LevelTables is aligned to 16 with 16-byte fields.
        _mm256_broadcastsi128_si256(unsafe { _mm_load_si128(table.as_ptr().cast::<__m128i>()) })
    };
    Tables {
        brighter: twice(&tables.brighter),
        dimmer: twice(&tables.dimmer),
        threshold: twice(&tables.threshold),
    }
}

/// # Safety
/// `slice` has 32 bytes from `at` on.
#[target_feature(enable = "avx2")]
unsafe fn load(slice: &[u8], at: usize) -> __m256i {
    debug_assert!(at + WORD_PX <= slice.len());
    // SAFETY: by this function's own contract.
    unsafe { _mm256_loadu_si256(slice.as_ptr().add(at).cast::<__m256i>()) }
}

/// # Safety
/// `slice` has 32 bytes from `at` on.
#[target_feature(enable = "avx2")]
unsafe fn store(slice: &mut [u8], at: usize, value: __m256i) {
    debug_assert!(at + WORD_PX <= slice.len());
    // SAFETY: by this function's own contract.
    unsafe { _mm256_storeu_si256(slice.as_mut_ptr().add(at).cast::<__m256i>(), value) }
}

/// Asks for the cache line `at` bytes from the slice's beginning, which may lie beyond its end.
#[target_feature(enable = "avx2")]
fn prefetch(slice: &[u8], at: usize) {
    // A hint that reads nothing and cannot fault, whatever the address.
    _mm_prefetch::<_MM_HINT_T0>(slice.as_ptr().wrapping_add(at).cast::<i8>());
}

/// # Safety
/// The processor has AVX2.
#[target_feature(enable = "avx2")]
pub unsafe fn prefetch_all(bytes: &[u8]) {
    for at in (0..bytes.len()).step_by(64) {
        prefetch(bytes, at);
    }
    prefetch(bytes, bytes.len().saturating_sub(1));
}

#[target_feature(enable = "avx2")]
fn index_of(level: __m256i) -> __m256i {
    _mm256_and_si256(_mm256_srli_epi16::<4>(level), _mm256_set1_epi8(0x0f))
}

#[target_feature(enable = "avx2")]
fn expected(level: __m256i, index: __m256i, tables: &Tables) -> __m256i {
    let brighter = _mm256_adds_epu8(level, _mm256_shuffle_epi8(tables.brighter, index));
    _mm256_subs_epu8(brighter, _mm256_shuffle_epi8(tables.dimmer, index))
}

#[target_feature(enable = "avx2")]
fn abs_diff(a: __m256i, b: __m256i) -> __m256i {
    _mm256_or_si256(_mm256_subs_epu8(a, b), _mm256_subs_epu8(b, a))
}

/// 16 lanes of all ones or zeros as 16 bits.
#[target_feature(enable = "avx2")]
fn lanes_to_bits(lanes: __m256i) -> u16 {
    // packs works within 128-bit halves: the low half's eight lanes land in bytes 0..8, the high half's in
    // bytes 16..24.
    let packed = _mm256_movemask_epi8(_mm256_packs_epi16(lanes, _mm256_setzero_si256())).cast_unsigned();
    ((packed & 0xff) | ((packed >> 8) & 0xff00)) as u16
}

/// The marks of 16 cells of a pair of rows.
///
/// # Safety
/// All rows have 32 bytes from `at` on.
#[target_feature(enable = "avx2")]
unsafe fn marks(rows: [&[u8]; 2], background: [&[u8]; 2], at: usize, tables: &Tables) -> u16 {
    let ones = _mm256_set1_epi8(1);
    let mut difference = _mm256_setzero_si256();
    let mut threshold = _mm256_setzero_si256();
    for y in 0..2 {
        // SAFETY: by this function's own contract.
        let (seen, level) = unsafe { (load(rows[y], at), load(background[y], at)) };
        let index = index_of(level);
        let d = abs_diff(seen, expected(level, index, tables));
        let t = _mm256_shuffle_epi8(tables.threshold, index);
        difference = _mm256_add_epi16(difference, _mm256_maddubs_epi16(d, ones));
        threshold = _mm256_add_epi16(threshold, _mm256_maddubs_epi16(t, ones));
    }
    lanes_to_bits(_mm256_cmpgt_epi16(difference, threshold))
}

/// # Safety
/// The processor has AVX2; all rows have one length, and `words` a word for every 32 pixels of it.
#[target_feature(enable = "avx2")]
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
            if word_index.is_multiple_of(2) {
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
/// The processor has AVX2; all rows have one length, and `words` a word for every 32 pixels of it.
#[target_feature(enable = "avx2")]
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
/// The processor has AVX2; both rows have one length, and `words` a word for every 32 pixels of it.
#[target_feature(enable = "avx2")]
pub unsafe fn colour(rows: [&[u8]; 2], gate: &ColourGate, words: &mut [u16]) {
    let whole_words = rows[0].len() / WORD_PX;
    let low = _mm256_set1_epi16(0xff);
    for (word_index, word) in words.iter_mut().enumerate().take(whole_words) {
        if *word == 0 {
            continue;
        }
        let at = word_index * WORD_PX;
        // SAFETY: at + 32 ≤ whole_words × 32 ≤ the length of both rows.
        let (top, bottom) = unsafe { (load(rows[0], at), load(rows[1], at)) };
        let places = [
            _mm256_and_si256(top, low),
            _mm256_srli_epi16::<8>(top),
            _mm256_and_si256(bottom, low),
            _mm256_srli_epi16::<8>(bottom),
        ];
        let mut pass = _mm256_set1_epi16(-1);
        for (weights, bound) in gate.weights.iter().zip(&gate.bounds) {
            let mut sum = _mm256_setzero_si256();
            for (place, weight) in places.iter().zip(weights) {
                sum = _mm256_add_epi16(sum, _mm256_mullo_epi16(*place, _mm256_set1_epi16(*weight)));
            }
            pass = _mm256_and_si256(pass, _mm256_cmpgt_epi16(sum, _mm256_set1_epi16(*bound)));
        }
        *word &= lanes_to_bits(pass);
    }
    plain::colour(rows, gate, words, whole_words);
}

/// # Safety
/// The processor has AVX2; all slices have one length.
#[target_feature(enable = "avx2")]
pub unsafe fn learn(row: &[u8], background: BackgroundRow<'_>, tables: &LevelTables, patience: u8) {
    let BackgroundRow { level, other, evidence } = background;
    let whole = row.len() / WORD_PX * WORD_PX;
    let t = load_tables(tables);
    let one = _mm256_set1_epi8(1);
    let zero = _mm256_setzero_si256();
    let former_start = _mm256_set1_epi8(128_u8.cast_signed());
    let patience_lanes = _mm256_set1_epi8(patience.cast_signed());
    let former_end = _mm256_adds_epu8(former_start, patience_lanes);
    for at in (0..whole).step_by(WORD_PX) {
        // SAFETY: at + 32 ≤ whole ≤ the length of all four slices.
        let (seen, l, o, e) =
            unsafe { (load(row, at), load(level, at), load(other, at), load(evidence, at)) };
        let index = index_of(l);
        let expected = expected(l, index, &t);
        let threshold = _mm256_shuffle_epi8(t.threshold, index);
        let tolerance = _mm256_adds_epu8(threshold, threshold);
        // a ≤ b is min(a, b) = a, and a ≥ b is max(a, b) = a: AVX2 compares no unsigned bytes.
        let within = |d: __m256i| _mm256_cmpeq_epi8(_mm256_min_epu8(d, tolerance), d);
        let is_background = within(abs_diff(seen, expected));
        let is_other = _mm256_andnot_si256(is_background, within(abs_diff(seen, o)));
        let neither = _mm256_andnot_si256(_mm256_or_si256(is_background, is_other), _mm256_set1_epi8(-1));
        let former = _mm256_cmpeq_epi8(_mm256_max_epu8(e, former_start), e);

        let above = _mm256_andnot_si256(_mm256_cmpeq_epi8(_mm256_min_epu8(seen, expected), seen), one);
        let below = _mm256_andnot_si256(_mm256_cmpeq_epi8(_mm256_max_epu8(seen, expected), seen), one);
        let followed = _mm256_subs_epu8(_mm256_adds_epu8(l, above), below);
        let forgotten = _mm256_blendv_epi8(_mm256_subs_epu8(e, one), e, former);

        let one_more = _mm256_adds_epu8(e, one);
        let enough =
            _mm256_or_si256(former, _mm256_cmpeq_epi8(_mm256_max_epu8(one_more, patience_lanes), one_more));
        let swap = _mm256_and_si256(is_other, enough);

        let waits = _mm256_andnot_si256(_mm256_cmpeq_epi8(_mm256_max_epu8(e, former_end), e), former);
        let starts = _mm256_andnot_si256(waits, _mm256_or_si256(former, _mm256_cmpeq_epi8(e, zero)));
        let of_neither =
            _mm256_blendv_epi8(_mm256_blendv_epi8(_mm256_sub_epi8(e, one), one, starts), one_more, waits);

        let new_level = _mm256_blendv_epi8(_mm256_blendv_epi8(l, followed, is_background), o, swap);
        let restart = _mm256_and_si256(neither, starts);
        let new_other = _mm256_blendv_epi8(_mm256_blendv_epi8(o, seen, restart), l, swap);
        let of_other = _mm256_blendv_epi8(one_more, former_start, enough);
        let new_evidence =
            _mm256_blendv_epi8(_mm256_blendv_epi8(of_neither, forgotten, is_background), of_other, is_other);
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
/// The processor has AVX2; both slices have one length.
#[target_feature(enable = "avx2")]
pub unsafe fn probe(row: &[u8], level: &[u8], tables: &LevelTables) -> Probe {
    let whole = row.len() / WORD_PX * WORD_PX;
    let t = load_tables(tables);
    let zero = _mm256_setzero_si256();
    let mut sums = [zero; 3];
    for at in (0..whole).step_by(WORD_PX) {
        // SAFETY: at + 32 ≤ whole ≤ the length of both slices.
        let (seen, l) = unsafe { (load(row, at), load(level, at)) };
        let deviation = abs_diff(seen, expected(l, index_of(l), &t));
        for (sum, values) in sums.iter_mut().zip([seen, l, deviation]) {
            *sum = _mm256_add_epi64(*sum, _mm256_sad_epu8(values, zero));
        }
    }
    let [seen, level_sum, deviation] = sums.map(|s| total(s) as u32);
    let rest = plain::probe(&row[whole..], &level[whole..], tables);
    Probe { seen: seen + rest.seen, level: level_sum + rest.level, deviation: deviation + rest.deviation }
}

/// The sum of four 64-bit lanes.
#[target_feature(enable = "avx2")]
fn total(lanes: __m256i) -> u64 {
    let lanes = [
        _mm256_extract_epi64::<0>(lanes),
        _mm256_extract_epi64::<1>(lanes),
        _mm256_extract_epi64::<2>(lanes),
        _mm256_extract_epi64::<3>(lanes),
    ];
    lanes.iter().map(|l| l.cast_unsigned()).sum()
}

/// # Safety
/// The processor has AVX2.
#[target_feature(enable = "avx2")]
pub unsafe fn sum(bytes: &[u8]) -> u64 {
    const AT_ONCE: usize = 4 * WORD_PX;
    let whole = bytes.len() / AT_ONCE * AT_ONCE;
    let zero = _mm256_setzero_si256();
    let mut sums = [zero; 4];
    for at in (0..whole).step_by(AT_ONCE) {
        for (i, sum) in sums.iter_mut().enumerate() {
            // SAFETY: at + 4 × 32 ≤ whole ≤ the length.
            let part = unsafe { load(bytes, at + i * WORD_PX) };
            *sum = _mm256_add_epi64(*sum, _mm256_sad_epu8(part, zero));
        }
    }
    let all = _mm256_add_epi64(_mm256_add_epi64(sums[0], sums[1]), _mm256_add_epi64(sums[2], sums[3]));
    total(all) + plain::sum(&bytes[whole..])
}
