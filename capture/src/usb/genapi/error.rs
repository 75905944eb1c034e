use thiserror::Error;

use super::FormulaError;
use crate::usb::gencp::MemoryError;

/// A description that cannot be read.
#[derive(Debug, Error)]
pub enum LoadError {
    /// It is not XML.
    #[error("the camera's description is not valid XML")]
    Xml(#[from] roxmltree::Error),
    /// It is XML of something else.
    #[error("the camera's description begins with <{0}> instead of <RegisterDescription>")]
    Root(String),
    /// It is larger than any known one by far.
    #[error("the camera's description has {0} bytes, more than any camera's by far")]
    TooLarge(usize),
}

/// Why a feature could not be read or set.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FeatureError {
    /// There is no such feature.
    #[error("the camera has no feature {name:?}{}", alike(.similar))]
    Unknown {
        /// What was asked for.
        name: String,
        /// What is called alike.
        similar: Vec<String>,
    },
    /// The camera says that it is not there, or not in its present state.
    #[error("the feature {0} is not available in the camera's present state")]
    NotAvailable(String),
    /// It can only be read.
    #[error("the feature {0} can only be read")]
    ReadOnly(String),
    /// It can only be written.
    #[error("the feature {0} can only be written")]
    WriteOnly(String),
    /// It is locked, as the image's size is while the stream runs.
    #[error("the feature {0} is locked while the camera streams")]
    Locked(String),
    /// The value lies outside.
    #[error("{value} is out of range for {name}: {min} to {max}{}", step(.increment))]
    OutOfRange {
        /// The feature.
        name: String,
        /// What was wanted.
        value: String,
        /// Least.
        min: String,
        /// Most.
        max: String,
        /// Step, where there is one.
        increment: Option<i64>,
    },
    /// The enumeration has no such entry.
    #[error("{value:?} is no value of {name}; valid are {}", .valid.join(", "))]
    NoEntry {
        /// The feature.
        name: String,
        /// What was wanted.
        value: String,
        /// What there is.
        valid: Vec<String>,
    },
    /// The register holds a value that no entry has.
    #[error("{name} has the value {value}, which is none of its entries")]
    NoSuchValue {
        /// The feature.
        name: String,
        /// What it has.
        value: i64,
    },
    /// A value of another type is wanted.
    #[error("{name} takes {wanted}, not {value:?}")]
    Type {
        /// The feature.
        name: String,
        /// What it takes.
        wanted: &'static str,
        /// What was given.
        value: String,
    },
    /// The description is broken at this node.
    #[error("the camera's description is broken at {node}: {what}")]
    Broken {
        /// The node.
        node: String,
        /// What is wrong.
        what: String,
    },
    /// A formula of the description cannot be computed.
    #[error("a formula of the camera's description failed: {0}")]
    Formula(#[from] FormulaError),
    /// The registers could not be accessed.
    #[error(transparent)]
    Memory(#[from] MemoryError),
}

impl FeatureError {
    /// Whether the camera has gone.
    pub fn is_gone(&self) -> bool {
        matches!(self, Self::Memory(e) if e.is_gone())
    }

    /// Whether the camera does not have the feature, or not now.
    pub const fn is_absent(&self) -> bool {
        matches!(self, Self::Unknown { .. } | Self::NotAvailable(_))
    }
}

fn alike(names: &[String]) -> String {
    if names.is_empty() { String::new() } else { format!("; it has {}", names.join(", ")) }
}

fn step(increment: &Option<i64>) -> String {
    increment.filter(|i| *i > 1).map_or_else(String::new, |i| format!(", in steps of {i}"))
}
