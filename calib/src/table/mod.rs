//! The table's frame: where the table stands before the cameras, with its uncertainty, from marks on it
//! that cameras see, from a board that lies on it, and from where the ball bounces.

mod bounces;
mod lines;
mod marks;
mod pose;

pub use bounces::{Bounce, TrackedPoint, find_bounces};
pub use lines::{BORDER_LINE_M, FoundMark, find_marks};
pub use marks::{BoardOnTable, MARKS, TABLE_LENGTH_M, TABLE_WIDTH_M, mark};
pub use pose::{
    Contact, Table, TableCalibration, TableCamera, TableError, TableResidual, TableSighting, TableStart,
    calibrate_table,
};
