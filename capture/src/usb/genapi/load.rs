//! From XML to nodes.

use std::collections::HashMap;

use roxmltree::{Document, Node as Xml, ParsingOptions};

use super::{
    Access, Formula, LoadError, Number,
    node::{
        AddressIndex, Bits, Bound, Conditions, Entry, Kind, Knife, Limits, Node, NodeId, Operand, Register,
        Source, Variable,
    },
};

/// The largest known description has 5 MB.
const MOST_BYTES: usize = 64 << 20;
const MOST_NODES: u32 = 4_000_000;

/// Node elements that can be referred to.
const KINDS: [&str; 19] = [
    "Category",
    "Integer",
    "Float",
    "IntReg",
    "MaskedIntReg",
    "FloatReg",
    "StringReg",
    "Register",
    "String",
    "Enumeration",
    "Command",
    "Boolean",
    "SwissKnife",
    "IntSwissKnife",
    "Converter",
    "IntConverter",
    "Port",
    "StructEntry",
    "Node",
];

#[derive(Debug)]
pub(super) struct Loaded {
    pub(super) nodes: Vec<Node>,
    pub(super) names: HashMap<String, NodeId>,
    pub(super) vendor: String,
    pub(super) model: String,
}

struct Loader<'a, 'x> {
    names: HashMap<String, NodeId>,
    /// Elements in the order of their ids; `None` for what a loader adds (inline formulas).
    elements: Vec<Xml<'a, 'x>>,
    /// Ports of the device.
    device_ports: Vec<String>,
}

/// Reads a description. Text before the first `<` is cut off: some tools write a line there.
pub(super) fn load(text: &str) -> Result<Loaded, LoadError> {
    if text.len() > MOST_BYTES {
        return Err(LoadError::TooLarge(text.len()));
    }
    let text = &text[text.find('<').unwrap_or(0)..];
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MOST_NODES, ..Default::default() };
    let document = Document::parse_with_options(text, options)?;
    let root = document.root_element();
    if root.tag_name().name() != "RegisterDescription" {
        return Err(LoadError::Root(root.tag_name().name().to_owned()));
    }
    let mut loader = Loader { names: HashMap::new(), elements: Vec::new(), device_ports: Vec::new() };
    for element in root.descendants().filter(|e| e.is_element()) {
        let kind = element.tag_name().name();
        if !KINDS.contains(&kind) {
            continue;
        }
        let Some(name) = element.attribute("Name") else { continue };
        if kind == "Port" && child(element, "ChunkID").is_none() && child(element, "EventID").is_none() {
            loader.device_ports.push(name.to_owned());
        }
        // The first of a name counts.
        let id = loader.elements.len();
        loader.names.entry(name.to_owned()).or_insert(id);
        loader.elements.push(element);
    }
    let nodes = loader.elements.iter().map(|element| loader.node(*element)).collect();
    let attribute = |name| root.attribute(name).unwrap_or_default().to_owned();
    Ok(Loaded { nodes, vendor: attribute("VendorName"), model: attribute("ModelName"), names: loader.names })
}

fn children<'a, 'x>(element: Xml<'a, 'x>, name: &str) -> impl Iterator<Item = Xml<'a, 'x>> {
    element.children().filter(move |c| c.is_element() && c.tag_name().name() == name)
}

fn child<'a, 'x>(element: Xml<'a, 'x>, name: &str) -> Option<Xml<'a, 'x>> {
    children(element, name).next()
}

fn text<'a>(element: Xml<'a, '_>) -> &'a str {
    element.text().unwrap_or_default().trim()
}

fn number(element: Xml<'_, '_>) -> Option<Number> {
    Number::parse(text(element))
}

impl Loader<'_, '_> {
    fn refer(&self, name: &str) -> Operand {
        self.names.get(name).map_or_else(|| Operand::Missing(name.to_owned()), |id| Operand::Node(*id))
    }

    /// The constant `name` or the reference `pName`; empty elements count as absent.
    fn operand(&self, element: Xml<'_, '_>, name: &str) -> Option<Operand> {
        let reference = child(element, &format!("p{name}")).map(text).filter(|t| !t.is_empty());
        if let Some(reference) = reference {
            return Some(self.refer(reference));
        }
        child(element, name).and_then(number).map(Operand::Constant)
    }

    fn conditions(&self, element: Xml<'_, '_>) -> Conditions {
        let named = |name| child(element, name).map(text).filter(|t| !t.is_empty()).map(|t| self.refer(t));
        Conditions {
            implemented: named("pIsImplemented"),
            available: named("pIsAvailable"),
            locked: named("pIsLocked"),
        }
    }

    fn node(&self, element: Xml<'_, '_>) -> Node {
        let words = |name| child(element, name).map(text).filter(|t| !t.is_empty()).map(str::to_owned);
        let access = |name| child(element, name).map(text).and_then(Access::parse);
        let kind = self.kind(element).unwrap_or_else(Kind::Broken);
        // A knife is read-only by nature; for registers it is their own matter.
        Node {
            name: element.attribute("Name").unwrap_or_default().to_owned(),
            kind,
            conditions: self.conditions(element),
            imposed: access("ImposedAccessMode"),
            unit: words("Unit"),
            tooltip: words("ToolTip").or_else(|| words("Description")),
            selects: children(element, "pSelected").map(|e| text(e).to_owned()).collect(),
        }
    }

    fn source(&self, element: Xml<'_, '_>) -> Source {
        let indexed = element.children().filter_map(|e| {
            let place = || Number::parse(e.attribute("Index")?).map(Number::int);
            match e.tag_name().name() {
                "ValueIndexed" => Some((place()?, Operand::Constant(number(e)?))),
                "pValueIndexed" => Some((place()?, self.refer(text(e)))),
                _ => None,
            }
        });
        Source {
            value: self.operand(element, "Value"),
            index: child(element, "pIndex").map(|e| self.refer(text(e))),
            indexed: indexed.collect(),
            default: self.operand(element, "ValueDefault"),
            copies: children(element, "pValueCopy").map(|e| self.refer(text(e))).collect(),
        }
    }

    fn limits(&self, element: Xml<'_, '_>) -> Limits {
        Limits {
            min: self.operand(element, "Min"),
            max: self.operand(element, "Max"),
            increment: self.operand(element, "Inc"),
        }
    }

    /// A register's place; entries of a structure share what their parent says.
    fn register(&self, element: Xml<'_, '_>) -> Register {
        let parent = element.parent_element().filter(|p| p.tag_name().name() == "StructReg");
        let sources = [Some(element), parent];
        let find = |name: &str| sources.iter().flatten().find_map(|e| child(*e, name));
        let all = |name: &'static str| sources.into_iter().flatten().flat_map(move |e| children(e, name));
        let fixed =
            all("Address").filter_map(number).fold(0_u64, |sum, n| sum.wrapping_add(n.int().cast_unsigned()));
        let inline = all("IntSwissKnife").filter_map(|e| e.attribute("Name")).map(|name| self.refer(name));
        let indices = all("pIndex").map(|e| {
            let offset = e
                .attribute("Offset")
                .and_then(Number::parse)
                .map(Operand::Constant)
                .or_else(|| e.attribute("pOffset").map(|name| self.refer(name)));
            AddressIndex {
                index: self.refer(text(e)),
                // Without an offset, entries follow each other.
                offset: offset
                    .or_else(|| find("Length").and_then(number).map(Operand::Constant))
                    .unwrap_or(Operand::Constant(Number::Int(0))),
            }
        });
        let length = sources.iter().flatten().find_map(|e| self.operand(*e, "Length"));
        Register {
            fixed,
            parts: all("pAddress").map(|e| self.refer(text(e))).chain(inline).collect(),
            indices: indices.collect(),
            length,
            access: find("AccessMode").map(text).and_then(Access::parse),
            big_endian: find("Endianess").or_else(|| find("Endianness")).map(text) == Some("BigEndian"),
            in_device: find("pPort").is_none_or(|p| self.device_ports.iter().any(|d| d == text(p))),
        }
    }

    fn bits(&self, element: Xml<'_, '_>) -> Bits {
        let parent = element.parent_element().filter(|p| p.tag_name().name() == "StructReg");
        let find = |name: &str| child(element, name).or_else(|| parent.and_then(|p| child(p, name)));
        let place =
            |name: &str| child(element, name).and_then(number).and_then(|n| u32::try_from(n.int()).ok());
        let mask = match (place("Bit"), place("LSB"), place("MSB")) {
            (Some(bit), _, _) => Some((bit, bit)),
            (None, Some(lsb), Some(msb)) => Some((lsb, msb)),
            (None, Some(one), None) | (None, None, Some(one)) => Some((one, one)),
            (None, None, None) => None,
        };
        Bits { mask, signed: find("Sign").map(text) == Some("Signed") }
    }

    fn kind(&self, element: Xml<'_, '_>) -> Result<Kind, String> {
        Ok(match element.tag_name().name() {
            "Category" => {
                Kind::Category(children(element, "pFeature").map(|e| self.refer(text(e))).collect())
            }
            "Integer" => Kind::Integer(self.source(element), self.limits(element)),
            "Float" => Kind::Float(self.source(element), self.limits(element)),
            "IntReg" => Kind::IntRegister(
                self.register(element),
                Bits { mask: None, signed: self.bits(element).signed },
            ),
            "MaskedIntReg" | "StructEntry" => Kind::IntRegister(self.register(element), self.bits(element)),
            "FloatReg" => Kind::FloatRegister(self.register(element)),
            "StringReg" => Kind::TextRegister(self.register(element)),
            "Register" => Kind::RawRegister(self.register(element)),
            "String" => {
                let constant = child(element, "Value").map(text).unwrap_or_default().to_owned();
                let value = child(element, "pValue").map(|e| self.refer(text(e)));
                Kind::Text(Source { value, ..Source::default() }, constant)
            }
            "Enumeration" => {
                let entries = children(element, "EnumEntry").filter_map(|e| {
                    Some(Entry {
                        name: e.attribute("Name")?.to_owned(),
                        value: child(e, "Value").and_then(number)?.int(),
                        conditions: self.conditions(e),
                    })
                });
                Kind::Enumeration(self.source(element), entries.collect())
            }
            "Command" => {
                Kind::Command { target: self.source(element), value: self.operand(element, "CommandValue") }
            }
            "Boolean" => {
                let value = |name| child(element, name).and_then(number).map(Number::int);
                let on = value("OnValue").unwrap_or(1);
                let off = value("OffValue").unwrap_or(0);
                Kind::Boolean { target: self.source(element), on, off }
            }
            kind @ ("SwissKnife" | "IntSwissKnife") => {
                Kind::Knife(self.knife(element, "Formula", kind == "SwissKnife", None)?)
            }
            kind @ ("Converter" | "IntConverter") => {
                let float = kind == "Converter";
                Kind::Converter {
                    to: self.knife(element, "FormulaTo", float, Some("FROM"))?,
                    from: self.knife(element, "FormulaFrom", float, Some("TO"))?,
                    target: child(element, "pValue").map(|e| self.refer(text(e))),
                }
            }
            "Port" => Kind::Port,
            _ => Kind::Other,
        })
    }

    fn knife(
        &self,
        element: Xml<'_, '_>,
        formula: &str,
        float: bool,
        input: Option<&'static str>,
    ) -> Result<Knife, String> {
        let read = |e: Xml<'_, '_>| Formula::parse(text(e)).map_err(|cause| cause.to_string());
        let expressions: Vec<Xml<'_, '_>> = children(element, "Expression").collect();
        let main = child(element, formula).ok_or_else(|| format!("<{formula}> is missing"))?;
        let mut formulas = Vec::new();
        for e in expressions.iter().copied().chain([main]) {
            let formula = read(e)?;
            // An expression may use those before it only: so none can use itself.
            let before = formulas.len();
            let variables = formula
                .variables()
                .iter()
                .map(|name| self.variable(element, &expressions[..before], name, input))
                .collect();
            formulas.push(Bound { formula, variables });
        }
        Ok(Knife { formulas, float })
    }

    fn variable(
        &self,
        element: Xml<'_, '_>,
        expressions: &[Xml<'_, '_>],
        name: &str,
        input: Option<&str>,
    ) -> Variable {
        if Some(name) == input {
            return Variable::Input;
        }
        let named = |e: &Xml<'_, '_>| e.attribute("Name") == Some(name);
        if let Some(constant) = children(element, "Constant").find(named).and_then(number) {
            return Variable::Operand(Operand::Constant(constant));
        }
        if let Some(place) = expressions.iter().position(&named) {
            return Variable::Expression(place);
        }
        let found = children(element, "pVariable").find(named).or_else(|| {
            // NAME.Max may stand in a formula where NAME is declared.
            let base = name.split('.').next().unwrap_or(name);
            children(element, "pVariable").find(|e| e.attribute("Name") == Some(base))
        });
        let Some(found) = found else {
            return Variable::Operand(Operand::Missing(name.to_owned()));
        };
        let target = self.refer(text(found));
        let Operand::Node(id) = target else { return Variable::Operand(target) };
        match name.split_once('.').map(|(_, suffix)| suffix) {
            None | Some("Value") => Variable::Operand(Operand::Node(id)),
            Some("Min") => Variable::Min(id),
            Some("Max") => Variable::Max(id),
            Some("Inc") => Variable::Increment(id),
            Some(entry) => Variable::Entry(
                id,
                entry.strip_prefix("Enum.").or(entry.strip_prefix("Entry.")).unwrap_or(entry).to_owned(),
            ),
        }
    }
}
