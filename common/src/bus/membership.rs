use std::{fs, path::PathBuf, sync::Arc};

use iceoryx2::{
    config::Config,
    node::{Node, NodeBuilder, NodeState, NodeView as _},
    prelude::{CallbackProgression, FileName, Path, SemanticString, SignalHandlingMode},
    service::attribute::AttributeVerifier,
};

use super::{
    BusError, Service, Topic,
    messages::{Publisher, Subscriber},
};
use crate::{
    name::DomainName,
    wire::{Message, WIRE_VERSION},
};

/// Key of the attribute that every service carries, so that peers of two wire versions are told apart
/// by more than the size of their messages.
const VERSION_KEY: &str = "netcord-wire-version";

/// A process's membership of one domain. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Bus {
    pub(super) node: Arc<Node<Service>>,
    domain: DomainName,
    wire_version: u32,
}

/// The files of a domain that no process lives in any more.
#[derive(Debug)]
pub struct DomainRemains {
    domain: DomainName,
}

/// Where iceoryx2 keeps a domain's service and node files (not its payloads: those are in /dev/shm). Sockets are
/// among them, whose paths the system bounds: the folder has a short name, which is a hash (FNV-1a) of the
/// domain's; the files in it begin with the domain itself.
fn root(domain: &DomainName) -> PathBuf {
    let hash = domain
        .as_str()
        .bytes()
        .fold(0x811c_9dc5_u32, |hash, b| (hash ^ u32::from(b)).wrapping_mul(0x0100_0193));
    std::env::temp_dir().join("netcord").join(format!("{hash:08x}"))
}

/// Longest path of a socket (`sun_path` without its end), bytes.
const LONGEST_SOCKET: usize = 107;
/// What iceoryx2 adds to the prefix of an event's socket: a number of up to 32 digits and a suffix, bytes.
const SOCKET_SUFFIX: usize = 32 + ".event".len();

/// Prefix of a domain's names in /dev/shm.
fn prefix(domain: &DomainName) -> String {
    format!("netcord_{domain}_")
}

fn config(domain: &DomainName) -> Result<Config, BusError> {
    let root = root(domain);
    fs::create_dir_all(&root)
        .map_err(|cause| BusError::Directory { path: root.display().to_string(), cause })?;
    let join = |cause: String| BusError::Join { domain: domain.to_string(), cause };
    let mut config = Config::default();
    let path = root.to_string_lossy();
    let length = path.len() + 1 + prefix(domain).len() + SOCKET_SUFFIX;
    if length > LONGEST_SOCKET {
        return Err(join(format!(
            "the paths of its sockets in {path} would have up to {length} bytes, and the system allows \
             {LONGEST_SOCKET}: choose a shorter name (--domain) or a shorter temporary folder (TMPDIR)"
        )));
    }
    config.global.set_root_path(&Path::new(path.as_bytes()).map_err(|e| join(format!("{path}: {e:?}")))?);
    config.global.prefix = FileName::new(prefix(domain).as_bytes()).map_err(|e| join(format!("{e:?}")))?;
    Ok(config)
}

impl Bus {
    /// Joins `domain` as `process` (a stage's or tool's name). Remains of processes that have died
    /// there are cleaned up on the way.
    ///
    /// # Errors
    /// [`BusError::Directory`] and [`BusError::Join`].
    pub fn join(domain: &DomainName, process: &str) -> Result<Self, BusError> {
        let join = |cause: String| BusError::Join { domain: domain.to_string(), cause };
        let config = config(domain)?;
        let name = process.try_into().map_err(|e| join(format!("{e:?}")))?;
        let node = NodeBuilder::new()
            .config(&config)
            .name(&name)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Service>()
            .map_err(|e| join(format!("{e:?}")))?;
        Ok(Self { node: Arc::new(node), domain: domain.clone(), wire_version: WIRE_VERSION })
    }

    /// As [`Self::join`], claiming to speak another wire version: for tests that play an older peer.
    #[doc(hidden)]
    pub fn join_with_wire_version(
        domain: &DomainName,
        process: &str,
        wire_version: u32,
    ) -> Result<Self, BusError> {
        Ok(Self { wire_version, ..Self::join(domain, process)? })
    }

    /// The domain.
    pub const fn domain(&self) -> &DomainName {
        &self.domain
    }

    /// Reclaims what processes that died have left in the domain: their ports and memory. Returns how
    /// many processes that were.
    pub fn clean_up_dead(&self) -> u64 {
        self.node.try_cleanup_dead_nodes().cleanups
    }

    /// Opens the writing end of `topic`.
    ///
    /// # Errors
    /// [`BusError::SecondWriter`], [`BusError::WireVersion`], [`BusError::NoMemory`] and
    /// [`BusError::Service`].
    pub fn publisher<T: Message>(&self, topic: &Topic<T>) -> Result<Publisher<T>, BusError> {
        Publisher::open(self, topic)
    }

    /// Opens a reading end of `topic`.
    ///
    /// # Errors
    /// [`BusError::TooMany`], [`BusError::WireVersion`] and [`BusError::Service`].
    pub fn subscriber<T: Message>(&self, topic: &Topic<T>) -> Result<Subscriber<T>, BusError> {
        Subscriber::open(self, topic)
    }

    pub(super) fn version_wanted(&self) -> AttributeVerifier {
        let version = self.wire_version.to_string();
        AttributeVerifier::new()
            .require(
                &VERSION_KEY.try_into().expect("a short key"),
                &version.as_str().try_into().expect("a short value"),
            )
            .expect("one attribute")
    }
}

impl DomainRemains {
    /// Names the remains of `domain`.
    pub fn of(domain: &DomainName) -> Self {
        Self { domain: domain.clone() }
    }

    /// Removes what is left of the domain in /dev/shm and in its directory; to be called when its last
    /// process has ended. Returns how many files went.
    ///
    /// iceoryx2 leaves one small management segment per domain by design; everything else here is what
    /// processes that died have left.
    ///
    /// # Errors
    /// [`BusError::Directory`] when a file cannot be removed.
    pub fn remove(&self) -> Result<usize, BusError> {
        let mut removed = 0;
        for path in self.files() {
            match fs::remove_file(&path) {
                Ok(()) => removed += 1,
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
                Err(cause) => return Err(BusError::Directory { path: path.display().to_string(), cause }),
            }
        }
        let root = root(&self.domain);
        match fs::remove_dir_all(&root) {
            Ok(()) => {}
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
            Err(cause) => return Err(BusError::Directory { path: root.display().to_string(), cause }),
        }
        // Its parent is shared by all domains: it goes with the last of them.
        if let Some(parent) = root.parent() {
            let _ = fs::remove_dir(parent);
        }
        Ok(removed)
    }

    /// The processes that live in the domain, by the names with which they joined it.
    ///
    /// # Errors
    /// [`BusError::Directory`] and [`BusError::Join`].
    pub fn inhabitants(&self) -> Result<Vec<String>, BusError> {
        let mut names = Vec::new();
        // Each has files there; to ask for more would begin the domain.
        if self.files().is_empty() {
            return Ok(names);
        }
        let listed = Node::<Service>::list(&config(&self.domain)?, |node| {
            if let NodeState::Alive(node) = node {
                let name = node.details().as_ref().map(|details| details.name().to_string());
                names.push(name.unwrap_or_else(|| "a process without a name".into()));
            }
            CallbackProgression::Continue
        });
        listed
            .map_err(|e| BusError::Join { domain: self.domain.to_string(), cause: format!("{e:?}") })
            .map(|()| names)
    }

    /// The domain's files in /dev/shm.
    pub fn files(&self) -> Vec<PathBuf> {
        let prefix = prefix(&self.domain);
        let Ok(entries) = fs::read_dir("/dev/shm") else { return Vec::new() };
        entries
            .flatten()
            .filter(|e| e.file_name().to_string_lossy().starts_with(&prefix))
            .map(|e| e.path())
            .collect()
    }
}
