//! How results become exit codes: 0 done, 1 done but something was missed, 2 an error.

use std::{error::Error, process::ExitCode};

use crate::console;

/// What a subcommand ends with when it did not fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// All is as it should be: exit code 0.
    Good,
    /// The work is done, but what it measured or found misses its mark: exit code 1.
    Missed,
}

/// The result of a subcommand. Errors are sentences for the person at the terminal.
pub type CommandResult = Result<Outcome, Box<dyn Error>>;

/// Ends standard output, prints an error with its causes to standard error, and gives the exit code.
pub fn code_of(result: CommandResult) -> ExitCode {
    let result = result.and_then(|outcome| Ok(console::finish().map(|()| outcome)?));
    match result {
        Ok(Outcome::Good) => ExitCode::SUCCESS,
        Ok(Outcome::Missed) => ExitCode::from(1),
        Err(error) => {
            eprintln!("netcord: {error}");
            let mut cause = error.source();
            while let Some(inner) = cause {
                eprintln!("  because: {inner}");
                cause = inner.source();
            }
            ExitCode::from(2)
        }
    }
}
