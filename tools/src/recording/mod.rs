//! What recordings and viewers show of a rig: topics, schemas, boxes in images, the 3D scene.

mod annotations;
pub mod colours;
mod scene;
mod schemas;
mod topics;

pub use annotations::annotations;
pub use scene::{BALL_TOPIC, PATH_TOPIC, Scene, TABLE_TOPIC, world_frame_id};
pub use schemas::{bytes_of, foxglove_schema};
pub use topics::{RigTopics, Wanted};
