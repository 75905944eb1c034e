use foxglove::Encode;
use netcord_capture::recording::{Recorded, Schema, describe};

/// The schema of one of Foxglove's messages.
pub fn foxglove_schema<T: Encode>() -> Schema {
    let schema = T::get_schema();
    Schema {
        name: schema.as_ref().map(|s| s.name.clone()).unwrap_or_default(),
        encoding: schema.as_ref().map(|s| s.encoding.clone()).unwrap_or_default(),
        data: schema.map(|s| s.data.into_owned()).unwrap_or_default(),
        message_encoding: T::get_message_encoding(),
    }
}

/// The schema of one of our own messages.
pub fn netcord_schema<M: Recorded>() -> Schema {
    Schema {
        name: format!("netcord.{}", M::NAME),
        encoding: "protobuf".into(),
        data: describe::<M>(),
        message_encoding: "protobuf".into(),
    }
}

/// The schema of `/truth/ball`: JSON that says itself what it is.
pub fn truth_schema() -> Schema {
    const TRUTH: &str = r#"{
  "title": "netcord.BallTruth",
  "type": "object",
  "properties": {
    "trigger_id": {"type": "integer"},
    "t_ns": {"type": "integer", "description": "middle of the exposure"},
    "present": {"type": "boolean"},
    "flight_id": {"type": "integer"},
    "position_m": {"type": "array", "items": {"type": "number"}},
    "velocity_m_s": {"type": "array", "items": {"type": "number"}},
    "spin_rad_s": {"type": "array", "items": {"type": "number"}},
    "cameras": {
      "type": "object",
      "additionalProperties": {
        "type": "object",
        "properties": {
          "u_px": {"type": "number"},
          "v_px": {"type": "number"},
          "visible": {"type": "number", "description": "share of the ball's image that is to be seen"}
        }
      }
    }
  }
}"#;
    Schema {
        name: "netcord.BallTruth".into(),
        encoding: "jsonschema".into(),
        data: TRUTH.as_bytes().to_vec(),
        message_encoding: "json".into(),
    }
}

/// A Foxglove message as bytes.
pub fn bytes_of<T: Encode>(message: &T) -> Vec<u8> {
    let mut out = Vec::with_capacity(message.encoded_len().unwrap_or(256));
    // Encoding into memory that grows cannot fail for want of room, which is its only failure.
    let _ = message.encode(&mut out);
    out
}
