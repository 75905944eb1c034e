//! netcord.
fn main() {}
