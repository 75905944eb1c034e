//! GenApi: a camera's features by name, as the description that it brings along defines them.
//!
//! A bounded subset, enough for the features that a camera is driven by: integers, floats, text,
//! enumerations, commands and booleans, over registers of both byte orders, masks, indexed addresses,
//! formulas and converters. Registers are never cached: they are read when they are asked for.
//! Descriptions come from devices: nothing in them may panic, loop or take memory without end.
//!
//! Source: GenICam GenApi schema 1.1 and Standard Features Naming Convention 2.7.

mod access;
mod error;
mod feature;
mod formula;
mod load;
mod node;
mod number;

pub use access::GenApi;
pub use error::{FeatureError, LoadError};
pub use feature::{Access, FeatureInfo, FeatureType, Range, Value};
pub use formula::{Formula, FormulaError};
pub use number::Number;
