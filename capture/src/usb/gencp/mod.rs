//! GenCP, the control protocol: commands and acknowledges as bytes, the exchange of one command as a
//! state machine without I/O, and the registers that every camera has.
//!
//! Sources: GenCP 1.3 and USB3 Vision 1.2; sections are named where a constant is defined.

mod channel;
mod exchange;
mod manifest;
mod memory;
mod packet;
mod registers;
mod status;
mod zip;

pub use channel::{ControlChannel, ControlPipe, PipeError};
pub use exchange::{Exchange, ExchangeError, Next, Patience, Retry};
pub use manifest::{DescriptionError, Manifest, ManifestEntry, read_description};
pub use memory::{Memory, MemoryError, read_text, read_u32, read_u64};
pub use packet::{Ack, Command, Event, PacketError, parse_ack, parse_event};
pub use registers::{Abrm, Sbrm, Sirm, SirmAddress, TransferSizes};
pub use status::Status;
pub use zip::{ZipError, unzip_single};
