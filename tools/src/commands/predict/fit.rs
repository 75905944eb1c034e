//! `--fit`: physical constants from recorded flights, into the rig file.

use std::{fs, path::Path};

use nalgebra::Vector3;
use netcord_common::rig::RigEdit;
use netcord_detect::flight::recorded::{
    EvaluateOptions, FITTED_NAMES, FitSet, HORIZONS_MS, Pace, find_noise, find_table, fit, fitted_values,
};
use serde_json::{Map, Value, json};

use super::files::Set;
use crate::{
    exit::{CommandResult, Outcome},
    terminal::LiveLines,
};

/// What is written beside what is printed.
#[derive(Debug, Clone, Copy)]
pub struct Outputs<'a> {
    /// The figures, as JSON.
    pub report: Option<&'a Path>,
    /// The rig file that is given the constants.
    pub rig: Option<&'a Path>,
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
            "held_out_error_mm": { "before": errors_before, "after": errors_after },
        });
        fs::write(path, format!("{:#}\n", Value::clone(&report)))?;
    }
    if let Some(mut edit) = rig {
        for ((name, value), sigma) in FITTED_NAMES.iter().zip(fitted_values(c)).zip(found.sigma) {
            edit.set_flight(name, rounded(value), &format!("± {sigma:.4}, fitted to {fitted} recordings"));
        }
        edit.set_flight("gravity_m_s2", c.gravity_m_s2, "");
        edit.clone().with_nominal_calibration().resolve()?;
        edit.save()?;
        let path = outputs.rig.unwrap_or(Path::new(""));
        println!("# written to {}; the old one is kept beside it as .bak", path.display());
    }
    Ok(Outcome::Good)
}

/// As it is printed: further digits mean nothing.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
