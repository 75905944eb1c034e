//! netcord-detect.
