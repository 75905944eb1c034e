//! `netcord triangulate`: from detections to positions, live.

use netcord_common::wire::MethodCode;
use netcord_detect::triangulate::{CALIBRATION_SLACK_PX, TriangulateOptions, live};

use super::RigArgs;
use crate::{exit::CommandResult, stage};

/// Finds the ball's position at each trigger from the detections of all cameras, and publishes it on
/// ball/position, or the reason why there is none. Says which camera no longer fits the rig.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,

    #[command(flatten)]
    options: OptionArgs,
}

/// How to triangulate: shared with `netcord process`.
#[derive(Debug, Clone, clap::Args)]
pub struct OptionArgs {
    /// Method: dlt-svd, dlt-ls, midpoint, rt-first, rt-second, rt-symmetric, reprojection or robust.
    #[arg(long, default_value = "robust", value_parser = method_of)]
    method: MethodCode,

    /// What the calibration may be off by, one standard deviation, in pixels: widens the gates within
    /// which candidates of several cameras agree.
    #[arg(long, default_value_t = CALIBRATION_SLACK_PX, value_name = "PX")]
    slack_px: f64,

    /// How long to wait for the other cameras after the last arrival, in milliseconds [default: half a
    /// frame interval where two have delivered; a whole one, at least 5, where one is alone].
    #[arg(long, value_name = "MS")]
    patience_ms: Option<f64>,
}

impl OptionArgs {
    /// The options.
    pub fn options(&self) -> TriangulateOptions {
        TriangulateOptions {
            method: self.method,
            slack_px: self.slack_px.max(0.0),
            patience_ns: self.patience_ms.map(|ms| (ms.max(0.0) * 1e6) as u64),
        }
    }
}

/// The method of a name.
pub fn method_of(name: &str) -> Result<MethodCode, String> {
    MethodCode::ALL.iter().find(|m| m.name() == name).copied().ok_or_else(|| {
        let valid: Vec<_> = MethodCode::ALL.iter().map(|m| m.name()).collect();
        format!("no such method; valid are {}", valid.join(", "))
    })
}

/// Runs `netcord triangulate`.
pub fn run(args: &Args) -> CommandResult {
    stage::run("triangulate", &args.rig, |stage| {
        live::run(&stage.bus, &stage.rig, &args.options.options(), &stage.stop, &stage.counters, || {
            tracing::info!(domain = %stage.bus.domain(), "triangulate is ready");
        })
    })
}
