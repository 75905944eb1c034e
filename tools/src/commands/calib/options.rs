//! Options of the solver that several actions share.

use std::{path::PathBuf, str::FromStr};

use netcord_calib::solve::{INTRINSIC_NAMES, Loss, MonoOptions};

/// `squares`, `huber:PX` or `cauchy:PX`.
#[derive(Debug, Clone, Copy)]
pub struct LossArg(pub Loss);

impl FromStr for LossArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let valid =
            || format!("{text:?} is no loss; valid are squares, huber:PX and cauchy:PX, such as huber:0.5");
        let (kind, scale) = text.split_once(':').unwrap_or((text, "1"));
        let scale_px: f64 = scale.parse().ok().filter(|s| *s > 0.0).ok_or_else(valid)?;
        match kind {
            "squares" if !text.contains(':') => Ok(Self(Loss::Squares)),
            "huber" => Ok(Self(Loss::Huber { scale_px })),
            "cauchy" => Ok(Self(Loss::Cauchy { scale_px })),
            _ => Err(valid()),
        }
    }
}

/// Index of an intrinsic parameter, by its name.
#[derive(Debug, Clone, Copy)]
pub struct Intrinsic(pub usize);

impl FromStr for Intrinsic {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let place = INTRINSIC_NAMES.iter().position(|n| *n == text);
        place.map(Self).ok_or_else(|| {
            format!("{text:?} is no intrinsic parameter; valid are {}", INTRINSIC_NAMES.join(", "))
        })
    }
}

/// How to solve.
#[derive(Debug, Clone, clap::Args)]
pub struct SolverArgs {
    /// Intrinsics to hold at their start (0 for distortion): a comma-separated list of fx fy cx cy k1 k2 p1 p2 k3.
    #[arg(long, value_delimiter = ',', value_name = "LIST")]
    pub fix: Vec<Intrinsic>,

    /// Keep fx / fy at 1.
    #[arg(long)]
    pub tie_aspect: bool,

    /// Loss of each corner: squares, huber:PX or cauchy:PX.
    #[arg(long, default_value = "squares")]
    pub loss: LossArg,

    /// Write the report here, as JSON; a plot of each camera goes beside it.
    #[arg(long, value_name = "R.json")]
    pub report: Option<PathBuf>,
}

impl SolverArgs {
    /// How each camera is calibrated by itself.
    pub fn mono(&self) -> MonoOptions {
        MonoOptions { free: self.free(), tie_aspect: self.tie_aspect, start: None, loss: self.loss.0 }
    }

    /// Which intrinsics are free.
    pub fn free(&self) -> [bool; 9] {
        let mut free = [true; 9];
        for Intrinsic(i) in &self.fix {
            free[*i] = false;
        }
        free
    }
}
