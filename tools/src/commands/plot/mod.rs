//! `netcord plot`: a recording as a picture, without any viewer.

mod content;
mod drawing;

use std::path::PathBuf;

use netcord_common::wire::BallTrajectory;
use serde_json::{Map, json};

use self::{content::Content, drawing::Drawing};
use crate::{
    exit::{CommandResult, Outcome},
    output::Plan,
    plot,
};

/// Draws a recording's positions and predictions from above, from the side and in perspective, and the errors
/// against the truth where the recording has it.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A recording with results, from `netcord record` or `netcord process --out`.
    input: PathBuf,

    /// The picture: SVG if its name ends so, else PNG; default: INPUT with .png at its end.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,

    /// Instants whose prediction is drawn, in seconds from the recording's first position; default: five, evenly
    /// spread over those that have one.
    #[arg(long, value_name = "S,S,…", value_delimiter = ',', allow_negative_numbers = true,
          value_parser = super::between(0.0, 1e6, "seconds"))]
    at: Vec<f64>,

    /// Where the errors that are drawn are written as JSON.
    #[arg(long, value_name = "R.json")]
    report: Option<PathBuf>,
}

/// Runs `netcord plot`.
pub fn run(args: &Args) -> CommandResult {
    let out = args.out.clone().unwrap_or_else(|| args.input.with_extension("png"));
    let mut plan = Plan::of([&args.input]);
    let picture = plan.begin(&out)?;
    let report = args.report.as_deref().map(|path| plan.begin(path)).transpose()?;
    let content = Content::read(&args.input)?;
    if content.positions.is_empty() && content.truth.is_empty() {
        return Err(format!(
            "{} has no positions; `netcord process {} --out RESULT.mcap` makes a recording that has",
            args.input.display(),
            args.input.display()
        )
        .into());
    }
    if let (Some(late), Some(last_s)) =
        (args.at.iter().copied().reduce(f64::max), content.last_prediction_s())
        && late > last_s + 1.0
    {
        return Err(format!("--at {late}: the last prediction is made at {last_s:.2} s").into());
    }
    let predictions = content.predictions_at(&args.at);
    let size = if content.truth.is_empty() { (1400, 1000) } else { (1400, 1300) };
    plot::draw_into(picture, size, &Drawing { content: &content, predictions: &predictions })?;
    if let Some(output) = report {
        let of = |prediction: &&BallTrajectory| {
            let off = content.prediction_errors(prediction);
            let off = off.into_iter().map(|(ms, mm)| (ms.to_string(), json!(mm))).collect::<Map<_, _>>();
            json!({ "made_at_s": content.seconds(prediction.stamps.mid_exposure_ns), "error_mm": off })
        };
        let report = json!({
            "positions": content.positions.len(),
            "position_error_mm": content.error_quantiles().map(|(median, p95)| json!({
                "median": median, "p95": p95, "n": content.errors().len(),
            })),
            "predictions": predictions.iter().map(of).collect::<Vec<_>>(),
        });
        output.write(format!("{report:#}\n"))?;
    }
    println!("{}: {} positions", out.display(), content.positions.len());
    Ok(Outcome::Good)
}
