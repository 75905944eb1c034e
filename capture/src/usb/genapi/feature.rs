use std::fmt;

use super::Number;

/// What kind of value a feature has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeatureType {
    /// Whole numbers.
    Integer,
    /// Floats.
    Float,
    /// Text.
    Text,
    /// One of some names.
    Enumeration,
    /// It is carried out, and has no value.
    Command,
    /// On or off.
    Boolean,
    /// A group of features.
    Category,
    /// Raw bytes.
    Register,
}

impl FeatureType {
    /// The name that listings use.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Integer => "integer",
            Self::Float => "float",
            Self::Text => "text",
            Self::Enumeration => "enumeration",
            Self::Command => "command",
            Self::Boolean => "boolean",
            Self::Category => "category",
            Self::Register => "register",
        }
    }
}

/// What may be done with a feature now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// The camera says that it does not have it, or not now.
    NotAvailable,
    /// It can be read.
    ReadOnly,
    /// It can be written.
    WriteOnly,
    /// Both.
    ReadWrite,
}

impl Access {
    /// The short form that listings use.
    pub const fn name(self) -> &'static str {
        match self {
            Self::NotAvailable => "NA",
            Self::ReadOnly => "RO",
            Self::WriteOnly => "WO",
            Self::ReadWrite => "RW",
        }
    }

    /// Whether it can be read.
    pub const fn readable(self) -> bool {
        matches!(self, Self::ReadOnly | Self::ReadWrite)
    }

    /// Whether it can be written.
    pub const fn writable(self) -> bool {
        matches!(self, Self::WriteOnly | Self::ReadWrite)
    }

    pub(super) const fn and(self, other: Self) -> Self {
        let read = self.readable() && other.readable();
        let write = self.writable() && other.writable();
        match (read, write) {
            (true, true) => Self::ReadWrite,
            (true, false) => Self::ReadOnly,
            (false, true) => Self::WriteOnly,
            (false, false) => Self::NotAvailable,
        }
    }

    pub(super) fn parse(text: &str) -> Option<Self> {
        match text.trim() {
            "RO" => Some(Self::ReadOnly),
            "WO" => Some(Self::WriteOnly),
            "RW" => Some(Self::ReadWrite),
            _ => None,
        }
    }
}

/// Which values a number may have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Least.
    pub min: Number,
    /// Most.
    pub max: Number,
    /// Step from the least, where there is one.
    pub increment: Option<i64>,
}

/// A feature's value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Of an integer.
    Integer(i64),
    /// Of a float.
    Float(f64),
    /// Of text.
    Text(String),
    /// The name of an enumeration's entry.
    Entry(String),
    /// Of a boolean.
    Boolean(bool),
}

impl Value {
    /// The value as a number, where it is one.
    pub const fn number(&self) -> Option<Number> {
        match self {
            Self::Integer(i) => Some(Number::Int(*i)),
            Self::Float(f) => Some(Number::Float(*f)),
            Self::Boolean(b) => Some(Number::Int(*b as i64)),
            Self::Text(_) | Self::Entry(_) => None,
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(i) => i.fmt(f),
            Self::Float(x) => x.fmt(f),
            Self::Text(t) | Self::Entry(t) => t.fmt(f),
            Self::Boolean(b) => b.fmt(f),
        }
    }
}

/// All that can be told about a feature.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureInfo {
    /// Its name.
    pub name: String,
    /// What kind of value it has.
    pub kind: FeatureType,
    /// What may be done with it now.
    pub access: Access,
    /// Which values a number may have.
    pub range: Option<Range>,
    /// The unit, where there is one.
    pub unit: Option<String>,
    /// The names of an enumeration that are available now.
    pub entries: Vec<String>,
    /// What it means, in the camera's words.
    pub tooltip: Option<String>,
    /// Features that this one selects.
    pub selects: Vec<String>,
}
