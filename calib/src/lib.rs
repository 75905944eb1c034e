//! Calibration: from printed boards to a rig whose every number carries its uncertainty.
//!
//! [`board`] describes and prints boards, [`detect`] finds them in pictures, [`gather`] chooses views,
//! [`solve`] computes cameras, rigs and their covariances, [`table`] finds the table before them,
//! [`check`] says what a finished calibration is worth today, and [`session`] leads a person through all of it.
//!
//! ```
//! use netcord_calib::board::CalibrationBoard;
//!
//! let board = CalibrationBoard::parse("charuco:11x8:DICT_5X5_250:30mm:22mm", |_| Err("no files".into()))?;
//! assert_eq!(board.corners().len(), 70);
//! # Ok::<(), netcord_calib::board::BoardError>(())
//! ```

pub mod board;
pub mod check;
pub mod detect;
pub mod gather;
pub mod session;
pub mod solve;
pub mod table;
