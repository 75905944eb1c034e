use std::collections::HashMap;

use super::{
    Access, FeatureError, FeatureInfo, FeatureType, LoadError, Number, Range, Value,
    load::load,
    node::{Bits, Conditions, Entry, Kind, Knife, Node, NodeId, Operand, Register, Source, Variable},
};
use crate::usb::gencp::Memory;

/// Deepest chain of nodes and formulas that refer to each other: known descriptions stay below 60; a
/// circle ends here.
const MAX_DEPTH: usize = 1500;
/// Most node visits of one access: known descriptions stay below some hundreds.
const MAX_VISITS: usize = 20_000;
/// Longest register that is read.
const MAX_REGISTER: i64 = 1 << 20;

/// A camera's features.
#[derive(Debug)]
pub struct GenApi {
    nodes: Vec<Node>,
    names: HashMap<String, NodeId>,
    vendor: String,
    model: String,
    /// Values of nodes that have no register.
    locals: HashMap<NodeId, Number>,
}

/// One access: the memory, and how far it has come.
struct Visit<'m> {
    memory: &'m mut dyn Memory,
    depth: usize,
    visits: usize,
}

type Result<T> = std::result::Result<T, FeatureError>;

impl GenApi {
    /// Reads a camera's description.
    ///
    /// # Errors
    /// [`LoadError`]; a node that is broken is none, and fails when it is used.
    pub fn load(description: &str) -> std::result::Result<Self, LoadError> {
        let loaded = load(description)?;
        Ok(Self {
            nodes: loaded.nodes,
            names: loaded.names,
            vendor: loaded.vendor,
            model: loaded.model,
            locals: HashMap::new(),
        })
    }

    /// Vendor and model that the description is of.
    pub fn device(&self) -> (&str, &str) {
        (&self.vendor, &self.model)
    }

    /// How many nodes there are.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Whether a feature of this name exists.
    pub fn has(&self, name: &str) -> bool {
        self.names.contains_key(name)
    }

    /// The names of all features, by category, in the camera's order: those that `Root` leads to.
    pub fn features(&self) -> Vec<(String, Vec<String>)> {
        let mut categories = Vec::new();
        let mut seen = vec![false; self.nodes.len()];
        let mut open: Vec<NodeId> = self.names.get("Root").copied().into_iter().collect();
        while let Some(id) = open.pop() {
            let Kind::Category(features) = &self.nodes[id].kind else { continue };
            if std::mem::replace(&mut seen[id], true) {
                continue;
            }
            let ids: Vec<NodeId> = features
                .iter()
                .filter_map(|f| if let Operand::Node(id) = f { Some(*id) } else { None })
                .collect();
            let is_category = |id: &NodeId| matches!(self.nodes[*id].kind, Kind::Category(_));
            let names: Vec<String> =
                ids.iter().filter(|id| !is_category(id)).map(|id| self.nodes[*id].name.clone()).collect();
            if !names.is_empty() {
                categories.push((self.nodes[id].name.clone(), names));
            }
            open.extend(ids.iter().filter(|id| is_category(id)).rev());
        }
        categories
    }

    fn find(&self, name: &str) -> Result<NodeId> {
        self.names.get(name).copied().ok_or_else(|| {
            let wanted = name.to_lowercase();
            let mut similar: Vec<String> = self
                .features()
                .into_iter()
                .flat_map(|(_, names)| names)
                .filter(|n| {
                    let n = n.to_lowercase();
                    n.contains(&wanted) || wanted.contains(&n)
                })
                .collect();
            similar.truncate(5);
            FeatureError::Unknown { name: name.to_owned(), similar }
        })
    }

    /// The value of a feature.
    ///
    /// # Errors
    /// [`FeatureError`].
    pub fn get(&self, memory: &mut dyn Memory, name: &str) -> Result<Value> {
        let id = self.find(name)?;
        let mut visit = Visit { memory, depth: 0, visits: 0 };
        let access = self.access(id, &mut visit)?;
        match access {
            Access::NotAvailable => return Err(FeatureError::NotAvailable(name.to_owned())),
            Access::WriteOnly => return Err(FeatureError::WriteOnly(name.to_owned())),
            Access::ReadOnly | Access::ReadWrite => {}
        }
        match &self.nodes[id].kind {
            Kind::Text(..) | Kind::TextRegister(_) => self.text(id, &mut visit).map(Value::Text),
            Kind::Enumeration(_, entries) => {
                let value = self.number(id, &mut visit)?.int();
                let entry = entries.iter().find(|e| e.value == value);
                entry
                    .map(|e| Value::Entry(e.name.clone()))
                    .ok_or_else(|| FeatureError::NoSuchValue { name: name.to_owned(), value })
            }
            Kind::Boolean { .. } => self.number(id, &mut visit).map(|n| Value::Boolean(n.is_true())),
            Kind::Float(..) | Kind::FloatRegister(_) => {
                self.number(id, &mut visit).map(|n| Value::Float(n.float()))
            }
            _ => self.number(id, &mut visit).map(|n| match n {
                Number::Int(i) => Value::Integer(i),
                Number::Float(f) => Value::Float(f),
            }),
        }
    }

    /// The value of a feature as a float.
    ///
    /// # Errors
    /// [`FeatureError`].
    pub fn get_float(&self, memory: &mut dyn Memory, name: &str) -> Result<f64> {
        let value = self.get(memory, name)?;
        value.number().map(Number::float).ok_or_else(|| self.wrong_type(name, "a number", &value.to_string()))
    }

    /// The value of a feature as an integer; of an enumeration, the number behind its name.
    ///
    /// # Errors
    /// [`FeatureError`].
    pub fn get_int(&self, memory: &mut dyn Memory, name: &str) -> Result<i64> {
        let id = self.find(name)?;
        self.number(id, &mut Visit { memory, depth: 0, visits: 0 }).map(Number::int)
    }

    fn wrong_type(&self, name: &str, wanted: &'static str, value: &str) -> FeatureError {
        FeatureError::Type { name: name.to_owned(), wanted, value: value.to_owned() }
    }

    /// Sets a feature from text, as it is written on a command line or in a feature file: a number, the
    /// name of an entry, `true` or `false`, or the text itself.
    ///
    /// # Errors
    /// [`FeatureError`].
    pub fn set(&mut self, memory: &mut dyn Memory, name: &str, value: &str) -> Result<()> {
        let id = self.find(name)?;
        let mut visit = Visit { memory, depth: 0, visits: 0 };
        self.must_be_writable(id, &mut visit)?;
        let parsed = || Number::parse(value);
        match &self.nodes[id].kind {
            Kind::Enumeration(_, entries) => {
                let number = self.entry(name, entries, value, &mut visit)?;
                self.put(id, Number::Int(number), &mut visit, false)
            }
            Kind::Boolean { .. } => {
                let on = match value.trim() {
                    "true" | "1" | "on" | "On" => true,
                    "false" | "0" | "off" | "Off" => false,
                    _ => return Err(self.wrong_type(name, "true or false", value)),
                };
                self.put(id, Number::Int(on.into()), &mut visit, false)
            }
            Kind::Text(..) | Kind::TextRegister(_) => self.put_text(id, value, &mut visit),
            Kind::Float(..) | Kind::FloatRegister(_) | Kind::Converter { .. } => {
                let number = parsed().ok_or_else(|| self.wrong_type(name, "a number", value))?;
                self.put_checked(id, Number::Float(number.float()), &mut visit)
            }
            Kind::Command { .. } | Kind::Category(_) => {
                Err(self.wrong_type(name, "no value: it is carried out", value))
            }
            _ => match parsed() {
                Some(number @ Number::Int(_)) => self.put_checked(id, number, &mut visit),
                Some(Number::Float(_)) | None => Err(self.wrong_type(name, "a whole number", value)),
            },
        }
    }

    /// Carries a command out, at most once.
    ///
    /// # Errors
    /// [`FeatureError`].
    pub fn execute(&mut self, memory: &mut dyn Memory, name: &str) -> Result<()> {
        let id = self.find(name)?;
        let Kind::Command { value, .. } = &self.nodes[id].kind else {
            return Err(self.wrong_type(name, "a value: it is no command", ""));
        };
        let value = value.clone().unwrap_or(Operand::Constant(Number::Int(1)));
        let mut visit = Visit { memory, depth: 0, visits: 0 };
        self.must_be_writable(id, &mut visit)?;
        let value = self.operand(&value, &mut visit)?;
        self.put(id, value, &mut visit, true)
    }

    /// All that can be told about a feature now.
    ///
    /// # Errors
    /// [`FeatureError`]; what the camera does not tell is absent.
    pub fn info(&self, memory: &mut dyn Memory, name: &str) -> Result<FeatureInfo> {
        let id = self.find(name)?;
        let mut visit = Visit { memory, depth: 0, visits: 0 };
        let node = &self.nodes[id];
        let access = self.access(id, &mut visit)?;
        let kind = match &node.kind {
            Kind::Category(_) => FeatureType::Category,
            Kind::Integer(..) | Kind::IntRegister(..) => FeatureType::Integer,
            Kind::Float(..) | Kind::FloatRegister(_) => FeatureType::Float,
            Kind::Knife(knife) | Kind::Converter { from: knife, .. } if knife.float => FeatureType::Float,
            Kind::Knife(_) | Kind::Converter { .. } => FeatureType::Integer,
            Kind::Text(..) | Kind::TextRegister(_) => FeatureType::Text,
            Kind::Enumeration(..) => FeatureType::Enumeration,
            Kind::Command { .. } => FeatureType::Command,
            Kind::Boolean { .. } => FeatureType::Boolean,
            Kind::RawRegister(_) | Kind::Port | Kind::Other => FeatureType::Register,
            Kind::Broken(what) => {
                return Err(FeatureError::Broken { node: name.to_owned(), what: what.clone() });
            }
        };
        let wants_range = matches!(kind, FeatureType::Integer | FeatureType::Float);
        let range =
            if access.writable() && wants_range { self.range(id, &mut visit).unwrap_or(None) } else { None };
        let entries = match &node.kind {
            Kind::Enumeration(_, entries) => self.available_entries(entries, &mut visit),
            _ => Vec::new(),
        };
        Ok(FeatureInfo {
            name: name.to_owned(),
            kind,
            access,
            range,
            unit: self.unit(id, 0),
            entries,
            tooltip: node.tooltip.clone(),
            selects: node.selects.clone(),
        })
    }

    /// The unit of a node, or of the node that it takes its value from.
    fn unit(&self, id: NodeId, depth: usize) -> Option<String> {
        if depth > 8 || self.nodes[id].unit.is_some() {
            return self.nodes[id].unit.clone();
        }
        match &self.nodes[id].kind {
            Kind::Float(Source { value: Some(Operand::Node(next)), .. }, _)
            | Kind::Integer(Source { value: Some(Operand::Node(next)), .. }, _) => {
                self.unit(*next, depth + 1)
            }
            _ => None,
        }
    }

    fn available_entries(&self, entries: &[Entry], visit: &mut Visit<'_>) -> Vec<String> {
        let there = |e: &&Entry| self.is_there(&e.conditions, visit).unwrap_or(true);
        entries.iter().filter(there).map(|e| e.name.clone()).collect()
    }

    fn entry(&self, name: &str, entries: &[Entry], value: &str, visit: &mut Visit<'_>) -> Result<i64> {
        let by_name = entries.iter().find(|e| e.name == value.trim());
        let by_number = || {
            let number = Number::parse(value)?.int();
            entries.iter().find(|e| e.value == number)
        };
        match by_name.or_else(by_number) {
            Some(e) if self.is_there(&e.conditions, visit)? => Ok(e.value),
            _ => Err(FeatureError::NoEntry {
                name: name.to_owned(),
                value: value.to_owned(),
                valid: self.available_entries(entries, visit),
            }),
        }
    }

    fn is_there(&self, conditions: &Conditions, visit: &mut Visit<'_>) -> Result<bool> {
        for condition in [&conditions.implemented, &conditions.available].into_iter().flatten() {
            if !self.operand(condition, visit)?.is_true() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn must_be_writable(&self, id: NodeId, visit: &mut Visit<'_>) -> Result<()> {
        let name = || self.nodes[id].name.clone();
        match self.access(id, visit)? {
            Access::ReadWrite | Access::WriteOnly => {}
            Access::NotAvailable => return Err(FeatureError::NotAvailable(name())),
            Access::ReadOnly => {
                return Err(if self.is_locked(id, visit)? {
                    FeatureError::Locked(name())
                } else {
                    FeatureError::ReadOnly(name())
                });
            }
        }
        Ok(())
    }

    fn is_locked(&self, id: NodeId, visit: &mut Visit<'_>) -> Result<bool> {
        match &self.nodes[id].conditions.locked {
            Some(locked) => Ok(self.operand(locked, visit)?.is_true()),
            None => Ok(false),
        }
    }

    /// What may be done with a node: its own conditions, what is imposed, and what its source allows.
    fn access(&self, id: NodeId, visit: &mut Visit<'_>) -> Result<Access> {
        self.enter(id, 1, visit, |this, visit| {
            let node = &this.nodes[id];
            if !this.is_there(&node.conditions, visit)? {
                return Ok(Access::NotAvailable);
            }
            let mut access = node.imposed.unwrap_or(Access::ReadWrite);
            if this.is_locked(id, visit)? {
                access = access.and(Access::ReadOnly);
            }
            let own = match &node.kind {
                Kind::IntRegister(r, _)
                | Kind::FloatRegister(r)
                | Kind::TextRegister(r)
                | Kind::RawRegister(r) => {
                    if r.in_device {
                        r.access.unwrap_or(Access::ReadWrite)
                    } else {
                        Access::NotAvailable
                    }
                }
                Kind::Integer(source, _)
                | Kind::Float(source, _)
                | Kind::Enumeration(source, _)
                | Kind::Text(source, _)
                | Kind::Command { target: source, .. }
                | Kind::Boolean { target: source, .. } => match this.target(source, visit)? {
                    Some(Operand::Node(next)) => this.access(next, visit)?,
                    Some(Operand::Missing(_)) => Access::NotAvailable,
                    Some(Operand::Constant(_)) | None => Access::ReadWrite,
                },
                Kind::Converter { target: Some(Operand::Node(next)), .. } => this.access(*next, visit)?,
                Kind::Knife(_) | Kind::Converter { .. } | Kind::Category(_) => Access::ReadOnly,
                Kind::Port | Kind::Other | Kind::Broken(_) => Access::NotAvailable,
            };
            Ok(access.and(own))
        })
    }

    /// Runs `work` one level deeper.
    fn enter<'m, T>(
        &self,
        id: NodeId,
        levels: usize,
        visit: &mut Visit<'m>,
        work: impl FnOnce(&Self, &mut Visit<'m>) -> Result<T>,
    ) -> Result<T> {
        visit.depth += levels;
        visit.visits += 1;
        if visit.depth > MAX_DEPTH || visit.visits > MAX_VISITS {
            let what = "its nodes refer to each other in a circle, or without end".to_owned();
            return Err(FeatureError::Broken { node: self.nodes[id].name.clone(), what });
        }
        let result = work(self, visit);
        visit.depth -= levels;
        result
    }

    fn operand(&self, operand: &Operand, visit: &mut Visit<'_>) -> Result<Number> {
        match operand {
            Operand::Constant(number) => Ok(*number),
            Operand::Node(id) => self.number(*id, visit),
            Operand::Missing(name) => {
                Err(FeatureError::Broken { node: name.clone(), what: "it is not defined".to_owned() })
            }
        }
    }

    /// Which operand a node has its value from now.
    fn target(&self, source: &Source, visit: &mut Visit<'_>) -> Result<Option<Operand>> {
        let Some(index) = &source.index else { return Ok(source.value.clone()) };
        let index = self.operand(index, visit)?.int();
        let found = source.indexed.iter().find(|(i, _)| *i == index).map(|(_, operand)| operand);
        Ok(found.or(source.default.as_ref()).or(source.value.as_ref()).cloned())
    }

    fn source(&self, id: NodeId, source: &Source, visit: &mut Visit<'_>) -> Result<Number> {
        if let Some(local) = self.locals.get(&id) {
            return Ok(*local);
        }
        match self.target(source, visit)? {
            Some(operand) => self.operand(&operand, visit),
            None => Ok(Number::Int(0)),
        }
    }

    /// The value of a node as a number.
    fn number(&self, id: NodeId, visit: &mut Visit<'_>) -> Result<Number> {
        // A level of nodes takes some frames of the stack, a formula one for each of its levels.
        self.enter(id, 16, visit, |this, visit| match &this.nodes[id].kind {
            Kind::Integer(source, _) | Kind::Enumeration(source, _) => {
                this.source(id, source, visit).map(|n| Number::Int(n.int()))
            }
            Kind::Float(source, _) => this.source(id, source, visit).map(|n| Number::Float(n.float())),
            Kind::Command { target, .. } => this.source(id, target, visit),
            Kind::Boolean { target, on, .. } => {
                this.source(id, target, visit).map(|n| Number::Int((n.int() == *on).into()))
            }
            Kind::IntRegister(register, bits) => {
                let bytes = this.read(id, register, visit)?;
                Ok(Number::Int(decode(&bytes, register.big_endian, *bits)))
            }
            Kind::FloatRegister(register) => {
                let mut bytes = this.read(id, register, visit)?;
                if register.big_endian {
                    bytes.reverse();
                }
                let four = <[u8; 4]>::try_from(bytes.as_slice()).map(|b| f64::from(f32::from_le_bytes(b)));
                let eight = || <[u8; 8]>::try_from(bytes.as_slice()).map(f64::from_le_bytes);
                four.or_else(|_| eight())
                    .map(Number::Float)
                    .map_err(|_| this.broken(id, "a float register has 4 or 8 bytes"))
            }
            Kind::Knife(knife) => this.knife(id, knife, Number::Int(0), visit),
            Kind::Converter { from, target, .. } => {
                let target = target.clone().ok_or_else(|| this.broken(id, "<pValue> is missing"))?;
                let raw = this.operand(&target, visit)?;
                this.knife(id, from, raw, visit)
            }
            Kind::Broken(what) => Err(this.broken(id, what)),
            Kind::Category(_)
            | Kind::TextRegister(_)
            | Kind::RawRegister(_)
            | Kind::Text(..)
            | Kind::Port
            | Kind::Other => Err(this.broken(id, "a number is wanted of a node that has none")),
        })
    }

    fn broken(&self, id: NodeId, what: impl Into<String>) -> FeatureError {
        FeatureError::Broken { node: self.nodes[id].name.clone(), what: what.into() }
    }

    fn knife(&self, id: NodeId, knife: &Knife, input: Number, visit: &mut Visit<'_>) -> Result<Number> {
        let Some(last) = knife.formulas.len().checked_sub(1) else {
            return Err(self.broken(id, "no formula"));
        };
        let value = self.formula(id, knife, last, input, visit)?;
        Ok(if knife.float { Number::Float(value.float()) } else { Number::Int(value.int()) })
    }

    fn formula(
        &self,
        id: NodeId,
        knife: &Knife,
        place: usize,
        input: Number,
        visit: &mut Visit<'_>,
    ) -> Result<Number> {
        let bound = &knife.formulas[place];
        self.enter(id, bound.formula.depth(), visit, |this, visit| {
            let range = |id: NodeId, visit: &mut Visit<'_>| {
                this.range(id, visit)?.ok_or_else(|| this.broken(id, "it has no range"))
            };
            bound.formula.value(knife.float, &mut |index| match &bound.variables[index] {
                Variable::Operand(operand) => this.operand(operand, visit),
                Variable::Input => Ok(input),
                Variable::Expression(before) => this.formula(id, knife, *before, input, visit),
                Variable::Min(id) => range(*id, visit).map(|r| r.min),
                Variable::Max(id) => range(*id, visit).map(|r| r.max),
                Variable::Increment(id) => range(*id, visit).map(|r| Number::Int(r.increment.unwrap_or(1))),
                Variable::Entry(id, entry) => match &this.nodes[*id].kind {
                    Kind::Enumeration(_, entries) => entries
                        .iter()
                        .find(|e| e.name == *entry)
                        .map(|e| Number::Int(e.value))
                        .ok_or_else(|| this.broken(*id, format!("it has no entry {entry}"))),
                    _ => Err(this.broken(*id, "it has no entries")),
                },
            })
        })
    }

    /// The range of a number: its own limits, else those of what it takes its value from.
    fn range(&self, id: NodeId, visit: &mut Visit<'_>) -> Result<Option<Range>> {
        self.enter(id, 16, visit, |this, visit| match &this.nodes[id].kind {
            Kind::Integer(source, limits) | Kind::Float(source, limits) => {
                let below = match this.target(source, visit)? {
                    Some(Operand::Node(next)) => this.range(next, visit)?,
                    _ => None,
                };
                let min = limits.min.as_ref().map(|o| this.operand(o, visit)).transpose()?;
                let max = limits.max.as_ref().map(|o| this.operand(o, visit)).transpose()?;
                let increment = limits.increment.as_ref().map(|o| this.operand(o, visit)).transpose()?;
                let is_float = matches!(this.nodes[id].kind, Kind::Float(..));
                let (least, most) = if is_float {
                    (Number::Float(f64::MIN), Number::Float(f64::MAX))
                } else {
                    (Number::Int(i64::MIN), Number::Int(i64::MAX))
                };
                Ok(Some(Range {
                    min: min.or(below.map(|r| r.min)).unwrap_or(least),
                    max: max.or(below.map(|r| r.max)).unwrap_or(most),
                    increment: increment.map(Number::int).or(below.and_then(|r| r.increment)),
                }))
            }
            Kind::IntRegister(register, bits) => {
                let length = this.length(id, register, visit)?;
                let width = bits.mask.map_or(length as u32 * 8, |(a, b)| a.abs_diff(b) + 1).min(64);
                let (min, max) = if bits.signed {
                    let half = 1_i64.checked_shl(width - 1).unwrap_or(i64::MIN);
                    (half.wrapping_neg(), half.wrapping_sub(1))
                } else {
                    (0, if width >= 63 { i64::MAX } else { (1_i64 << width) - 1 })
                };
                Ok(Some(Range { min: Number::Int(min), max: Number::Int(max), increment: None }))
            }
            Kind::Converter { from, target: Some(Operand::Node(next)), .. } => {
                let Some(raw) = this.range(*next, visit)? else { return Ok(None) };
                let a = this.knife(id, from, raw.min, visit)?;
                let b = this.knife(id, from, raw.max, visit)?;
                let (min, max) = if a.float() <= b.float() { (a, b) } else { (b, a) };
                Ok(Some(Range { min, max, increment: None }))
            }
            _ => Ok(None),
        })
    }

    fn length(&self, id: NodeId, register: &Register, visit: &mut Visit<'_>) -> Result<usize> {
        let length = match &register.length {
            Some(operand) => self.operand(operand, visit)?.int(),
            None => 4,
        };
        if (1..=MAX_REGISTER).contains(&length) {
            Ok(length as usize)
        } else {
            Err(self.broken(id, format!("a register cannot have {length} bytes")))
        }
    }

    fn address(&self, register: &Register, visit: &mut Visit<'_>) -> Result<u64> {
        let mut address = register.fixed;
        for part in &register.parts {
            address = address.wrapping_add(self.operand(part, visit)?.int().cast_unsigned());
        }
        for index in &register.indices {
            let (i, by) =
                (self.operand(&index.index, visit)?.int(), self.operand(&index.offset, visit)?.int());
            address = address.wrapping_add(i.wrapping_mul(by).cast_unsigned());
        }
        Ok(address)
    }

    fn read(&self, id: NodeId, register: &Register, visit: &mut Visit<'_>) -> Result<Vec<u8>> {
        if !register.in_device {
            return Err(FeatureError::NotAvailable(self.nodes[id].name.clone()));
        }
        let mut bytes = vec![0; self.length(id, register, visit)?];
        let address = self.address(register, visit)?;
        visit.memory.read(address, &mut bytes)?;
        Ok(bytes)
    }

    fn text(&self, id: NodeId, visit: &mut Visit<'_>) -> Result<String> {
        self.enter(id, 1, visit, |this, visit| match &this.nodes[id].kind {
            Kind::TextRegister(register) => {
                let bytes = this.read(id, register, visit)?;
                let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
                Ok(String::from_utf8_lossy(&bytes[..end]).into_owned())
            }
            Kind::Text(Source { value: Some(Operand::Node(next)), .. }, _) => this.text(*next, visit),
            Kind::Text(_, constant) => Ok(constant.clone()),
            _ => Err(this.broken(id, "text is wanted of a node that has none")),
        })
    }

    fn put_text(&mut self, id: NodeId, value: &str, visit: &mut Visit<'_>) -> Result<()> {
        let mut at = id;
        for _ in 0..16 {
            match &self.nodes[at].kind {
                Kind::Text(Source { value: Some(Operand::Node(next)), .. }, _) => at = *next,
                Kind::TextRegister(register) => {
                    let mut bytes = vec![0; self.length(at, register, visit)?];
                    if value.len() >= bytes.len() {
                        let wanted = "a shorter text";
                        return Err(self.wrong_type(&self.nodes[id].name, wanted, value));
                    }
                    bytes[..value.len()].copy_from_slice(value.as_bytes());
                    let address = self.address(register, visit)?;
                    return Ok(visit.memory.write(address, &bytes)?);
                }
                _ => return Err(FeatureError::ReadOnly(self.nodes[id].name.clone())),
            }
        }
        Err(self.broken(id, "its nodes refer to each other in a circle"))
    }

    fn put_checked(&mut self, id: NodeId, value: Number, visit: &mut Visit<'_>) -> Result<()> {
        if let Some(range) = self.range(id, visit)? {
            let too_small = value.float() < range.min.float();
            let too_large = value.float() > range.max.float();
            let off_step = match (value, range.increment) {
                (Number::Int(v), Some(step)) if step > 1 => v.wrapping_sub(range.min.int()) % step != 0,
                _ => false,
            };
            if too_small || too_large || off_step {
                return Err(FeatureError::OutOfRange {
                    name: self.nodes[id].name.clone(),
                    value: value.to_string(),
                    min: range.min.to_string(),
                    max: range.max.to_string(),
                    increment: range.increment,
                });
            }
        }
        self.put(id, value, visit, false)
    }

    /// Writes a number to where a node has its value.
    fn put(&mut self, id: NodeId, value: Number, visit: &mut Visit<'_>, once: bool) -> Result<()> {
        visit.visits += 1;
        if visit.visits > MAX_VISITS {
            return Err(self.broken(id, "its nodes refer to each other in a circle"));
        }
        let (source, value) = match &self.nodes[id].kind {
            Kind::Integer(source, _) => (source.clone(), Number::Int(value.int())),
            Kind::Enumeration(source, _) | Kind::Command { target: source, .. } => (source.clone(), value),
            Kind::Float(source, _) => (source.clone(), Number::Float(value.float())),
            Kind::Boolean { target, on, off } => {
                (target.clone(), Number::Int(if value.is_true() { *on } else { *off }))
            }
            Kind::Converter { to, target, .. } => {
                let raw = self.knife(id, to, value, visit)?;
                let target = target.clone();
                (Source { value: target, ..Source::default() }, raw)
            }
            Kind::IntRegister(register, bits) => {
                let (register, bits) = (register.clone(), *bits);
                return self.put_integer(id, &register, bits, value, visit, once);
            }
            Kind::FloatRegister(register) => {
                let length = self.length(id, register, visit)?;
                let mut bytes = match length {
                    4 => (value.float() as f32).to_le_bytes().to_vec(),
                    8 => value.float().to_le_bytes().to_vec(),
                    _ => return Err(self.broken(id, "a float register has 4 or 8 bytes")),
                };
                if register.big_endian {
                    bytes.reverse();
                }
                let address = self.address(register, visit)?;
                return Ok(visit.memory.write(address, &bytes)?);
            }
            _ => return Err(FeatureError::ReadOnly(self.nodes[id].name.clone())),
        };
        match self.target(&source, visit)? {
            Some(Operand::Node(next)) => {
                // Converters and floats may end in an integer: the nearest one counts.
                let whole = matches!(self.nodes[next].kind, Kind::Integer(..) | Kind::IntRegister(..));
                let value = match value {
                    Number::Float(f) if whole => Number::Int(f.round() as i64),
                    other => other,
                };
                self.put(next, value, visit, once)?;
                for copy in source.copies {
                    if let Operand::Node(copy) = copy {
                        self.put(copy, value, visit, once)?;
                    }
                }
                Ok(())
            }
            Some(Operand::Missing(name)) => {
                Err(FeatureError::Broken { node: name, what: "it is not defined".to_owned() })
            }
            Some(Operand::Constant(_)) | None => {
                self.locals.insert(id, value);
                Ok(())
            }
        }
    }

    fn put_integer(
        &self,
        id: NodeId,
        register: &Register,
        bits: Bits,
        value: Number,
        visit: &mut Visit<'_>,
        once: bool,
    ) -> Result<()> {
        if !register.in_device {
            return Err(FeatureError::NotAvailable(self.nodes[id].name.clone()));
        }
        let length = self.length(id, register, visit)?;
        if length > 8 {
            return Err(self.broken(id, "an integer register has at most 8 bytes"));
        }
        let value = value.int().cast_unsigned();
        let whole = match place(length, register.big_endian, bits) {
            Some((low, width)) => {
                // The other bits of the register belong to other features: they stay.
                let old = if register.access == Some(Access::WriteOnly) {
                    0
                } else {
                    decode(&self.read(id, register, visit)?, register.big_endian, Bits::default())
                        .cast_unsigned()
                };
                let mask = mask(width) << low;
                (old & !mask) | ((value << low) & mask)
            }
            None => value,
        };
        let mut bytes = whole.to_le_bytes()[..length].to_vec();
        if register.big_endian {
            bytes.reverse();
        }
        let address = self.address(register, visit)?;
        Ok(if once { visit.memory.write_once(address, &bytes) } else { visit.memory.write(address, &bytes) }?)
    }
}

const fn mask(width: u32) -> u64 {
    if width >= 64 { u64::MAX } else { (1 << width) - 1 }
}

/// Lowest bit and number of bits of a masked register. GenApi counts the bits of a big-endian register
/// from its most significant one.
fn place(length: usize, big_endian: bool, bits: Bits) -> Option<(u32, u32)> {
    let total = u32::try_from(length.min(8)).unwrap_or(8) * 8;
    let (a, b) = bits.mask?;
    let turn = |bit: u32| if big_endian { (total - 1).saturating_sub(bit) } else { bit.min(total - 1) };
    let (low, high) = (turn(a).min(turn(b)), turn(a).max(turn(b)));
    Some((low, high - low + 1))
}

fn decode(bytes: &[u8], big_endian: bool, bits: Bits) -> i64 {
    let mut eight = [0; 8];
    for (slot, byte) in eight.iter_mut().zip(bytes.iter().take(8)) {
        *slot = *byte;
    }
    let length = bytes.len().min(8);
    if big_endian {
        eight[..length].reverse();
    }
    let whole = u64::from_le_bytes(eight);
    let (low, width) = place(length, big_endian, bits).unwrap_or((0, u32::try_from(length).unwrap_or(8) * 8));
    let value = (whole >> low) & mask(width);
    if bits.signed && (1..64).contains(&width) && value >> (width - 1) & 1 == 1 {
        return (value | !mask(width)).cast_signed();
    }
    value.cast_signed()
}

#[cfg(test)]
mod tests;
