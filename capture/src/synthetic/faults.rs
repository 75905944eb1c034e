use std::str::FromStr;

use netcord_common::{
    CameraName,
    rig::{CameraIndex, Rig},
};
use thiserror::Error;

use super::render::hash;

/// Something that goes wrong on purpose, so that what counts and survives it can be tested.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    kind: FaultKind,
    /// `None`: every camera.
    camera: Option<CameraName>,
    when: When,
}

/// What can go wrong with a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultKind {
    /// It never comes.
    Drop,
    /// It comes so many µs late.
    Delay(u64),
    /// It comes twice.
    Duplicate,
    /// It comes after the next.
    Reorder,
    /// It is exposed so many µs after (or before) the other cameras'.
    Desync(i64),
    /// Only this share of its bytes comes.
    Truncate(f64),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum When {
    Every(u64),
    Probability(f64),
}

/// A fault that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error(
    "fault {text:?} is not valid: {why}; write KIND[,camera=NAME][,every=N|,p=SHARE][,us=MICROSECONDS][,share=SHARE] \
     with KIND one of drop, delay, duplicate, reorder, desync, truncate"
)]
pub struct FaultError {
    text: String,
    why: String,
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let wrong = |why: String| FaultError { text: text.to_owned(), why };
        let mut parts = text.split(',');
        let kind = parts.next().unwrap_or_default();
        let (mut camera, mut when, mut us, mut share) = (None, When::Every(1), None, None);
        for part in parts {
            let (key, value) = part.split_once('=').ok_or_else(|| wrong(format!("{part:?} has no '='")))?;
            let number = || value.parse::<f64>().map_err(|_| wrong(format!("{value:?} is no number")));
            match key {
                "camera" => camera = Some(CameraName::new(value).map_err(|e| wrong(e.to_string()))?),
                "every" if number()? >= 1.0 => when = When::Every(number()? as u64),
                "p" if (0.0..=1.0).contains(&number()?) => when = When::Probability(number()?),
                "us" if number()?.abs() <= 1e7 => us = Some(number()? as i64),
                "share" if (0.0..1.0).contains(&number()?) => share = Some(number()?),
                "every" | "p" | "us" | "share" => {
                    return Err(wrong(format!("{value} is out of the range of {key}")));
                }
                other => return Err(wrong(format!("{other:?} is not known"))),
            }
        }
        let kind = match kind {
            "drop" => FaultKind::Drop,
            "delay" => FaultKind::Delay(us.unwrap_or(15_000).unsigned_abs()),
            "duplicate" => FaultKind::Duplicate,
            "reorder" => FaultKind::Reorder,
            "desync" => FaultKind::Desync(us.unwrap_or(2_000)),
            "truncate" => FaultKind::Truncate(share.unwrap_or(0.5)),
            other => return Err(wrong(format!("{other:?} is not a kind of fault"))),
        };
        Ok(Self { kind, camera, when })
    }
}

/// What becomes of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fate {
    /// It never comes.
    pub dropped: bool,
    /// How late it comes, ns.
    pub delay_ns: u64,
    /// It comes twice.
    pub duplicated: bool,
    /// It comes after the next.
    pub reordered: bool,
    /// How much later than the others it is exposed, ns.
    pub desync_ns: i64,
    /// The share of its bytes that comes, where not all do.
    pub truncated: Option<f64>,
}

/// The faults of one camera.
#[derive(Debug, Clone, Default)]
pub struct FaultPlan {
    faults: Vec<Fault>,
    seed: u64,
}

impl FaultPlan {
    /// Those of `faults` that are for `camera`.
    pub fn of(faults: &[Fault], rig: &Rig, camera: CameraIndex, seed: u64) -> Self {
        let name = rig.cameras.iter().find(|c| c.index == camera).map(|c| &c.name);
        let mine = |f: &&Fault| f.camera.is_none() || f.camera.as_ref() == name;
        let seed = hash(seed ^ hash(u64::from(camera.code()) + 77));
        Self { faults: faults.iter().filter(mine).cloned().collect(), seed }
    }

    /// What becomes of frame `frame`; the same for the same seed.
    pub fn fate(&self, frame: u64) -> Fate {
        let mut fate = Fate::default();
        for (index, fault) in self.faults.iter().enumerate() {
            let struck = match fault.when {
                When::Every(n) => (frame + 1).is_multiple_of(n),
                When::Probability(p) => {
                    let draw = hash(self.seed ^ hash(frame ^ ((index as u64) << 56)));
                    ((draw >> 11) as f64 / (1_u64 << 53) as f64) < p
                }
            };
            if !struck {
                continue;
            }
            match fault.kind {
                FaultKind::Drop => fate.dropped = true,
                FaultKind::Delay(us) => fate.delay_ns += us * 1000,
                FaultKind::Duplicate => fate.duplicated = true,
                FaultKind::Reorder => fate.reordered = true,
                FaultKind::Desync(us) => fate.desync_ns += us * 1000,
                FaultKind::Truncate(share) => fate.truncated = Some(share),
            }
        }
        fate
    }
}

/// The first fault that names a camera which the rig does not have.
///
/// # Errors
/// [`FaultError`] names it and the cameras that there are.
pub fn check(faults: &[Fault], rig: &Rig) -> Result<(), FaultError> {
    for fault in faults {
        if let Some(name) = &fault.camera
            && rig.camera(name).is_none()
        {
            let names: Vec<_> = rig.cameras.iter().map(|c| c.name.as_str()).collect();
            let why = format!("the rig has no camera {name}; it has {}", names.join(", "));
            return Err(FaultError { text: format!("{:?}", fault.kind), why });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(text: &str) -> FaultPlan {
        FaultPlan { faults: vec![text.parse().expect("valid")], seed: 4 }
    }

    #[test]
    fn faults_strike_every_nth_frame_or_by_chance() {
        let drops = plan("drop,every=10");
        assert_eq!((0..100).filter(|n| drops.fate(*n).dropped).count(), 10);
        let late = plan("delay,p=0.1,us=700");
        let struck = (0..10_000).filter(|n| late.fate(*n).delay_ns == 700_000).count();
        assert!((850..1150).contains(&struck), "{struck} of 10000");
        assert_eq!(plan("desync,us=-800").fate(3).desync_ns, -800_000);
        assert_eq!(plan("truncate,share=0.25").fate(3).truncated, Some(0.25));
    }

    #[test]
    fn what_cannot_be_read_is_named() {
        for (text, part) in [
            ("burn", "\"burn\" is not a kind"),
            ("drop,every=0", "out of the range of every"),
            ("drop,p", "has no '='"),
            ("drop,p=x", "is no number"),
            ("delay,ms=4", "\"ms\" is not known"),
        ] {
            let error = text.parse::<Fault>().expect_err(text);
            assert!(error.to_string().contains(part), "{error}");
        }
    }
}
