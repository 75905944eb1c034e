use std::ops::Range;

/// What one body adds to the pixels of a rectangle, summed over the exposure.
#[derive(Debug, Default)]
pub struct Layer {
    columns: Range<usize>,
    rows: Range<usize>,
    pixels: Vec<Share>,
    /// For each row the columns, counted from the layer's first, in which anything is covered.
    spans: Vec<Range<usize>>,
}

/// One pixel's share of a body.
#[derive(Debug, Clone, Copy, Default)]
pub struct Share {
    /// Share of the pixel's light that the body takes the place of, 0–1.
    pub coverage: f32,
    /// Light that it gives instead, DN.
    pub light: f32,
    /// Coverage less what the net and nearer bodies hide.
    pub shown: f32,
}

impl Layer {
    /// A layer with room for `pixels`: more are taken from the heap when a body is larger.
    pub fn with_room(pixels: usize) -> Self {
        Self { pixels: Vec::with_capacity(pixels), spans: Vec::with_capacity(2048), ..Self::default() }
    }

    /// Starts over for these columns and rows.
    pub fn reset(&mut self, (columns, rows): (Range<usize>, Range<usize>)) {
        self.pixels.clear();
        self.pixels.resize(columns.len() * rows.len(), Share::default());
        self.spans.clear();
        self.spans.resize(rows.len(), 0..0);
        (self.columns, self.rows) = (columns, rows);
    }

    /// Takes note that row `y` is covered in `columns` of the frame.
    pub fn widen(&mut self, y: usize, columns: Range<usize>) {
        let span = &mut self.spans[y - self.rows.start];
        let (start, end) = (columns.start - self.columns.start, columns.end - self.columns.start);
        *span = match (span.start, span.end) {
            (a, b) if a < b => a.min(start)..b.max(end),
            _ => start..end,
        };
    }

    /// The first covered column of row `y` of the frame, and the pixels from there to the last.
    pub fn covered(&self, y: usize) -> (usize, &[Share]) {
        let (x0, row) = self.row(y);
        match self.spans.get(y.wrapping_sub(self.rows.start)) {
            Some(span) => (x0 + span.start, &row[span.clone()]),
            None => (x0, &[]),
        }
    }

    /// Rows that it has.
    pub fn rows(&self) -> Range<usize> {
        self.rows.clone()
    }

    /// The first column, and the pixels of row `y`; empty where it has none.
    pub fn row_mut(&mut self, y: usize) -> (usize, &mut [Share]) {
        if !self.rows.contains(&y) {
            return (0, &mut []);
        }
        let start = (y - self.rows.start) * self.columns.len();
        (self.columns.start, &mut self.pixels[start..start + self.columns.len()])
    }

    /// As [`Self::row_mut`].
    pub fn row(&self, y: usize) -> (usize, &[Share]) {
        if !self.rows.contains(&y) {
            return (0, &[]);
        }
        let start = (y - self.rows.start) * self.columns.len();
        (self.columns.start, &self.pixels[start..start + self.columns.len()])
    }

    /// Hides what `nearer` covers.
    pub fn hide_behind(&mut self, nearer: &Self) {
        if nearer.columns.start >= self.columns.end || self.columns.start >= nearer.columns.end {
            return;
        }
        for y in self.rows.start.max(nearer.rows.start)..self.rows.end.min(nearer.rows.end) {
            let (x0, row) = self.row_mut(y);
            let (nearer_x0, nearer_row) = nearer.covered(y);
            for (i, share) in nearer_row.iter().enumerate() {
                if let Some(mine) = (nearer_x0 + i).checked_sub(x0).and_then(|i| row.get_mut(i)) {
                    mine.shown *= 1.0 - share.coverage;
                }
            }
        }
    }

    /// What is shown, in pixels.
    pub fn shown(&self) -> f64 {
        self.pixels.iter().map(|p| f64::from(p.shown)).sum()
    }
}
