use serde::Deserialize;

/// Which change of its line is a camera's trigger: of its input, and of the strobe that it gives as master.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum TriggerEdge {
    /// The line rises when the exposure begins.
    #[default]
    Rising,
    /// The line falls when the exposure begins.
    Falling,
}

/// Which instant a camera stamps its frames with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum StampMeaning {
    /// The start of the exposure, as most do.
    #[default]
    ExposureStart,
    /// Its end, where the read-out begins.
    ExposureEnd,
}

/// How a camera's trigger is wired, and what its stamps mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Wiring {
    /// Polarity of its line.
    pub edge: TriggerEdge,
    /// How long the camera shall wait after its trigger, ns.
    pub delay_ns: u64,
    /// Which instant its stamps mean.
    pub stamp: StampMeaning,
}
