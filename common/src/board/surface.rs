//! What is black and what is white on a board: as rectangles to print, and at a point to render.

use nalgebra::Vector2;

use super::{CalibrationBoard, Pattern};

impl CalibrationBoard {
    /// The black rectangles (least x, y; largest x, y; m) that make the pattern, before any inversion.
    pub fn black(&self) -> Vec<(Vector2<f64>, Vector2<f64>)> {
        let (low, _) = self.extent();
        let mut black = Vec::new();
        let (columns, rows, square) = match &self.pattern {
            Pattern::Chessboard { columns, rows, square_m } => (columns + 1, rows + 1, *square_m),
            Pattern::Charuco { columns, rows, square_m, .. } => (*columns, *rows, *square_m),
            Pattern::ArucoGrid { .. } => (0, 0, 0.0),
        };
        for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))) {
            if self.is_black_square(x, y) {
                let at = low + Vector2::new(x as f64, y as f64) * square;
                black.push((at, at + Vector2::repeat(square)));
            }
        }
        for marker in self.markers() {
            let Some(dictionary) = self.dictionary() else { continue };
            let cells = dictionary.size() + 2;
            let cell = marker.side / cells as f64;
            for row in 0..cells {
                // Neighbouring black cells of a row become one rectangle, so that printers leave no seams.
                let white = |column: usize| {
                    let inner = |i: usize| (1..=dictionary.size()).contains(&i);
                    inner(row)
                        && inner(column)
                        && dictionary.is_white(marker.id, row - 1, column - 1) == Some(true)
                };
                let mut column = 0;
                while column < cells {
                    let start = column;
                    while column < cells && !white(column) {
                        column += 1;
                    }
                    if column > start {
                        let at = |c: usize, r: usize| marker.origin + Vector2::new(c as f64, r as f64) * cell;
                        black.push((at(start, row), at(column, row + 1)));
                    }
                    column += 1;
                }
            }
        }
        black
    }

    /// Whether the point (x, y), m, of the board is white, the inversion included; `None` outside the
    /// pattern and a margin of `margin_m` around it.
    pub fn is_white(&self, at: &Vector2<f64>, margin_m: f64) -> Option<bool> {
        let (low, high) = self.extent();
        if at.x < low.x - margin_m
            || at.y < low.y - margin_m
            || at.x > high.x + margin_m
            || at.y > high.y + margin_m
        {
            return None;
        }
        Some(self.is_white_inside(at, &low, &high) != self.inverted)
    }

    /// White squares before square (x, y), row by row. Two rows that follow each other have as many white
    /// squares as black ones.
    fn white_squares_before(&self, columns: usize, x: usize, y: usize) -> usize {
        let in_row = |row: usize, squares: usize| {
            let white_first = !self.is_black_square(0, row);
            (squares + usize::from(white_first)) / 2
        };
        let odd = if y % 2 == 1 { in_row(y - 1, columns) } else { 0 };
        y / 2 * columns + odd + in_row(y, x)
    }

    fn is_white_inside(&self, at: &Vector2<f64>, low: &Vector2<f64>, high: &Vector2<f64>) -> bool {
        if at.x < low.x || at.y < low.y || at.x >= high.x || at.y >= high.y {
            return true;
        }
        let in_marker = |origin: Vector2<f64>, side: f64, id: usize| -> Option<bool> {
            let dictionary = self.dictionary()?;
            let cells = dictionary.size() + 2;
            let p = (at - origin) / side * cells as f64;
            if p.x < 0.0 || p.y < 0.0 || p.x >= cells as f64 || p.y >= cells as f64 {
                return None;
            }
            let (column, row) = (p.x as usize, p.y as usize);
            let border = column == 0 || row == 0 || column == cells - 1 || row == cells - 1;
            Some(!border && dictionary.is_white(id, row - 1, column - 1) == Some(true))
        };
        match &self.pattern {
            Pattern::Chessboard { square_m, .. } => {
                let p = (at - low) / *square_m;
                !self.is_black_square(p.x as usize, p.y as usize)
            }
            Pattern::Charuco { columns, square_m, marker_m, first_id, .. } => {
                let p = at / *square_m;
                let (x, y) = (p.x as usize, p.y as usize);
                if self.is_black_square(x, y) {
                    return false;
                }
                let before = self.white_squares_before(*columns, x, y);
                let origin = Vector2::new(x as f64, y as f64) * *square_m
                    + Vector2::repeat((square_m - marker_m) / 2.0);
                in_marker(origin, *marker_m, first_id + before).unwrap_or(true)
            }
            Pattern::ArucoGrid { columns, marker_m, gap_m, first_id, .. } => {
                let pitch = marker_m + gap_m;
                let (x, y) = ((at.x / pitch) as usize, (at.y / pitch) as usize);
                let origin = Vector2::new(x as f64, y as f64) * pitch;
                in_marker(origin, *marker_m, first_id + y * columns + x).unwrap_or(true)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn valid(spec: &str) -> CalibrationBoard {
        CalibrationBoard::parse(spec, |_| Err("no file here".to_owned())).expect(spec)
    }

    #[test]
    fn the_rectangles_and_the_point_test_describe_the_same_board() {
        for spec in [
            "chessboard:4x3:25mm",
            "aruco:2x3:DICT_5X5_50:40mm:10mm",
            "charuco:4x5:DICT_4X4_1000:54mm:40.5mm",
            "charuco:3x4:DICT_4X4_1000:54mm:40.5mm:legacy:inverted",
        ] {
            let board = valid(spec);
            let (low, high) = board.extent();
            let rectangles = board.black();
            for i in 0..4000 {
                let u = Vector2::new(f64::from(i % 63) / 62.7, f64::from(i / 63) / 63.9);
                let at = low + (high - low).component_mul(&u);
                let black =
                    rectangles.iter().any(|(a, b)| at.x >= a.x && at.y >= a.y && at.x < b.x && at.y < b.y);
                assert_eq!(board.is_white(&at, 0.0), Some(black == board.inverted), "{spec} at {at}");
            }
        }
    }
}
