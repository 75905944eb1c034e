use nalgebra::Vector2;
use serde::Serialize;

/// How many corners fell into each cell of a grid over the picture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct HeatMap {
    /// Cells along x.
    pub columns: usize,
    /// Cells along y.
    pub rows: usize,
    /// Corners per cell, row by row.
    pub counts: Vec<u32>,
}

impl HeatMap {
    /// Without any corner.
    pub fn new(columns: usize, rows: usize) -> Self {
        Self { columns, rows, counts: vec![0; columns * rows] }
    }

    /// Counts corners, in px, of a picture of `size`.
    pub fn add<'a>(&mut self, size: (u32, u32), corners: impl IntoIterator<Item = &'a Vector2<f64>>) {
        let cell = |at: f64, size: u32, count: usize| {
            ((at + 0.5) / f64::from(size) * count as f64).clamp(0.0, count as f64 - 1.0) as usize
        };
        for corner in corners {
            let (x, y) = (cell(corner.x, size.0, self.columns), cell(corner.y, size.1, self.rows));
            self.counts[y * self.columns + x] += 1;
        }
    }

    /// Corners in cell (`column`, `row`).
    pub fn at(&self, column: usize, row: usize) -> u32 {
        self.counts[row * self.columns + column]
    }

    /// Share of the cells that hold a corner, 0–1.
    pub fn share(&self) -> f64 {
        self.counts.iter().filter(|c| **c > 0).count() as f64 / self.counts.len().max(1) as f64
    }
}
