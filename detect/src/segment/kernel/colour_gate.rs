use netcord_common::{PixelFormat, rig::ColourTest};

/// Linear tests of one gate.
pub const GATE_TESTS: usize = 6;

/// Says whether a cell may have a certain colour: all of up to six tests `r R + g G + b B > bound` must hold,
/// with R and B the cell's red and blue levels and G the sum of its two greens.
///
/// The weights are stored by the cell's four places (top left, top right, bottom left, bottom right), so
/// that one kernel serves all mosaics and grey. Their absolute values sum to at most 128, so that no
/// 16-bit sum overflows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColourGate {
    /// Weights of the four places, one row per test.
    pub(super) weights: [[i16; 4]; GATE_TESTS],
    /// What the weighted sum must exceed.
    pub(super) bounds: [i16; GATE_TESTS],
}

impl ColourGate {
    /// The gate that lets everything through.
    pub const OPEN: Self = Self { weights: [[0; 4]; GATE_TESTS], bounds: [-1; GATE_TESTS] };

    /// A gate for mosaics of `format` from tests `([r, g, b], bound)`, g being the weight of each of the two
    /// green pixels. Weights are scaled as 16 bits need. For grey frames the three weights count as one, so
    /// that tests of hue have no effect there, and tests of brightness keep theirs.
    pub fn new(format: PixelFormat, tests: &[([f32; 3], f32)]) -> Self {
        let mut gate = Self::OPEN;
        for (i, ([r, g, b], bound)) in tests.iter().take(GATE_TESTS).enumerate() {
            let places = match format.red_at() {
                None => [0.25 * (r + 2.0 * g + b); 4],
                Some((x, y)) => {
                    let mut places = [*g; 4];
                    places[2 * y + x] = *r;
                    places[2 * (1 - y) + (1 - x)] = *b;
                    places
                }
            };
            let total = places.iter().map(|w| w.abs()).sum::<f32>();
            if format.red_at().is_none() && total < 0.05 * (r.abs() + 2.0 * g.abs() + b.abs()) {
                continue;
            }
            let scale = (124.0 / total.max(1e-6)).min(1e4);
            gate.weights[i] = places.map(|w| (w * scale).round() as i16);
            gate.bounds[i] = (bound * scale).round().clamp(-32_000.0, 32_000.0) as i16;
        }
        gate
    }

    /// A gate from tests of the mean levels of red, green and blue, as learning finds them.
    pub fn learnt(format: PixelFormat, tests: &[ColourTest]) -> Self {
        let mut all = [([0.0; 3], -1.0); GATE_TESTS];
        for (test, ColourTest { weights: [r, g, b], bound }) in all.iter_mut().zip(tests) {
            *test = ([*r as f32, 0.5 * *g as f32, *b as f32], *bound as f32);
        }
        Self::new(format, &all[..tests.len().min(GATE_TESTS)])
    }

    /// Whether a cell of these four levels passes.
    #[inline(always)]
    pub fn passes(&self, cell: [u8; 4]) -> bool {
        self.weights.iter().zip(&self.bounds).all(|(w, bound)| {
            let sum: i16 = w.iter().zip(cell).map(|(w, level)| w * i16::from(level)).sum();
            sum > *bound
        })
    }
}
