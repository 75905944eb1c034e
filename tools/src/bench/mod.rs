//! What `netcord bench` measures: kernels beside the machine's floor, the transport, the whole pipeline.

mod floor;
mod frames;
mod kernels;
mod median;
mod pipeline;
mod prediction;
mod spectator;
mod transport;
mod triangulation;
mod viewing;

pub use floor::sum_bytes;
pub use frames::FrameRing;
pub use kernels::measure_kernels;
pub use median::median;
pub use pipeline::{measure_ladder, measure_record_effect, measure_recovery};
pub use prediction::measure_prediction;
pub use transport::{measure_transport, serve_reader};
pub use triangulation::measure_triangulation;
pub use viewing::measure_view_effect;
