/// The sum of all bytes: what reading a frame once costs at least, with the widest vectors that the
/// segmenter's kernels use (32 bytes where the processor has AVX2, 16 elsewhere).
pub fn sum_bytes(bytes: &[u8]) -> u64 {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2, as has just been asked.
        return unsafe { sum_avx2(bytes) };
    }
    sum_plain(bytes)
}

fn sum_plain(bytes: &[u8]) -> u64 {
    // 16-bit lanes hold 257 bytes; chunks of 16 × 256 never overflow them.
    let mut sum = 0;
    for chunk in bytes.chunks(16 * 256) {
        let mut lanes = [0_u16; 16];
        let vectors = chunk.chunks_exact(16);
        sum += vectors.remainder().iter().map(|b| u64::from(*b)).sum::<u64>();
        for vector in vectors {
            for (lane, byte) in lanes.iter_mut().zip(vector) {
                *lane += u16::from(*byte);
            }
        }
        sum += lanes.iter().map(|l| u64::from(*l)).sum::<u64>();
    }
    sum
}

/// # Safety
/// The processor must have AVX2.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn sum_avx2(bytes: &[u8]) -> u64 {
    use std::arch::x86_64::{
        __m256i, _mm256_add_epi64, _mm256_loadu_si256, _mm256_sad_epu8, _mm256_setzero_si256,
        _mm256_storeu_si256,
    };
    let zero = _mm256_setzero_si256();
    // Four independent sums hide the latency of the additions.
    let mut sums = [zero; 4];
    let blocks = bytes.chunks_exact(128);
    let mut sum: u64 = blocks.remainder().iter().map(|b| u64::from(*b)).sum();
    for block in blocks {
        for (i, part) in sums.iter_mut().enumerate() {
            // SAFETY: the block has 128 bytes, i is at most 3, and the load needs no alignment.
            let vector = unsafe { _mm256_loadu_si256(block.as_ptr().add(32 * i).cast::<__m256i>()) };
            *part = _mm256_add_epi64(*part, _mm256_sad_epu8(vector, zero));
        }
    }
    for part in sums {
        let mut lanes = [0_u64; 4];
        // SAFETY: the four lanes are 32 bytes, and the store needs no alignment.
        unsafe { _mm256_storeu_si256(lanes.as_mut_ptr().cast::<__m256i>(), part) };
        sum += lanes.iter().sum::<u64>();
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_versions_agree_with_plain_addition() {
        let bytes: Vec<u8> = (0..10_007_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        for length in [0, 1, 31, 128, 129, 4096, 10_007] {
            let expected: u64 = bytes[..length].iter().map(|b| u64::from(*b)).sum();
            assert_eq!(sum_bytes(&bytes[..length]), expected);
            assert_eq!(sum_plain(&bytes[..length]), expected);
        }
        assert_eq!(sum_bytes(&[255; 100_000]), 25_500_000);
    }
}
