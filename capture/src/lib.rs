//! netcord-capture.
