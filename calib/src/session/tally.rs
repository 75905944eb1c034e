use std::collections::BTreeMap;

use super::verdict::{Reason, Verdict};

/// Counts what was kept and what was rejected, by reason, for one camera.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    /// Pictures rejected, by the reason's kind.
    pub rejected: BTreeMap<String, u64>,
    last: Option<String>,
}

impl Tally {
    /// Counts one verdict. In a continuous source a reason counts once until it changes: how many looks a person
    /// takes to move the board says nothing.
    pub fn note(&mut self, verdict: &Result<(), Reason>, continuous: bool) {
        let kind = verdict.as_ref().err().map(|r| r.kind().to_owned());
        if let Some(kind) = &kind
            && !(continuous && self.last.as_ref() == Some(kind))
        {
            *self.rejected.entry(kind.clone()).or_default() += 1;
        }
        self.last = kind;
    }

    /// One tally a camera.
    pub fn note_all(tallies: &mut [Self], verdict: &Verdict, continuous: bool) {
        for (tally, verdict) in tallies.iter_mut().zip(&verdict.cameras) {
            if let Some(verdict) = verdict {
                tally.note(verdict, continuous);
            }
        }
    }
}
