//! A recording as a frame source: any MCAP file with `foxglove.RawImage` topics, at its own pace, faster or
//! slower, or as fast as the segmenter takes it.

mod pacing;
mod source;

pub use pacing::Pace;
pub use source::{ReplayOptions, ReplaySource};
