//! Standard output and standard error, whose reader may leave at any time (`netcord listen | head -1`).
//!
//! `std`'s `println!` panics then. The macros here have its names and take its place in the whole crate: once nobody
//! reads, what is said goes nowhere, and the work goes on and ends in order: files are written, shared memory is
//! given back, services serve. Commands that do nothing but print look at [`is_read`] and end. Any other failure (a
//! disk that is full) is kept, and told at the end by [`finish`].

use std::{
    fmt,
    io::{self, Write as _},
    sync::{Mutex, PoisonError},
};

/// As `std::println!`, but does not panic.
macro_rules! println {
    () => { $crate::console::write(format_args!("\n")) };
    ($($argument:tt)*) => { $crate::console::write(format_args!("{}\n", format_args!($($argument)*))) };
}

/// As `std::print!`, but does not panic.
macro_rules! print {
    ($($argument:tt)*) => { $crate::console::write(format_args!($($argument)*)) };
}

/// As `std::eprintln!`, but does not panic.
macro_rules! eprintln {
    ($($argument:tt)*) => { $crate::console::complain(format_args!($($argument)*)) };
}

/// What became of standard output.
static OUTPUT: Mutex<Output> = Mutex::new(Output { failure: None });

struct Output {
    /// Why nothing more is written.
    failure: Option<io::Error>,
}

impl Output {
    fn attempt(&mut self, write: impl FnOnce(&mut io::StdoutLock<'_>) -> io::Result<()>) {
        if self.failure.is_none() {
            self.failure = write(&mut io::stdout().lock()).err();
        }
    }
}

/// Writes to standard output; nothing where that has failed before.
pub fn write(text: fmt::Arguments<'_>) {
    with_output(|output| output.attempt(|out| out.write_fmt(text)));
}

/// Writes a line to standard error.
pub fn complain(text: fmt::Arguments<'_>) {
    // Nobody is left to tell when standard error is gone.
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Sends on what waits for the end of its line, and tells whether anybody still reads.
pub fn is_read() -> bool {
    with_output(|output| {
        output.attempt(|out| out.flush());
        output.failure.is_none()
    })
}

/// Sends on what waits for the end of its line. A reader that has left has seen enough.
///
/// # Errors
/// What else kept standard output from being written.
pub fn finish() -> Result<(), String> {
    with_output(|output| {
        output.attempt(|out| out.flush());
        match &output.failure {
            Some(e) if e.kind() != io::ErrorKind::BrokenPipe => {
                Err(format!("standard output is not complete: {e}"))
            }
            _ => Ok(()),
        }
    })
}

fn with_output<T>(act: impl FnOnce(&mut Output) -> T) -> T {
    // A panic while it was held changed nothing that matters here.
    act(&mut OUTPUT.lock().unwrap_or_else(PoisonError::into_inner))
}
