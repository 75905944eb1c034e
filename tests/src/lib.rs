//! netcord-tests.
