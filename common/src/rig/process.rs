use serde::Deserialize;

/// What `netcord up` does when a process ends by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Restart {
    /// It is started again, whatever its exit code.
    #[default]
    Always,
    /// It is started again unless it ended with 0.
    OnFailure,
    /// It stays down.
    Never,
}

/// One process of the rig, as `netcord up` starts it: `netcord <command> <args>`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProcessSpec {
    /// The subcommand.
    pub command: String,
    /// Its arguments, beside the rig and the domain, which `up` adds.
    pub args: Vec<String>,
    /// Processors that it may run on; empty for all.
    pub affinity: Vec<usize>,
    /// SCHED_FIFO priority, 1–99; `None` for the ordinary scheduler.
    pub priority: Option<i32>,
    /// What happens when it ends.
    pub restart: Restart,
}

impl ProcessSpec {
    /// The process `netcord <command>` with nothing special.
    pub fn plain(command: &str) -> Self {
        Self {
            command: command.into(),
            args: Vec::new(),
            affinity: Vec::new(),
            priority: None,
            restart: Restart::Always,
        }
    }

    /// What a rig file without `[[process]]` means: the four stages.
    pub fn stages() -> Vec<Self> {
        ["capture", "segment", "triangulate", "predict"].map(Self::plain).to_vec()
    }
}
