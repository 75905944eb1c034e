//! The server that shows emulated cameras to a real USB stack.
