//! netcord-calib.
