//! What every process of a rig does around its own work.

use std::{
    error::Error,
    os::{
        linux::net::SocketAddrExt as _,
        unix::net::{SocketAddr, UnixDatagram},
    },
    sync::Arc,
};

use netcord_capture::synthetic::truth_domain;
use netcord_common::{
    Counters, DomainName, Shutdown,
    bus::{Bus, DomainRemains},
    rig::Rig,
};

use crate::{
    commands::RigArgs,
    exit::{CommandResult, Outcome},
};

/// What a process of a rig has at hand.
#[derive(Debug)]
pub struct Stage {
    /// The rig.
    pub rig: Rig,
    /// Membership of its domain.
    pub bus: Bus,
    /// Set by SIGINT and SIGTERM.
    pub stop: Shutdown,
    /// The process's counters.
    pub counters: Arc<Counters>,
}

/// Loads the rig, joins its domain as `process`, and runs `body` until it returns. When the body's
/// counters say `running`, whoever started this process is told so by systemd's protocol
/// (`NOTIFY_SOCKET`: systemd with `Type=notify`, or `netcord up`).
///
/// # Errors
/// What is wrong with the rig file, what the bus refuses, and the body's own.
pub fn run<E: Into<Box<dyn Error>>>(
    process: &str,
    args: &RigArgs,
    body: impl FnOnce(&Stage) -> Result<(), E>,
) -> CommandResult {
    run_with(process, args.load()?, body)
}

/// As [`run`], for a rig that has been loaded in a way of the process's own.
///
/// # Errors
/// What the bus refuses, and the body's own.
pub fn run_with<E: Into<Box<dyn Error>>>(
    process: &str,
    (rig, domain): (Rig, DomainName),
    body: impl FnOnce(&Stage) -> Result<(), E>,
) -> CommandResult {
    let stop = Shutdown::on_signals()?;
    // The rig's own processes may come and go: `up`, or whoever was there first, removes what is left.
    let was_first = DomainRemains::of(&domain).inhabitants()?.is_empty();
    let bus = Bus::join(&domain, process)?;
    let counters = Counters::new();
    counters.when_running(notify_ready);
    let ended = body(&Stage { rig, bus, stop, counters }).map_err(Into::into);
    if was_first {
        for domain in [domain.clone(), truth_domain(&domain)?] {
            let remains = DomainRemains::of(&domain);
            if remains.inhabitants()?.is_empty() {
                remains.remove()?;
            }
        }
    }
    ended.map(|()| Outcome::Good)
}

/// Tells the process's supervisor, if it has one that listens, that it is at work.
pub fn notify_ready() {
    notify("READY=1");
}

/// Tells the process's supervisor that it has begun to stop.
pub fn notify_stopping() {
    notify("STOPPING=1");
}

/// systemd's protocol, sd_notify(3): one datagram to the socket that NOTIFY_SOCKET names, a path or, behind
/// an '@', a name in the abstract namespace.
fn notify(state: &str) {
    let Some(name) = std::env::var_os("NOTIFY_SOCKET") else { return };
    let sent = (|| {
        let address = match name.as_encoded_bytes().strip_prefix(b"@") {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(&name)?,
        };
        UnixDatagram::unbound()?.send_to_addr(state.as_bytes(), &address)
    })();
    if let Err(e) = sent {
        tracing::warn!("the supervisor at {} cannot be told {state}: {e}", name.display());
    }
}
