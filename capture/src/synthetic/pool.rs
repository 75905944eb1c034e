use netcord_common::wire::CameraTruth;

use super::{
    flight::TrackPoint,
    render::{Exposure, FrameRenderer, TILE, TileGrid},
};

/// Frames rendered beforehand, for rates at which rendering would be what is measured.
///
/// A frame is kept as the tiles that differ from the still backdrop. A slot of shared memory keeps what
/// it held: it gets a whole noisy backdrop when it is first used, and from then on only the tiles of its
/// last frame are restored and those of the new one written. So a frame costs some ten microseconds, and
/// no frame is ever copied whole. The price: the noise of the backdrop stays the same from one use of a
/// slot to the next (slots differ from each other), and the light is steady.
#[derive(Debug)]
pub struct FramePool {
    grid: TileGrid,
    /// Noisy backdrops; slots take turns.
    backdrops: Vec<Vec<u8>>,
    frames: Vec<PooledFrame>,
    slots: Vec<SlotState>,
}

#[derive(Debug)]
struct PooledFrame {
    tiles: Vec<u32>,
    /// [`TILE`] × [`TILE`] bytes for each tile; those beyond the frame's edge mean nothing.
    bytes: Vec<u8>,
    truth: CameraTruth,
    ball: Option<TrackPoint>,
}

/// What a slot, known by the address of its memory, holds.
#[derive(Debug, Clone, Copy)]
struct SlotState {
    address: usize,
    backdrop: usize,
    frame: usize,
}

/// Backdrops that differ in their noise.
const BACKDROPS: usize = 4;

/// More slots than a frame topic has.
const MAX_SLOTS: usize = 512;

impl FramePool {
    /// Renders `count` frames, `interval_s` apart from the scene's beginning.
    pub fn new(renderer: &mut FrameRenderer, count: usize, interval_s: f64, length_s: f64) -> Self {
        let (width, height) = renderer.size();
        let grid = TileGrid { width, height };
        let mut whole = vec![0; width * height];
        let backdrops = (0..BACKDROPS)
            .map(|i| {
                let mut bytes = vec![0; width * height];
                renderer.render_backdrop(u64::MAX - i as u64, &mut bytes);
                bytes
            })
            .collect();
        let frames = (0..count.max(1))
            .map(|n| {
                let exposure = Exposure { frame: n as u64, mid_s: n as f64 * interval_s, length_s };
                let mut tiles = Vec::new();
                let truth = renderer.render_changes(&exposure, &mut whole, &mut tiles);
                let mut bytes = vec![0; tiles.len() * TILE * TILE];
                for (tile, bytes) in tiles.iter().zip(bytes.chunks_exact_mut(TILE * TILE)) {
                    let (xs, ys) = grid.pixels(*tile);
                    for (y, row) in ys.zip(bytes.chunks_exact_mut(TILE)) {
                        row[..xs.len()].copy_from_slice(&whole[y * width + xs.start..y * width + xs.end]);
                    }
                }
                PooledFrame { tiles, bytes, truth, ball: renderer.ball_at(exposure.mid_s) }
            })
            .collect();
        Self { grid, backdrops, frames, slots: Vec::with_capacity(MAX_SLOTS) }
    }

    /// Makes a slot hold frame `n`, counted round and round.
    pub fn write(&mut self, n: u64, slot: &mut [u8]) -> CameraTruth {
        let frame = (n % self.frames.len() as u64) as usize;
        let address = slot.as_ptr().addr();
        let known = self.slots.iter().position(|s| s.address == address);
        let place = known.unwrap_or_else(|| {
            if self.slots.len() == MAX_SLOTS {
                self.slots.clear();
            }
            let backdrop = self.slots.len() % BACKDROPS;
            slot[..self.grid.width * self.grid.height].copy_from_slice(&self.backdrops[backdrop]);
            self.slots.push(SlotState { address, backdrop, frame });
            self.slots.len() - 1
        });
        let state = &mut self.slots[place];
        if known.is_some() {
            let backdrop = &self.backdrops[state.backdrop];
            for tile in &self.frames[state.frame].tiles {
                let (xs, ys) = self.grid.pixels(*tile);
                for y in ys {
                    let row = y * self.grid.width + xs.start..y * self.grid.width + xs.end;
                    slot[row.clone()].copy_from_slice(&backdrop[row]);
                }
            }
        }
        state.frame = frame;
        let frame = &self.frames[frame];
        for (tile, bytes) in frame.tiles.iter().zip(frame.bytes.chunks_exact(TILE * TILE)) {
            let (xs, ys) = self.grid.pixels(*tile);
            for (y, row) in ys.zip(bytes.chunks_exact(TILE)) {
                slot[y * self.grid.width + xs.start..y * self.grid.width + xs.end]
                    .copy_from_slice(&row[..xs.len()]);
            }
        }
        frame.truth
    }

    /// How the ball is seen in frame `n`.
    pub fn truth(&self, n: u64) -> CameraTruth {
        self.frame(n).truth
    }

    /// The ball in frame `n`, and how often all frames have been shown before.
    pub fn ball(&self, n: u64) -> (Option<TrackPoint>, u64) {
        (self.frame(n).ball, n / self.frames.len() as u64)
    }

    fn frame(&self, n: u64) -> &PooledFrame {
        &self.frames[(n % self.frames.len() as u64) as usize]
    }
}
