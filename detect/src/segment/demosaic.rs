//! Interpolates the colours that a mosaic leaves out, for the comparison of raw and interpolated input.

use netcord_common::{FrameView, PixelFormat};

use super::options::InputMode;

/// A frame in which every pixel has become a cell of its own: red, green, green, blue, as a mosaic of twice
/// the size, so that the same search runs on it.
#[derive(Debug)]
pub struct Demosaic {
    input: InputMode,
    size: (usize, usize),
    cells: Vec<u8>,
    /// Green at every pixel.
    green: Vec<u8>,
}

impl Demosaic {
    /// For frames of a size.
    pub fn new(input: InputMode, size: (usize, usize)) -> Self {
        let pixels = size.0 * size.1;
        Self { input, size, cells: vec![0; 4 * pixels], green: vec![0; pixels] }
    }

    /// Interpolates a frame.
    pub fn run(&mut self, view: &FrameView<'_>) -> FrameView<'_> {
        let (width, height) = self.size;
        self.fill_green(view);
        let (rx, ry) = view.format().red_at().unwrap_or((0, 0));
        for y in 0..height {
            for x in 0..width {
                let green = self.green[y * width + x];
                let red = self.chroma(view, x, y, (rx, ry));
                let blue = self.chroma(view, x, y, (1 - rx, 1 - ry));
                let at = 4 * y * width + 2 * x;
                self.cells[at] = red;
                self.cells[at + 1] = green;
                self.cells[at + 2 * width] = green;
                self.cells[at + 2 * width + 1] = blue;
            }
        }
        FrameView::new(&self.cells, (2 * width, 2 * height), 2 * width, PixelFormat::BayerRG8)
            .expect("the buffer was made for this size")
    }

    fn fill_green(&mut self, view: &FrameView<'_>) {
        let (width, height) = self.size;
        let (rx, ry) = view.format().red_at().unwrap_or((0, 0));
        for y in 0..height {
            let above = view.row(mirrored(y, -1, height));
            let here = view.row(y);
            let below = view.row(mirrored(y, 1, height));
            for x in 0..width {
                let is_green = ((x ^ rx) ^ (y ^ ry)) & 1 == 1;
                self.green[y * width + x] = if is_green {
                    here[x]
                } else {
                    let (left, right) =
                        (u16::from(here[mirrored(x, -1, width)]), u16::from(here[mirrored(x, 1, width)]));
                    let (up, down) = (u16::from(above[x]), u16::from(below[x]));
                    let (across, along) = (left.abs_diff(right), up.abs_diff(down));
                    let mean = match self.input {
                        // Along the edge, if there is one (Laroche & Prescott 1994).
                        InputMode::EdgeAware if across > along => (up + down).div_ceil(2),
                        InputMode::EdgeAware if along > across => (left + right).div_ceil(2),
                        _ => (left + right + up + down + 2) / 4,
                    };
                    mean as u8
                };
            }
        }
    }

    /// Red or blue, whose own pixels lie at `(sx, sy)` in the cell.
    fn chroma(&self, view: &FrameView<'_>, x: usize, y: usize, (sx, sy): (usize, usize)) -> u8 {
        let (width, height) = self.size;
        let (off_x, off_y) = ((x ^ sx) & 1, (y ^ sy) & 1);
        let edge_aware = self.input == InputMode::EdgeAware;
        let (mut sum, mut n) = (0_i32, 0_i32);
        for dy in if off_y == 1 { &[-1, 1][..] } else { &[0][..] } {
            for dx in if off_x == 1 { &[-1, 1][..] } else { &[0][..] } {
                let (u, v) = (mirrored(x, *dx, width), mirrored(y, *dy, height));
                sum += i32::from(view.row(v)[u]);
                if edge_aware {
                    // Differences to green are smooth where the colours themselves have an edge.
                    sum -= i32::from(self.green[v * width + u]);
                }
                n += 1;
            }
        }
        let mean = (sum + n.signum() * n / 2).div_euclid(n);
        let mean = if edge_aware { mean + i32::from(self.green[y * width + x]) } else { mean };
        mean.clamp(0, 255) as u8
    }
}

/// The neighbour, mirrored at the border so that it keeps its colour.
fn mirrored(at: usize, step: isize, size: usize) -> usize {
    match at.checked_add_signed(step) {
        Some(next) if next < size => next,
        _ => at.saturating_add_signed(-step).min(size - 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey ramp must come out as the ramp, in every mosaic and both ways; one bright line must stay one in
    /// the edge-aware way.
    #[test]
    fn a_ramp_stays_a_ramp() {
        let (width, height) = (24, 16);
        for format in PixelFormat::ALL.into_iter().filter(|f| f.red_at().is_some()) {
            for input in [InputMode::Bilinear, InputMode::EdgeAware] {
                let ramp = |x: usize, y: usize| (40 + 4 * x + 2 * y) as u8;
                let bytes = (0..width * height).map(|i| ramp(i % width, i / width)).collect::<Vec<_>>();
                let view = FrameView::new(&bytes, (width, height), width, format).expect("fits");
                let mut demosaic = Demosaic::new(input, (width, height));
                let cells = demosaic.run(&view);
                for y in 2..height - 2 {
                    for x in 2..width - 2 {
                        let found = [
                            cells.row(2 * y)[2 * x],
                            cells.row(2 * y)[2 * x + 1],
                            cells.row(2 * y + 1)[2 * x + 1],
                        ];
                        for level in found {
                            assert!(level.abs_diff(ramp(x, y)) <= 1, "{format} {input:?}: {found:?}");
                        }
                    }
                }
            }
        }
    }
}
