use netcord_common::FrameView;

/// A grey picture of 8 bits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Luma {
    width: usize,
    height: usize,
    data: Vec<u8>,
}

impl Luma {
    /// A picture of `width` × `height` with these pixels, row by row; `None` when they do not fit.
    pub fn new(width: usize, height: usize, data: Vec<u8>) -> Option<Self> {
        (width > 0 && height > 0 && data.len() == width * height).then_some(Self { width, height, data })
    }

    /// The luma of a raw frame. From a mosaic: (R + 2 G + B) / 4 at every pixel, by the kernel
    /// (1 2 1)ᵀ(1 2 1) / 16, which sees each colour with the same weight wherever it stands, so that no
    /// pattern of the mosaic is left and nothing moves.
    pub fn of_frame(frame: &FrameView) -> Self {
        let (width, height) = (frame.width(), frame.height());
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend_from_slice(frame.row(y));
        }
        let raw = Self { width, height, data };
        if frame.format().red_at().is_none() { raw } else { raw.binomial() }
    }

    /// Columns.
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub const fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row.
    pub fn pixels(&self) -> &[u8] {
        &self.data
    }

    /// Row `y`.
    pub fn row(&self, y: usize) -> &[u8] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// Pixel (x, y).
    pub fn at(&self, x: usize, y: usize) -> u8 {
        self.data[y * self.width + x]
    }

    /// Black and white swapped.
    #[must_use]
    pub fn inverted(&self) -> Self {
        Self { data: self.data.iter().map(|v| 255 - v).collect(), ..*self }
    }

    /// Smoothed by (1 2 1)ᵀ(1 2 1) / 16; the frame is mirrored at its edges (without repeating the edge,
    /// which keeps the phase of a mosaic).
    #[must_use]
    pub fn binomial(&self) -> Self {
        let (w, h) = (self.width, self.height);
        let mirror = |i: isize, n: usize| -> usize {
            if n == 1 {
                0
            } else {
                (if i < 0 {
                    -i
                } else if i >= n as isize {
                    2 * (n as isize - 1) - i
                } else {
                    i
                }) as usize
            }
        };
        let mut data = vec![0; w * h];
        let mut sums = vec![0u16; w];
        for y in 0..h {
            let rows = [-1, 0, 1].map(|d| self.row(mirror(y as isize + d, h)));
            for x in 0..w {
                sums[x] = u16::from(rows[0][x]) + 2 * u16::from(rows[1][x]) + u16::from(rows[2][x]);
            }
            let out = &mut data[y * w..(y + 1) * w];
            for x in [0, w - 1] {
                let (l, r) = (sums[mirror(x as isize - 1, w)], sums[mirror(x as isize + 1, w)]);
                out[x] = ((l + 2 * sums[x] + r + 8) >> 4) as u8;
            }
            for (o, s) in out[1..].iter_mut().zip(sums.windows(3)) {
                *o = ((s[0] + 2 * s[1] + s[2] + 8) >> 4) as u8;
            }
        }
        Self { width: w, height: h, data }
    }

    /// Half the size, each pixel the mean of 2 × 2; pixel (x, y) of it lies at (2x + ½, 2y + ½) here.
    /// `None` for a picture too small to halve.
    #[must_use]
    pub fn halved(&self) -> Option<Self> {
        let (w, h) = (self.width / 2, self.height / 2);
        if w < 16 || h < 16 {
            return None;
        }
        let mut data = Vec::with_capacity(w * h);
        for y in 0..h {
            let (top, bottom) = (self.row(2 * y), self.row(2 * y + 1));
            data.extend(top.chunks_exact(2).zip(bottom.chunks_exact(2)).map(|(t, b)| {
                ((u16::from(t[0]) + u16::from(t[1]) + u16::from(b[0]) + u16::from(b[1]) + 2) >> 2) as u8
            }));
        }
        Some(Self { width: w, height: h, data })
    }

    /// The value between pixels, linearly; `None` outside the picture.
    pub fn sample(&self, x: f64, y: f64) -> Option<f64> {
        if !(x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f64 && y < (self.height - 1) as f64) {
            return None;
        }
        let (ix, iy) = (x as usize, y as usize);
        let (fx, fy) = (x - ix as f64, y - iy as f64);
        let at = iy * self.width + ix;
        let [a, b, c, d] =
            [at, at + 1, at + self.width, at + self.width + 1].map(|i| f64::from(self.data[i]));
        Some((a + (b - a) * fx) * (1.0 - fy) + (c + (d - c) * fx) * fy)
    }

    /// Standard deviation of the noise, in grey levels, from the picture's second differences (Immerkær
    /// 1996), whose median is not moved by edges.
    pub fn noise(&self) -> f64 {
        let mut histogram = [0u32; 1024];
        let mut count = 0u32;
        // Every fourth row is enough for a median.
        for y in (1..self.height.saturating_sub(1)).step_by(4) {
            let rows = [self.row(y - 1), self.row(y), self.row(y + 1)];
            for x in 1..self.width - 1 {
                let v = |r: usize, c: usize| i32::from(rows[r][c]);
                let l = v(0, x - 1) - 2 * v(0, x) + v(0, x + 1)
                    - 2 * (v(1, x - 1) - 2 * v(1, x) + v(1, x + 1))
                    + v(2, x - 1)
                    - 2 * v(2, x)
                    + v(2, x + 1);
                histogram[l.unsigned_abs().min(1023) as usize] += 1;
                count += 1;
            }
        }
        let mut below = 0;
        let median = histogram
            .iter()
            .position(|n| {
                below += n;
                below * 2 >= count
            })
            .unwrap_or(0);
        // The mask has norm 6; the median of |N(0, σ)| is 0.6745 σ.
        median as f64 / (6.0 * 0.6745)
    }
}

#[cfg(test)]
mod tests {
    use netcord_common::PixelFormat;

    use super::*;

    #[test]
    fn a_coloured_but_even_scene_has_an_even_luma_in_every_mosaic() {
        for format in PixelFormat::ALL {
            let (w, h) = (12, 8);
            let bytes: Vec<u8> = (0..w * h)
                .map(|i| match format.channel_at(i % w, i / w) {
                    netcord_common::Channel::Red => 200,
                    netcord_common::Channel::Green => 100,
                    netcord_common::Channel::Blue => 40,
                    netcord_common::Channel::Luma => 110,
                })
                .collect();
            let view = FrameView::new(&bytes, (w, h), w, format).expect("fits");
            let luma = Luma::of_frame(&view);
            assert!(luma.pixels().iter().all(|v| *v == 110), "{format}");
        }
    }

    #[test]
    fn noise_is_measured() {
        // A linear congruential generator's high bits, uniform over 16 levels: σ = 4.6.
        let mut state = 1u32;
        let data = (0..200 * 200)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                100 + (state >> 28) as u8
            })
            .collect();
        let noise = Luma::new(200, 200, data).expect("fits").noise();
        assert!((noise - 4.6).abs() < 0.5, "{noise}");
    }
}
