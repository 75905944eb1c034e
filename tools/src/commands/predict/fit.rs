//! `--fit`: physical constants from recorded flights, as lines for the rig file.

use std::{fs, path::Path};

use nalgebra::Vector3;
use netcord_detect::flight::recorded::{
    EvaluateOptions, FITTED_NAMES, FitSet, find_noise, find_table, fit, fitted_values,
};
use serde_json::{Map, Value, json};

use super::files::Set;
use crate::exit::{CommandResult, Outcome};

/// Fits, prints the `[flight]` lines of a rig file, and writes the report.
pub fn run(
    sets: &[Set],
    options: &EvaluateOptions,
    sigma_m: Option<f64>,
    report: Option<&Path>,
) -> CommandResult {
    let sets: Vec<FitSet<'_>> = sets
        .iter()
        .map(|set| {
            let sigma = sigma_m.map(Vector3::repeat).or_else(|| find_noise(&set.recordings));
            let options = EvaluateOptions { sigma_m: sigma.unwrap_or(options.sigma_m), ..*options };
            FitSet { recordings: &set.recordings, table: find_table(&set.recordings, &options), options }
        })
        .collect();
    let found = fit(&sets, &options.constants)
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
    if let Some(path) = report {
        let report = json!({
            "constants": constants,
            "recordings": { "fitted": fitted, "held_out": held },
            "held_out_nll_per_position": { "before": before, "after": after },
        });
        fs::write(path, format!("{:#}\n", Value::clone(&report)))?;
    }
    Ok(Outcome::Good)
}
