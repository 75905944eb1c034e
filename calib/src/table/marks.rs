use nalgebra::{Rotation3, Vector3};
use netcord_common::geometry::{Board, Point, Transform};

use super::Table;

/// Width of the playing surface, along x, m (ITTF Laws 2.1.1).
pub const TABLE_WIDTH_M: f64 = 1.525;
/// Length of the playing surface, along y, m.
pub const TABLE_LENGTH_M: f64 = 2.740;

/// Marks that every table has, by name, m in the table frame. Corners and sides are the outer edges of the
/// white lines, which are the edges of the playing surface; the middle line's ends are its centre on them.
pub const MARKS: [(&str, [f64; 3]); 9] = [
    ("x-y-", [-TABLE_WIDTH_M / 2.0, -TABLE_LENGTH_M / 2.0, 0.0]),
    ("x+y-", [TABLE_WIDTH_M / 2.0, -TABLE_LENGTH_M / 2.0, 0.0]),
    ("x+y+", [TABLE_WIDTH_M / 2.0, TABLE_LENGTH_M / 2.0, 0.0]),
    ("x-y+", [-TABLE_WIDTH_M / 2.0, TABLE_LENGTH_M / 2.0, 0.0]),
    ("x0y-", [0.0, -TABLE_LENGTH_M / 2.0, 0.0]),
    ("x0y+", [0.0, TABLE_LENGTH_M / 2.0, 0.0]),
    ("x-y0", [-TABLE_WIDTH_M / 2.0, 0.0, 0.0]),
    ("x+y0", [TABLE_WIDTH_M / 2.0, 0.0, 0.0]),
    ("x0y0", [0.0, 0.0, 0.0]),
];

/// The point that a mark means: one of [`MARKS`], or `x/y` or `x/y/z` in metres in the table frame.
///
/// # Errors
/// A sentence that lists what would be right.
pub fn mark(name: &str) -> Result<Vector3<f64>, String> {
    if let Some((_, at)) = MARKS.iter().find(|(n, _)| *n == name) {
        return Ok(Vector3::from(*at));
    }
    let numbers: Option<Vec<f64>> =
        name.split('/').map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    match numbers.as_deref() {
        Some([x, y]) => Ok(Vector3::new(*x, *y, 0.0)),
        Some([x, y, z]) => Ok(Vector3::new(*x, *y, *z)),
        _ => {
            let names: Vec<&str> = MARKS.iter().map(|(n, _)| *n).collect();
            Err(format!(
                "{name:?} is no mark of the table; valid are {} and places in metres such as 0.7425/1.35",
                names.join(", ")
            ))
        }
    }
}

/// How a board lies on the table, printed side up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardOnTable {
    /// Where the board's origin (its first corner) is, x and y in the table frame, m.
    pub origin_m: [f64; 2],
    /// The direction of the board's x axis, counted from the table's x axis towards its y axis, rad.
    pub yaw_rad: f64,
    /// Height of the printed side above the playing surface, m.
    pub height_m: f64,
}

impl BoardOnTable {
    /// The board's pose on the table. A board's z points away from its viewer: downwards here.
    pub fn table_from_board(&self) -> Transform<Table, Board> {
        let x = Vector3::new(self.yaw_rad.cos(), self.yaw_rad.sin(), 0.0);
        let z = -Vector3::z();
        let turn = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
        Transform::new(turn, Vector3::new(self.origin_m[0], self.origin_m[1], self.height_m))
    }

    /// A point of the board in the table frame.
    pub fn place(&self, on_board: &Vector3<f64>) -> Vector3<f64> {
        (&self.table_from_board() * Point::from(*on_board)).coords
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_places_of_the_table_and_others_are_refused() {
        assert_eq!(mark("x+y-").expect("a corner"), Vector3::new(0.7625, -1.37, 0.0));
        assert_eq!(mark("0.1/-0.2").expect("a place"), Vector3::new(0.1, -0.2, 0.0));
        assert_eq!(mark("0.1/-0.2/0.1525").expect("a place"), Vector3::new(0.1, -0.2, 0.1525));
        for wrong in ["corner", "1", "a/b", "1/2/3/4"] {
            let error = mark(wrong).expect_err(wrong);
            assert!(error.contains(wrong) && error.contains("x-y0"), "{error}");
        }
    }

    #[test]
    fn a_board_on_the_table_looks_up() {
        let board = BoardOnTable { origin_m: [0.1, 0.2], yaw_rad: 0.0, height_m: 0.005 };
        assert!((board.place(&Vector3::zeros()) - Vector3::new(0.1, 0.2, 0.005)).norm() < 1e-12);
        // Seen from above with x to the right, the board's y runs downwards: against the table's y.
        assert!((board.place(&Vector3::new(0.3, 0.4, 0.0)) - Vector3::new(0.4, -0.2, 0.005)).norm() < 1e-12);
        assert!((board.table_from_board().rotation * Vector3::z() + Vector3::z()).norm() < 1e-12);
    }
}
