//! The nodes of a description.

use super::{Access, Formula, Number};

/// Place of a node in the description.
pub(super) type NodeId = usize;

/// A constant, or the value of another node.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Operand {
    Constant(Number),
    Node(NodeId),
    /// The description names a node that it does not have.
    Missing(String),
}

/// Part of the address that another node chooses.
#[derive(Debug, Clone)]
pub(super) struct AddressIndex {
    pub(super) index: Operand,
    pub(super) offset: Operand,
}

/// Where a register lies.
#[derive(Debug, Clone, Default)]
pub(super) struct Register {
    pub(super) fixed: u64,
    pub(super) parts: Vec<Operand>,
    pub(super) indices: Vec<AddressIndex>,
    pub(super) length: Option<Operand>,
    pub(super) access: Option<Access>,
    pub(super) big_endian: bool,
    /// Whether it lies in the device, and not in chunks or events.
    pub(super) in_device: bool,
}

/// The bits of an integer register that count.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Bits {
    /// As the description counts them: from the register's other end where it is big-endian.
    pub(super) mask: Option<(u32, u32)>,
    pub(super) signed: bool,
}

/// Where an integer, float or enumeration gets its value.
#[derive(Debug, Clone, Default)]
pub(super) struct Source {
    pub(super) value: Option<Operand>,
    pub(super) index: Option<Operand>,
    pub(super) indexed: Vec<(i64, Operand)>,
    pub(super) default: Option<Operand>,
    pub(super) copies: Vec<Operand>,
}

#[derive(Debug, Clone, Default)]
pub(super) struct Limits {
    pub(super) min: Option<Operand>,
    pub(super) max: Option<Operand>,
    pub(super) increment: Option<Operand>,
}

#[derive(Debug, Clone)]
pub(super) struct Entry {
    pub(super) name: String,
    pub(super) value: i64,
    pub(super) conditions: Conditions,
}

/// A formula with what its names mean.
#[derive(Debug, Clone)]
pub(super) struct Bound {
    pub(super) formula: Formula,
    /// In the order of [`Formula::variables`].
    pub(super) variables: Vec<Variable>,
}

#[derive(Debug, Clone)]
pub(super) enum Variable {
    Operand(Operand),
    /// `.Min`, `.Max`, `.Inc` of a node.
    Min(NodeId),
    Max(NodeId),
    Increment(NodeId),
    /// The value of an enumeration's entry.
    Entry(NodeId, String),
    /// What a converter converts.
    Input,
    Expression(usize),
}

#[derive(Debug, Clone)]
pub(super) struct Knife {
    /// Expressions first, then the formula itself; empty where it could not be read.
    pub(super) formulas: Vec<Bound>,
    pub(super) float: bool,
}

#[derive(Debug, Clone)]
pub(super) enum Kind {
    Category(Vec<Operand>),
    Integer(Source, Limits),
    Float(Source, Limits),
    IntRegister(Register, Bits),
    FloatRegister(Register),
    TextRegister(Register),
    RawRegister(Register),
    Text(Source, String),
    Enumeration(Source, Vec<Entry>),
    Command {
        target: Source,
        value: Option<Operand>,
    },
    Boolean {
        target: Source,
        on: i64,
        off: i64,
    },
    Knife(Knife),
    Converter {
        to: Knife,
        from: Knife,
        target: Option<Operand>,
    },
    Port,
    /// A node that the description defines in a way that cannot be used.
    Broken(String),
    /// A node of another type.
    Other,
}

#[derive(Debug, Clone, Default)]
pub(super) struct Conditions {
    pub(super) implemented: Option<Operand>,
    pub(super) available: Option<Operand>,
    pub(super) locked: Option<Operand>,
}

#[derive(Debug, Clone)]
pub(super) struct Node {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) conditions: Conditions,
    pub(super) imposed: Option<Access>,
    pub(super) unit: Option<String>,
    pub(super) tooltip: Option<String>,
    pub(super) selects: Vec<String>,
}
