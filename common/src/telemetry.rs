//! Log output of a process: level and format by flag and environment, to standard error, never a line
//! per frame.

use std::{
    io::{self, IsTerminal as _},
    str::FromStr,
};

use tracing_subscriber::{EnvFilter, fmt, layer::SubscriberExt, util::SubscriberInitExt};

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line.
    Json,
}

impl FromStr for LogFormat {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "text" => Ok(Self::Text),
            "json" => Ok(Self::Json),
            other => Err(format!("log format {other:?} is not known; valid are text and json")),
        }
    }
}

/// Installs the log output. `filter` is a level or a `tracing-subscriber` directive list, such as
/// `info` or `warn,netcord_capture=debug`. iceoryx2's own lines are left out unless it names them
/// (`info,iceoryx2_bb_loggers=warn`): they describe its structures over pages, and what matters of them
/// comes as an error of ours.
///
/// # Errors
/// A sentence that says what about `filter` is wrong.
pub fn init(filter: &str, format: LogFormat) -> Result<(), String> {
    let directives =
        if filter.contains("iceoryx2") { filter.into() } else { format!("{filter},iceoryx2_bb_loggers=off") };
    let filter = EnvFilter::try_new(directives).map_err(|e| {
        format!("log filter {filter:?} is not valid: {e}; try info, or warn,netcord_capture=debug")
    })?;
    let registry = tracing_subscriber::registry().with(filter);
    let layer = fmt::layer().with_writer(io::stderr).with_ansi(io::stderr().is_terminal()).with_target(false);
    let installed = match format {
        LogFormat::Text => registry.with(layer.compact()).try_init(),
        LogFormat::Json => registry.with(layer.json()).try_init(),
    };
    installed.map_err(|e| format!("log output cannot be installed twice: {e}"))
}
