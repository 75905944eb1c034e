//! Tests that start real processes. They assert outcomes, not speed; `netcord bench` measures.

mod allocations;
mod copies;
mod demo;
mod faults;
mod imported;
mod kill;
mod learning;
mod pictures;
mod pipes;
mod refusals;
mod replay;
mod scripts;
mod session;
mod up;
