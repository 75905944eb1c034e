use std::collections::VecDeque;

use crate::observer::Observed;

/// The table from above and from the side, drawn with characters: what was found, over the truth.
#[derive(Debug, Default)]
pub(super) struct TableView {
    found: VecDeque<[f64; 3]>,
    truth: VecDeque<[f64; 3]>,
}

/// Positions shown of each.
const TRAIL: usize = 60;
/// Half of the playing surface's length and width, m, and what is shown around it.
const HALF_LENGTH_M: f64 = 1.37;
const HALF_WIDTH_M: f64 = 0.7625;
const SHOWN_Y_M: f64 = 2.0;
const SHOWN_X_M: f64 = 1.0;
const SHOWN_Z_M: f64 = 0.8;
/// Characters of a view.
const COLUMNS: usize = 73;
const ROWS_ABOVE: usize = 13;
const ROWS_SIDE: usize = 7;

impl TableView {
    pub(super) fn see(&mut self, seen: &Observed<'_>) {
        match seen {
            Observed::Truth(truth) if truth.present == 1 => push(&mut self.truth, truth.position_m),
            Observed::Position(position) if position.is_present() => {
                push(&mut self.found, position.position_m);
            }
            _ => {}
        }
    }

    /// Both views as lines.
    pub(super) fn lines(&self) -> Vec<String> {
        let above = |p: &[f64; 3]| cell(p[1], SHOWN_Y_M, -p[0], SHOWN_X_M, ROWS_ABOVE);
        let side = |p: &[f64; 3]| cell(p[1], SHOWN_Y_M, SHOWN_Z_M - 2.0 * p[2], SHOWN_Z_M, ROWS_SIDE);
        let mut lines = self.draw(ROWS_ABOVE, above, |canvas| {
            let corners = [[-HALF_WIDTH_M, -HALF_LENGTH_M, 0.0], [HALF_WIDTH_M, HALF_LENGTH_M, 0.0]];
            let (Some((right, bottom)), Some((left, top))) = (above(&corners[0]), above(&corners[1])) else {
                return;
            };
            let (x0, x1) = (left.min(right), left.max(right));
            let (y0, y1) = (top.min(bottom), top.max(bottom));
            for x in x0..=x1 {
                canvas[y0][x] = '─';
                canvas[y1][x] = '─';
            }
            for row in &mut canvas[y0..=y1] {
                row[x0] = '│';
                row[x1] = '│';
                row[usize::midpoint(x0, x1)] = '┊';
            }
        });
        lines.extend(self.draw(ROWS_SIDE, side, |canvas| {
            let ends = [side(&[0.0, -HALF_LENGTH_M, 0.0]), side(&[0.0, HALF_LENGTH_M, 0.0])];
            if let [Some((x0, y)), Some((x1, _))] = ends {
                for x in x0..=x1 {
                    canvas[y][x] = '▔';
                }
                canvas[y.saturating_sub(1)][usize::midpoint(x0, x1)] = '┊';
            }
        }));
        lines
    }

    fn draw(
        &self,
        rows: usize,
        place: impl Fn(&[f64; 3]) -> Option<(usize, usize)>,
        table: impl FnOnce(&mut Vec<Vec<char>>),
    ) -> Vec<String> {
        let mut canvas = vec![vec![' '; COLUMNS]; rows];
        table(&mut canvas);
        for (points, mark) in [(&self.truth, '·'), (&self.found, 'o')] {
            for (x, y) in points.iter().filter_map(&place) {
                canvas[y][x] = mark;
            }
        }
        if let Some((x, y)) = self.found.back().and_then(&place) {
            canvas[y][x] = '●';
        }
        canvas
            .into_iter()
            .map(|row| format!("  {}", row.into_iter().collect::<String>().trim_end()))
            .collect()
    }
}

fn push(points: &mut VecDeque<[f64; 3]>, point: [f64; 3]) {
    if points.len() == TRAIL {
        points.pop_front();
    }
    points.push_back(point);
}

/// Column and row of a point, `right` and `down` within ± their bounds.
fn cell(right: f64, bound_right: f64, down: f64, bound_down: f64, rows: usize) -> Option<(usize, usize)> {
    let index = |value: f64, bound: f64, count: usize| {
        let place = (value + bound) / (2.0 * bound) * (count - 1) as f64;
        (place > -0.5 && place < count as f64 - 0.5).then(|| place.round() as usize)
    };
    Some((index(right, bound_right, COLUMNS)?, index(down, bound_down, rows)?))
}

#[cfg(test)]
mod tests {
    use netcord_common::wire::BallPosition;

    use super::*;

    fn found(view: &mut TableView, position_m: [f64; 3]) {
        view.see(&Observed::Position(&BallPosition { position_m, ..BallPosition::default() }));
    }

    #[test]
    fn a_ball_over_the_middle_shows_in_the_middle_of_both_views() {
        let mut view = TableView::default();
        found(&mut view, [0.0, 0.0, 0.4]);
        let lines = view.lines();
        assert_eq!(lines.len(), ROWS_ABOVE + ROWS_SIDE);
        let column = |line: &str| line.chars().position(|c| c == '●');
        assert_eq!(column(&lines[ROWS_ABOVE / 2]), Some(2 + COLUMNS / 2));
        assert_eq!(column(&lines[ROWS_ABOVE + ROWS_SIDE / 2]), Some(2 + COLUMNS / 2));
        found(&mut view, [9.0, 9.0, 9.0]);
        assert!(view.lines().iter().all(|l| !l.contains('●')), "outside of what is shown");
    }
}
