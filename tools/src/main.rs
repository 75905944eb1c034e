//! `netcord`: one executable, each subcommand a process of its own.

// First, so that its macros hold in all that follows.
#[macro_use]
mod console;

mod bench;
mod cli;
mod commands;
mod doctor;
mod exit;
mod observer;
mod output;
mod plot;
mod recording;
mod stage;
mod supervisor;
mod terminal;
mod trial;

use std::process::ExitCode;

use clap::Parser as _;
use netcord_common::CountingAllocator;

/// Counts allocations, so that "none per frame" shows in every process's health.
#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn main() -> ExitCode {
    exit::code_of(cli::Cli::parse().run())
}
