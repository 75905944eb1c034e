//! Our own recorded messages as protobuf: each lists its fields once, and that one list writes them,
//! reads them, and describes them in the file, so that the three cannot drift apart.

use std::collections::BTreeMap;

use prost::Message as _;
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

use super::protobuf::{
    Fields, ProtobufError, Value, put_bytes, put_double, put_tag, put_unsigned, put_varint,
};

/// A message that recordings hold as protobuf.
pub trait Recorded: Default {
    /// Its name within the package `netcord`.
    const NAME: &'static str;

    /// Shows each field, with its number and name, to `visitor`, which may read or change it.
    fn fields<V: Visitor>(&mut self, visitor: &mut V);
}

/// Names of an enumeration's codes; the first must be 0.
pub type Names = Vec<(String, u32)>;

/// What is done with each field of a message.
pub trait Visitor {
    /// A `uint64`.
    fn unsigned(&mut self, number: u32, name: &str, value: &mut u64);
    /// A `uint32`.
    fn small(&mut self, number: u32, name: &str, value: &mut u32);
    /// A `double`.
    fn double(&mut self, number: u32, name: &str, value: &mut f64);
    /// A packed list of doubles, of fixed length.
    fn doubles(&mut self, number: u32, name: &str, values: &mut [f64]);
    /// Bytes, of fixed length.
    fn bytes(&mut self, number: u32, name: &str, values: &mut [u8]);
    /// An enumeration of type `type_name`.
    fn code(&mut self, number: u32, name: &str, type_name: &str, names: fn() -> Names, value: &mut u32);
    /// A message.
    fn message<M: Recorded>(&mut self, number: u32, name: &str, value: &mut M);
    /// A list of messages, of which the first `count` are filled.
    fn list<M: Recorded>(&mut self, number: u32, name: &str, items: &mut [M], count: &mut u32);
}

/// The bytes of a message.
pub fn encode<M: Recorded + Copy>(message: &M) -> Vec<u8> {
    let mut encoder = Encoder { out: Vec::with_capacity(512) };
    // Visitors may change fields; this one does not.
    let mut copy = *message;
    copy.fields(&mut encoder);
    encoder.out
}

/// A message from its bytes. Fields that it does not know are left out.
///
/// # Errors
/// [`ProtobufError`] when the bytes are no message.
pub fn decode<M: Recorded>(bytes: &[u8]) -> Result<M, ProtobufError> {
    let mut decoder = Decoder { fields: Fields::of(bytes).collect::<Result<_, _>>()?, failed: None };
    let mut message = M::default();
    message.fields(&mut decoder);
    decoder.failed.map_or(Ok(message), Err)
}

/// The `FileDescriptorSet` of a message and all that it holds, as MCAP wants schemas of protobuf.
pub fn describe<M: Recorded>() -> Vec<u8> {
    let mut describer = Describer::default();
    describer.add::<M>();
    let file = FileDescriptorProto {
        name: Some(format!("netcord/{}.proto", M::NAME)),
        package: Some("netcord".into()),
        message_type: describer.messages.into_values().collect(),
        enum_type: describer.enums.into_values().collect(),
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    };
    FileDescriptorSet { file: vec![file] }.encode_to_vec()
}

struct Encoder {
    out: Vec<u8>,
}

impl Encoder {
    fn nested<M: Recorded>(&mut self, number: u32, value: &mut M) {
        let mut inner = Encoder { out: Vec::new() };
        value.fields(&mut inner);
        put_bytes(&mut self.out, number, &inner.out);
    }
}

impl Visitor for Encoder {
    fn unsigned(&mut self, number: u32, _: &str, value: &mut u64) {
        put_unsigned(&mut self.out, number, *value);
    }

    fn small(&mut self, number: u32, _: &str, value: &mut u32) {
        put_unsigned(&mut self.out, number, u64::from(*value));
    }

    fn double(&mut self, number: u32, _: &str, value: &mut f64) {
        put_double(&mut self.out, number, *value);
    }

    fn doubles(&mut self, number: u32, _: &str, values: &mut [f64]) {
        put_tag(&mut self.out, number, 2);
        put_varint(&mut self.out, 8 * values.len() as u64);
        self.out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    }

    fn bytes(&mut self, number: u32, _: &str, values: &mut [u8]) {
        put_bytes(&mut self.out, number, values);
    }

    fn code(&mut self, number: u32, _: &str, _: &str, _: fn() -> Names, value: &mut u32) {
        put_unsigned(&mut self.out, number, u64::from(*value));
    }

    fn message<M: Recorded>(&mut self, number: u32, _: &str, value: &mut M) {
        self.nested(number, value);
    }

    fn list<M: Recorded>(&mut self, number: u32, _: &str, items: &mut [M], count: &mut u32) {
        for item in items.iter_mut().take(*count as usize) {
            self.nested(number, item);
        }
    }
}

struct Decoder<'a> {
    fields: Vec<(u32, Value<'a>)>,
    failed: Option<ProtobufError>,
}

impl<'a> Decoder<'a> {
    fn all(&self, number: u32) -> impl Iterator<Item = Value<'a>> {
        self.fields.iter().filter(move |(n, _)| *n == number).map(|(_, value)| *value)
    }

    /// The last one counts, as protobuf has it.
    fn last(&self, number: u32) -> Option<Value<'a>> {
        self.all(number).last()
    }

    fn nested<M: Recorded>(&mut self, value: Value<'_>) -> Option<M> {
        match decode(value.bytes()?) {
            Ok(message) => Some(message),
            Err(e) => {
                self.failed = Some(e);
                None
            }
        }
    }
}

impl Visitor for Decoder<'_> {
    fn unsigned(&mut self, number: u32, _: &str, value: &mut u64) {
        *value = self.last(number).and_then(Value::unsigned).unwrap_or_default();
    }

    fn small(&mut self, number: u32, _: &str, value: &mut u32) {
        let wide = self.last(number).and_then(Value::unsigned).unwrap_or_default();
        *value = u32::try_from(wide).unwrap_or_default();
    }

    fn double(&mut self, number: u32, _: &str, value: &mut f64) {
        *value = self.last(number).and_then(Value::unsigned).map_or(0.0, f64::from_bits);
    }

    fn doubles(&mut self, number: u32, _: &str, values: &mut [f64]) {
        let Some(Value::Bytes { bytes, .. }) = self.last(number) else { return };
        for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(8)) {
            *value = f64::from_le_bytes(bytes.try_into().expect("8 bytes"));
        }
    }

    fn bytes(&mut self, number: u32, _: &str, values: &mut [u8]) {
        let bytes = self.last(number).and_then(Value::bytes).unwrap_or_default();
        for (value, byte) in values.iter_mut().zip(bytes) {
            *value = *byte;
        }
    }

    fn code(&mut self, number: u32, name: &str, _: &str, _: fn() -> Names, value: &mut u32) {
        self.small(number, name, value);
    }

    fn message<M: Recorded>(&mut self, number: u32, _: &str, value: &mut M) {
        if let Some(message) = self.last(number).and_then(|v| self.nested(v)) {
            *value = message;
        }
    }

    fn list<M: Recorded>(&mut self, number: u32, _: &str, items: &mut [M], count: &mut u32) {
        let values = self.all(number).take(items.len()).collect::<Vec<_>>();
        *count = 0;
        for (item, value) in items.iter_mut().zip(values) {
            if let Some(message) = self.nested(value) {
                *item = message;
                *count += 1;
            }
        }
    }
}

#[derive(Default)]
struct Describer {
    messages: BTreeMap<String, DescriptorProto>,
    enums: BTreeMap<String, EnumDescriptorProto>,
    fields: Vec<FieldDescriptorProto>,
}

impl Describer {
    fn add<M: Recorded>(&mut self) {
        if self.messages.contains_key(M::NAME) {
            return;
        }
        let outer = std::mem::take(&mut self.fields);
        M::default().fields(self);
        let field = std::mem::replace(&mut self.fields, outer);
        let message = DescriptorProto { name: Some(M::NAME.into()), field, ..DescriptorProto::default() };
        self.messages.insert(M::NAME.into(), message);
    }

    fn field(&mut self, number: u32, name: &str, kind: Type, label: Label, type_name: Option<&str>) {
        self.fields.push(FieldDescriptorProto {
            name: Some(name.into()),
            number: i32::try_from(number).ok(),
            label: Some(label.into()),
            r#type: Some(kind.into()),
            type_name: type_name.map(|n| format!(".netcord.{n}")),
            ..FieldDescriptorProto::default()
        });
    }
}

impl Visitor for Describer {
    fn unsigned(&mut self, number: u32, name: &str, _: &mut u64) {
        self.field(number, name, Type::Uint64, Label::Optional, None);
    }

    fn small(&mut self, number: u32, name: &str, _: &mut u32) {
        self.field(number, name, Type::Uint32, Label::Optional, None);
    }

    fn double(&mut self, number: u32, name: &str, _: &mut f64) {
        self.field(number, name, Type::Double, Label::Optional, None);
    }

    fn doubles(&mut self, number: u32, name: &str, _: &mut [f64]) {
        self.field(number, name, Type::Double, Label::Repeated, None);
    }

    fn bytes(&mut self, number: u32, name: &str, _: &mut [u8]) {
        self.field(number, name, Type::Bytes, Label::Optional, None);
    }

    fn code(&mut self, number: u32, name: &str, type_name: &str, names: fn() -> Names, _: &mut u32) {
        self.field(number, name, Type::Enum, Label::Optional, Some(type_name));
        // Names of values must be unique in the package: the type's stands before them.
        let prefix = snake(type_name);
        let value = names()
            .into_iter()
            .map(|(name, code)| EnumValueDescriptorProto {
                name: Some(format!("{prefix}_{}", snake(&name))),
                number: i32::try_from(code).ok(),
                ..EnumValueDescriptorProto::default()
            })
            .collect();
        let described =
            EnumDescriptorProto { name: Some(type_name.into()), value, ..EnumDescriptorProto::default() };
        self.enums.insert(type_name.into(), described);
    }

    fn message<M: Recorded>(&mut self, number: u32, name: &str, _: &mut M) {
        self.add::<M>();
        self.field(number, name, Type::Message, Label::Optional, Some(M::NAME));
    }

    fn list<M: Recorded>(&mut self, number: u32, name: &str, _: &mut [M], _: &mut u32) {
        self.add::<M>();
        self.field(number, name, Type::Message, Label::Repeated, Some(M::NAME));
    }
}

/// `dlt-svd` and `NoDetection` as protobuf writes values: `DLT_SVD`, `NO_DETECTION`.
fn snake(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !out.is_empty() && !out.ends_with('_') {
            out.push('_');
        }
        out.push(if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' });
    }
    out
}
