use std::{
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::atomic::{AtomicU32, Ordering},
};

use netcord_common::{
    DomainName,
    bus::{Bus, DomainRemains},
    rig::{Rig, RigEdit},
};
use toml_edit::{Array, ArrayOfTables, DocumentMut, Item, Table, value};

use crate::{Running, executable};

/// A domain and a folder for one test. When it is dropped, nothing of either stays.
#[derive(Debug)]
pub struct Lab {
    folder: tempfile::TempDir,
    domain: DomainName,
}

impl Lab {
    /// A fresh one.
    pub fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        // Relaxed: only uniqueness matters.
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let domain = DomainName::new(format!("test-{}-{number}", std::process::id())).expect("a valid name");
        let folder = tempfile::Builder::new().prefix("netcord-test-").tempdir().expect("a folder");
        Self { folder, domain }
    }

    /// The domain.
    pub const fn domain(&self) -> &DomainName {
        &self.domain
    }

    /// The domain in which a synthetic capture tells the truth.
    pub fn truth_domain(&self) -> DomainName {
        DomainName::new(format!("{}-truth", self.domain)).expect("a valid name")
    }

    /// A path in the lab's folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Joins the lab's domain.
    pub fn bus(&self) -> Bus {
        Bus::join(&self.domain, "test").expect("the domain can be joined")
    }

    /// Writes the two-camera example rig with changes into `rig.toml`.
    pub fn rig_file(&self, change: impl FnOnce(&mut DocumentMut)) -> PathBuf {
        let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
        let path = self.path("rig.toml");
        fs::copy(example, &path).expect("copied");
        let mut edit = RigEdit::open(&path).expect("the example is a rig file");
        edit.document_mut()["name"] = value(self.domain.as_str());
        change(edit.document_mut());
        edit.save().expect("written");
        path
    }

    /// A rig file at `rate_hz` whose capture is the synthetic source with `capture_args`.
    pub fn synthetic_rig(&self, rate_hz: f64, capture_args: &[&str]) -> PathBuf {
        self.rig_file(|document| {
            document["rate_hz"] = value(rate_hz);
            let mut processes = ArrayOfTables::new();
            for command in ["capture", "segment", "triangulate", "predict"] {
                let mut table = Table::new();
                table["command"] = value(command);
                if command == "capture" {
                    let args = ["--source", "synthetic"].iter().chain(capture_args).copied();
                    table["args"] = value(Array::from_iter(args));
                }
                processes.push(table);
            }
            document["process"] = Item::ArrayOfTables(processes);
        })
    }

    /// Loads a rig file that must be valid.
    pub fn load(path: &Path) -> Rig {
        Rig::load(path).expect("a valid rig")
    }

    /// `netcord` with `arguments`, in this lab's domain, not yet started.
    pub fn command<S: AsRef<OsStr>>(&self, arguments: &[S]) -> Command {
        let mut command = Command::new(executable());
        command.args(arguments).env("NETCORD_DOMAIN", self.domain.as_str()).env_remove("NOTIFY_SOCKET");
        command
    }

    /// Starts `netcord` with `arguments` in this lab's domain.
    pub fn start<S: AsRef<OsStr>>(&self, arguments: &[S]) -> Running {
        Running::start(self.command(arguments))
    }

    /// A synthetic rig of 50 Hz under `netcord up`, and its rig file.
    pub fn up(&self) -> (Running, String) {
        let rig = self.synthetic_rig(50.0, &[]).display().to_string();
        (self.start(&["up", &rig, "--quiet"]), rig)
    }

    /// Files that the domain, or its truth, have in shared memory, but for iceoryx2's management segment.
    pub fn shared_memory(&self) -> Vec<PathBuf> {
        [&self.domain, &self.truth_domain()]
            .into_iter()
            .flat_map(|domain| DomainRemains::of(domain).files())
            .filter(|path| !path.to_string_lossy().contains("global_mgmt"))
            .collect()
    }
}

impl Default for Lab {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        for domain in [&self.domain, &self.truth_domain()] {
            // What cannot be removed is left to the test that looks for it.
            let _ = DomainRemains::of(domain).remove();
        }
    }
}
