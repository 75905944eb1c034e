use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

/// Counts copies of at least 64 KiB inside processes, by a library that is preloaded into them in place of
/// memcpy and memmove. Built by the C compiler of the machine.
#[derive(Debug)]
pub struct Copies {
    library: PathBuf,
    counts: PathBuf,
}

/// What one process has copied so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CopyCount {
    /// Calls with at least 64 KiB.
    pub calls: u64,
    /// Their bytes.
    pub bytes: u64,
}

impl Copies {
    /// Builds the library in `folder`, where the counts go too.
    ///
    /// # Panics
    /// When there is no C compiler.
    pub fn build(folder: &Path) -> Self {
        let library = folder.join("interposer.so");
        let counts = folder.join("copies");
        fs::create_dir(&counts).expect("a folder for the counts");
        let compiler = env::var_os("CC").unwrap_or_else(|| "cc".into());
        let status = Command::new(&compiler)
            .args(["-O2", "-fno-builtin", "-shared", "-fPIC", "-o"])
            .arg(&library)
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/interposer.c"))
            .status()
            .unwrap_or_else(|e| panic!("no C compiler ({}): {e}", compiler.display()));
        assert!(status.success(), "the interposer does not build");
        Self { library, counts }
    }

    /// A library that was built before, and an empty folder for the counts.
    pub fn with(library: &Path, counts: &Path) -> Self {
        Self { library: library.to_owned(), counts: counts.to_owned() }
    }

    /// Has `command`, and what it starts, count.
    pub fn preload<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command.env("LD_PRELOAD", &self.library).env("NETCORD_COPIES", &self.counts)
    }

    /// What the process `pid` has copied so far.
    ///
    /// # Panics
    /// When it does not count.
    pub fn of(&self, pid: u32) -> CopyCount {
        let path = self.counts.join(pid.to_string());
        let bytes =
            fs::read(&path).unwrap_or_else(|e| panic!("process {pid} does not count its copies: {e}"));
        let number = |at: usize| u64::from_ne_bytes(bytes[at..at + 8].try_into().expect("eight bytes"));
        CopyCount { calls: number(0), bytes: number(8) }
    }
}
