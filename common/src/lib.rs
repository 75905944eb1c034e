//! What all parts of netcord share: messages, the bus, the rig file, the camera model, clocks, counters
//! and telemetry.
//!
//! ```
//! use netcord_common::{geometry::{Camera, Point}, camera::{CameraModel, Distortion}};
//!
//! let camera = CameraModel::new((1920, 1200), (680.0, 680.0), (959.5, 599.5), Distortion::default())?;
//! let pixel = camera.project(&Point::<Camera>::new(0.1, 0.0, 2.0)).expect("in front of the camera");
//! assert!((pixel.x - 993.5).abs() < 1e-9);
//! # Ok::<(), netcord_common::camera::CameraModelError>(())
//! ```

mod allocations;
pub mod board;
pub mod bus;
pub mod camera;
mod counters;
mod frame_view;
pub mod geometry;
mod name;
pub mod picture;
mod pixel;
pub mod realtime;
pub mod rig;
mod shutdown;
pub mod telemetry;
mod time;
pub mod wire;

pub use allocations::{CountingAllocator, allocations};
pub use counters::{Count, Counters, HealthReporter};
pub use frame_view::{FrameView, FrameViewError};
pub use name::{CameraName, DomainName, MAX_NAME_LEN, NameError};
pub use pixel::{Channel, PixelFormat, PixelFormatError};
pub use shutdown::Shutdown;
pub use time::{Clock, ManualClock, MonotonicClock, Stamp, unix_minus_monotonic_ns};
