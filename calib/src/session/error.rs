use thiserror::Error;

/// What a session cannot do where it stands.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SessionError {
    /// Not in this phase.
    #[error("cannot {doing} now: the session is at {phase}")]
    Phase {
        /// What was asked.
        doing: &'static str,
        /// Where it stands.
        phase: &'static str,
    },
    /// Nothing kept.
    #[error("no view has been kept yet")]
    NoViews,
    /// Neither views nor marks.
    #[error("neither a view of the board on the table nor a mark of the table has been given yet")]
    NoTable,
    /// Nobody knows where the board lies.
    #[error("say how the board lies on the table first: where its first corner is, and how far it is turned")]
    NoPlace,
    /// No such mark.
    #[error("{0}")]
    Mark(String),
    /// No such shot.
    #[error("there is no view {0:?}")]
    Unknown(String),
}
