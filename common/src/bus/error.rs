use thiserror::Error;

/// What can go wrong on the bus.
#[derive(Debug, Error)]
pub enum BusError {
    /// The domain's directory cannot be made or used.
    #[error("the domain's directory {path} cannot be used: {cause}")]
    Directory {
        /// The directory.
        path: String,
        /// Why.
        cause: std::io::Error,
    },
    /// This process could not join the domain.
    #[error("cannot join the domain {domain}: {cause}")]
    Join {
        /// The domain.
        domain: String,
        /// iceoryx2's reason.
        cause: String,
    },
    /// A peer of another version of netcord has created the service.
    #[error(
        "the service {service} is in use by a netcord of another wire version (this one has {ours}): \
         stop the older processes of this domain and start all from one version"
    )]
    WireVersion {
        /// The service.
        service: String,
        /// The version of this process.
        ours: u32,
    },
    /// Another process already writes this service.
    #[error("the service {service} already has its writer: another `netcord {writer}` runs in this domain")]
    SecondWriter {
        /// The service.
        service: String,
        /// The subcommand that writes it.
        writer: &'static str,
    },
    /// More peers than the service's limits allow.
    #[error("the service {service} has no place for one more {what} (limit {limit})")]
    TooMany {
        /// The service.
        service: String,
        /// `reader`, `writer` or `process`.
        what: &'static str,
        /// The limit.
        limit: usize,
    },
    /// Shared memory is used up, or too small.
    #[error(
        "no shared memory left for the service {service}, which needs {needed_mb:.0} MB: {free_mb:.0} MB are free in \
         /dev/shm; stop other rigs, or enlarge it with `mount -o remount,size=…` ({cause})"
    )]
    NoMemory {
        /// The service.
        service: String,
        /// What the service needs.
        needed_mb: f64,
        /// What is free.
        free_mb: f64,
        /// iceoryx2's reason.
        cause: String,
    },
    /// All frame slots are in the hands of readers.
    #[error("no free frame slot in {service}: its readers hold all of them")]
    NoSlot {
        /// The service.
        service: String,
    },
    /// A frame larger than the service was made for.
    #[error("a frame of {bytes} bytes does not fit the slots of {service}, which hold {slot} bytes")]
    FrameTooLarge {
        /// The service.
        service: String,
        /// What was asked for.
        bytes: usize,
        /// What a slot holds.
        slot: usize,
    },
    /// A request got no answer.
    #[error("no answer on {service} within {timeout_ms} ms: is `netcord capture` running in this domain?")]
    NoAnswer {
        /// The service.
        service: String,
        /// How long was waited.
        timeout_ms: u128,
    },
    /// Anything else of iceoryx2's.
    #[error("the service {service} failed while {doing}: {cause}")]
    Service {
        /// The service.
        service: String,
        /// What was being done.
        doing: &'static str,
        /// iceoryx2's reason.
        cause: String,
    },
}
