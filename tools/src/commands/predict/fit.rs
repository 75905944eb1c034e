//! `--fit`: physical constants from recorded flights, into the rig file.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use netcord_common::rig::RigEdit;
use netcord_detect::flight::recorded::{
    EvaluateOptions, FITTED_NAMES, FitSet, HORIZONS_MS, Pace, find_noise, find_table, fit, fitted_values,
};
use serde_json::{Map, Value, json};
use thiserror::Error;

use super::files::Set;
use crate::{
    exit::{CommandResult, Outcome},
    output,
    terminal::LiveLines,
};

/// What is written beside what is printed.
#[derive(Debug, Clone, Copy)]
pub struct Outputs<'a> {
    /// The figures, as JSON.
    pub report: Option<&'a Path>,
    /// The rig file that is given the constants.
    pub rig: Option<&'a Path>,
    /// It is given them even if they predict worse.
    pub force: bool,
}

/// Constants that were not written.
#[derive(Debug, Error)]
pub enum NotWritten {
    /// They predict worse.
    #[error(
        "{rig} was not written: the flights that were held out are predicted {percent:.1} % worse with these \
         constants than with those before; --force writes them all the same"
    )]
    Worse {
        /// The rig file.
        rig: PathBuf,
        /// By how much the error grows.
        percent: f64,
    },
    /// Nobody knows how they predict.
    #[error(
        "{rig} was not written: none of the flights that were held out is long enough to tell whether these \
         constants predict better than those before; give more flights, or --force"
    )]
    Untold {
        /// The rig file.
        rig: PathBuf,
    },
}

/// Fits, prints the `[flight]` lines of a rig file, and writes the report and the rig file.
pub fn run(
    sets: &[Set],
    options: &EvaluateOptions,
    sigma_m: Option<f64>,
    outputs: Outputs<'_>,
) -> CommandResult {
    // A rig file that cannot be written to is told of before minutes are spent.
    let rig = outputs.rig.map(RigEdit::open).transpose()?;
    let sets: Vec<FitSet<'_>> = sets
        .iter()
        .map(|set| {
            let pace = Pace::find(&set.recordings);
            let sigma = sigma_m.map(Vector3::repeat).or_else(|| find_noise(&set.recordings, pace));
            let options = EvaluateOptions { sigma_m: sigma.unwrap_or(options.sigma_m), pace, ..*options };
            FitSet { recordings: &set.recordings, table: find_table(&set.recordings, &options), options }
        })
        .collect();
    let mut live = LiveLines::new(false);
    let found = fit(&sets, &options.constants, &mut |share| {
        live.draw(&[format!("fitting: {:.0} %", share * 100.0)]);
    });
    live.draw(&[]);
    let found = found
        .ok_or("all recordings are held out (one in three, by a hash of the name): give more of them")?;
    let c = &found.constants;
    println!("[flight]");
    let mut constants = Map::new();
    for ((name, value), sigma) in FITTED_NAMES.iter().zip(fitted_values(c)).zip(found.sigma) {
        println!("{name} = {value:.4} # ± {sigma:.4}");
        constants.insert((*name).into(), json!({ "value": value, "sigma": sigma }));
    }
    println!("gravity_m_s2 = {:.4} # as it was", c.gravity_m_s2);
    let ((fitted, held), (before, after)) = (found.recordings, found.held_out);
    println!(
        "# fitted to {fitted} recordings; on the {held} held out, the negative log-likelihood of a position \
         goes from {before:.4} to {after:.4}"
    );
    let [errors_before, errors_after] = found.held_out_errors_m.map(|errors| {
        HORIZONS_MS
            .iter()
            .zip(errors)
            .map(|(ms, m)| (ms.to_string(), json!(m.map(|m| m * 1e3))))
            .collect::<Map<_, _>>()
    });
    let line = |errors: &Map<String, Value>| {
        let mm = |ms: &u32| errors[&ms.to_string()].as_f64().map_or("–".into(), |mm| format!("{mm:.1}"));
        HORIZONS_MS.iter().map(mm).collect::<Vec<_>>().join(" / ")
    };
    println!(
        "# their median prediction error at 0.1 … 0.5 s: {} mm before, {} mm now",
        line(&errors_before),
        line(&errors_after)
    );
    if let Some(path) = outputs.report {
        let report = json!({
            "constants": constants,
            "recordings": { "fitted": fitted, "held_out": held },
            "held_out_nll_per_position": { "before": before, "after": after },
            "held_out_growth": found.held_out_growth(),
            "held_out_error_mm": { "before": errors_before, "after": errors_after },
        });
        output::write(path, format!("{report:#}\n"))?;
    }
    let growth = found.held_out_growth();
    if let Some(growth) = growth {
        let (percent, word) = ((growth - 1.0).abs() * 100.0, if growth > 1.0 { "worse" } else { "better" });
        println!("# over all horizons they are predicted {percent:.1} % {word}");
    }
    if let Some(mut edit) = rig {
        let path = outputs.rig.unwrap_or(Path::new(""));
        match growth {
            _ if outputs.force => {}
            Some(growth) if growth <= 1.0 => {}
            Some(growth) => {
                let percent = (growth - 1.0) * 100.0;
                return Err(NotWritten::Worse { rig: path.to_owned(), percent }.into());
            }
            None => return Err(NotWritten::Untold { rig: path.to_owned() }.into()),
        }
        for ((name, value), sigma) in FITTED_NAMES.iter().zip(fitted_values(c)).zip(found.sigma) {
            edit.set_flight(name, rounded(value), &format!("± {sigma:.4}, fitted to {fitted} recordings"));
        }
        edit.set_flight("gravity_m_s2", c.gravity_m_s2, "");
        edit.clone().with_nominal_calibration().resolve()?;
        let kept = edit
            .save()?
            .map_or_else(String::new, |old| format!("; the old one is kept as {}", old.display()));
        println!("# written to {}{kept}", path.display());
    }
    Ok(Outcome::Good)
}

/// As it is printed: further digits mean nothing.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
