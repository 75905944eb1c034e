//! Recorded flights: their formats, what truly happened in them, how well they are predicted.

mod clock;
mod evaluate;
mod fit;
mod parse;
mod truth;

pub use super::confidence::{CURVE, Curve};
pub use clock::Pace;
pub use evaluate::{
    Bet, EvaluateOptions, Evaluation, HORIZONS_MS, LEADS_MS, PredictionError, evaluate_set, find_noise,
    find_table, name_hash,
};
pub use fit::{FITTED, FITTED_NAMES, Fit, FitSet, fit, fitted_values, is_held_out};
pub use parse::{RecordedFrame, Recording, RecordingError, Sample, parse};
