//! Recordings: MCAP files with Foxglove's schemas (the design's section on recordings says which).
//!
//! - [`RecordingFile`] visits everything in a file, whole or cut off, with or without an index.
//! - [`Footage`] is what a file holds of cameras: frames, calibration, poses, truth; [`group`] puts
//!   together what was exposed together, [`FrameReader`] unpacks pixels ahead.
//! - [`RecordingWriter`] writes files that are whole up to their last chunk at any moment.
//! - [`encode`], [`decode`] and [`describe`] are the protobuf of our own messages.

mod calibration;
mod chunk;
mod error;
mod fields;
mod file;
mod filmed_rig;
mod footage;
mod frames;
mod messages;
mod protobuf;
mod raw_image;
mod records;
#[cfg(test)]
mod tests;
mod triggers;
mod truth;
mod writer;

pub use calibration::{
    RecordedCalibration, TABLE_FRAME, calibration_message, table_from_camera, timestamp, transform_message,
};
pub use error::RecordingError;
pub use fields::{Names, Recorded, Visitor, decode, describe, encode};
pub use file::{Channel, Ending, Item, MessageRef, Place, RecordingFile};
pub use footage::{FilmedCamera, FilmedFrame, Footage, METADATA, camera_topic};
pub use frames::{FramePixels, FrameReader};
pub use protobuf::ProtobufError;
pub use raw_image::RawImage;
pub use triggers::{FilmedTrigger, group};
pub use truth::{RecordedTruth, RecordedView};
pub use writer::{ChannelId, MessageStamps, RecordingWriter, Schema, WriterOptions};
