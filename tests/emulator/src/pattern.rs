//! The test picture: every pixel follows from its place and the frame's block id, so that a reader can
//! tell which frame it has and that every byte of it is right.

/// The byte of pixel (`x`, `y`) in frame `block`.
pub const fn pixel(block: u64, x: usize, y: usize) -> u8 {
    ((x + 3 * y) as u8).wrapping_add((7 * (block % 256)) as u8)
}

/// A ramp of which every row of every picture is a part.
fn ramp(width: usize) -> Vec<u8> {
    (0..width + 256).map(|i| (i % 256) as u8).collect()
}

/// Fills a picture of `width` columns.
pub fn fill(block: u64, width: usize, out: &mut [u8]) {
    let ramp = ramp(width);
    for (y, row) in out.chunks_mut(width).enumerate() {
        let start = usize::from(pixel(block, 0, y));
        row.copy_from_slice(&ramp[start..start + row.len()]);
    }
}

/// The place (x, y) of the first wrong pixel of a picture.
pub fn first_wrong(block: u64, width: usize, picture: &[u8]) -> Option<(usize, usize)> {
    let ramp = ramp(width);
    picture.chunks(width).enumerate().find_map(|(y, row)| {
        let start = usize::from(pixel(block, 0, y));
        let right = &ramp[start..start + row.len()];
        if row == right { None } else { row.iter().zip(right).position(|(a, b)| a != b).map(|x| (x, y)) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_the_pixels_one_by_one_and_a_wrong_byte_is_found() {
        let mut picture = vec![0; 300 * 5];
        fill(77, 300, &mut picture);
        for y in 0..5 {
            for x in 0..300 {
                assert_eq!(picture[y * 300 + x], pixel(77, x, y));
            }
        }
        assert_eq!(first_wrong(77, 300, &picture), None);
        assert_eq!(first_wrong(78, 300, &picture), Some((0, 0)));
        picture[2 * 300 + 9] ^= 1;
        assert_eq!(first_wrong(77, 300, &picture), Some((9, 2)));
    }
}
