use std::ops::Range;

/// What one body adds to the pixels of a rectangle, summed over the exposure. The sums lie in an array each,
/// so that rows of them are worked on several pixels at a time.
#[derive(Debug, Default)]
pub struct Layer {
    columns: Range<usize>,
    rows: Range<usize>,
    /// Share of each pixel's light that the body takes the place of, 0–1.
    coverage: Vec<f32>,
    /// Light that it gives instead, in full light, DN.
    light: Vec<f32>,
    /// Coverage less what the net and nearer bodies hide.
    shown: Vec<f32>,
    /// For each row the columns, counted from the layer's first, in which anything is covered.
    spans: Vec<Range<usize>>,
}

/// Part of a row of a layer.
#[derive(Debug)]
pub struct LayerRow<'a> {
    /// Column of the frame in which it begins.
    pub x0: usize,
    /// Share of each pixel's light that the body takes the place of, 0–1.
    pub coverage: &'a mut [f32],
    /// Light that it gives instead, in full light, DN.
    pub light: &'a mut [f32],
    /// Coverage less what the net and nearer bodies hide.
    pub shown: &'a mut [f32],
}

impl Layer {
    /// A layer with room for `pixels`: more are taken from the heap when a body is larger.
    pub fn with_room(pixels: usize) -> Self {
        let sums = || Vec::with_capacity(pixels);
        Self {
            coverage: sums(),
            light: sums(),
            shown: sums(),
            spans: Vec::with_capacity(2048),
            ..Self::default()
        }
    }

    /// Starts over for these columns and rows.
    pub fn reset(&mut self, (columns, rows): (Range<usize>, Range<usize>)) {
        let pixels = columns.len() * rows.len();
        for sums in [&mut self.coverage, &mut self.light, &mut self.shown] {
            sums.clear();
            // A body that comes nearer and nearer takes memory a few times only.
            sums.reserve(pixels.next_power_of_two());
            sums.resize(pixels, 0.0);
        }
        self.spans.clear();
        self.spans.reserve(rows.len().next_power_of_two());
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

    /// Rows that it has.
    pub fn rows(&self) -> Range<usize> {
        self.rows.clone()
    }

    /// Those of `rows` that it has in some of `columns`: none where it lies beside them.
    pub fn rows_among(&self, columns: &Range<usize>, rows: &Range<usize>) -> Range<usize> {
        if self.columns.end <= columns.start || columns.end <= self.columns.start {
            return 0..0;
        }
        self.rows.start.max(rows.start)..self.rows.end.min(rows.end)
    }

    /// The columns of the frame in which row `y`, which it has, is covered.
    pub fn covered(&self, y: usize) -> Range<usize> {
        let span = &self.spans[y - self.rows.start];
        self.columns.start + span.start..self.columns.start + span.end
    }

    /// All of row `y`, which it has.
    pub fn row_mut(&mut self, y: usize) -> LayerRow<'_> {
        let width = self.columns.len();
        let start = (y - self.rows.start) * width;
        let row = start..start + width;
        LayerRow {
            x0: self.columns.start,
            coverage: &mut self.coverage[row.clone()],
            light: &mut self.light[row.clone()],
            shown: &mut self.shown[row],
        }
    }

    /// Where columns `xs`, which it has, of row `y` lie in the sums.
    fn place(&self, y: usize, xs: &Range<usize>) -> Range<usize> {
        let start = (y - self.rows.start) * self.columns.len();
        start + xs.start - self.columns.start..start + xs.end - self.columns.start
    }

    /// Paints the part of row `y` that lies in columns `xs` over `means`, which are those columns', in light
    /// that is dimmed by `gain`; says whether there was anything to be painted.
    #[inline(always)]
    pub fn blend(&self, y: usize, xs: Range<usize>, gain: f32, means: &mut [f32]) -> bool {
        let covered = self.covered(y);
        let (start, end) = (covered.start.max(xs.start), covered.end.min(xs.end));
        if start >= end {
            return false;
        }
        let place = self.place(y, &(start..end));
        let sums = self.coverage[place.clone()].iter().zip(&self.light[place]);
        for (mean, (coverage, light)) in means[start - xs.start..end - xs.start].iter_mut().zip(sums) {
            *mean = *mean * (1.0 - coverage) + light * gain;
        }
        true
    }

    /// Hides what `nearer` covers.
    pub fn hide_behind(&mut self, nearer: &Self) {
        for y in nearer.rows_among(&self.columns, &self.rows) {
            let theirs = nearer.covered(y);
            let (start, end) = (theirs.start.max(self.columns.start), theirs.end.min(self.columns.end));
            if start >= end {
                continue;
            }
            let place = self.place(y, &(start..end));
            let shares = &nearer.coverage[nearer.place(y, &(start..end))];
            for (shown, coverage) in self.shown[place].iter_mut().zip(shares) {
                *shown *= 1.0 - coverage;
            }
        }
    }

    /// What is shown, in pixels.
    pub fn shown(&self) -> f64 {
        self.shown.iter().map(|shown| f64::from(*shown)).sum()
    }

    /// Coverage and what is shown of it, pixel by pixel, with the pixels' coordinates.
    #[cfg(test)]
    pub fn pixels(&self) -> impl Iterator<Item = ((usize, usize), f64, f64)> + '_ {
        let places = self.rows.clone().flat_map(|y| self.columns.clone().map(move |x| (x, y)));
        places.zip(self.coverage.iter().zip(&self.shown)).map(|(at, (c, s))| (at, (*c).into(), (*s).into()))
    }
}
