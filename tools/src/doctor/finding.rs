/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grade {
    /// As it should be.
    Good,
    /// Works, but costs latency or may cost frames under load.
    Risk,
    /// Does not work like this.
    Broken,
}

impl Grade {
    /// A word for it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Risk => "risk",
            Self::Broken => "broken",
        }
    }
}

/// One thing looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// How bad it is.
    pub grade: Grade,
    /// What was looked at.
    pub what: &'static str,
    /// What was found.
    pub found: String,
    /// The command or setting that cures it; empty where there is nothing to cure.
    pub cure: String,
}

impl Finding {
    /// All is well.
    pub fn good(what: &'static str, found: impl Into<String>) -> Self {
        Self { grade: Grade::Good, what, found: found.into(), cure: String::new() }
    }

    /// Not well.
    pub fn bad(grade: Grade, what: &'static str, found: impl Into<String>, cure: impl Into<String>) -> Self {
        Self { grade, what, found: found.into(), cure: cure.into() }
    }
}
