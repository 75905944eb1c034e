//! `--evaluate`: prediction errors over recorded flights, as table and report.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use netcord_detect::flight::recorded::{
    EvaluateOptions, Evaluation, HORIZONS_MS, LEADS_MS, Pace, evaluate_set, find_noise, find_table,
};
use serde_json::{Map, Value, json};

use super::{files::Set, plot::ErrorPlot, reliability::Reliability};
use crate::{
    exit::{CommandResult, Outcome},
    output::{self, OutputError},
    plot,
};

/// Where the plot goes beside the report; `None` where that goes into a pipe.
///
/// # Errors
/// [`OutputError::NoName`].
pub fn plot_path(report: &Path) -> Result<Option<PathBuf>, OutputError> {
    output::beside(report, ".png")
}

/// Evaluates all sets, prints a table of each and of all together, and writes the report.
pub fn run(
    sets: &[Set],
    options: &EvaluateOptions,
    sigma_m: Option<f64>,
    report: Option<&Path>,
) -> CommandResult {
    let mut all = Evaluation::default();
    let (mut by_set, mut ends) = (Map::new(), Vec::new());
    for set in sets {
        let table = find_table(&set.recordings, options);
        let pace = Pace::find(&set.recordings);
        let sigma = sigma_m.map(Vector3::repeat).or_else(|| find_noise(&set.recordings, pace));
        let options = &EvaluateOptions { sigma_m: sigma.unwrap_or(options.sigma_m), pace, ..*options };
        let mut of_set = evaluate_set(&set.recordings, table, options);
        let mut figures = figures(&of_set);
        let surface = table.map(|t| t.surface_z_m);
        figures.insert("recordings".into(), json!(set.recordings.len()));
        figures.insert("table_z_m".into(), json!(surface));
        figures.insert("sigma_m".into(), json!(options.sigma_m.as_slice()));
        figures.insert("stamp_jitter_s".into(), json!(pace.map(|p| p.jitter_s)));
        print(&format!("{} ({} recordings)", set.name, set.recordings.len()), &figures);
        by_set.insert(set.name.clone(), Value::Object(figures));
        all.append(&mut of_set);
        ends.push(all.bets.len());
    }
    let mut figures = figures(&all);
    if sets.len() > 1 {
        print("all together", &figures);
    }
    let given = Reliability::as_given(&all.bets);
    let (folds, others) = (Reliability::by_folds(&all.bets), Reliability::by_sets(&all.bets, &ends));
    given.print("confidence and the share that held, as given");
    if let Some(folds) = &folds {
        folds.print("the same with the curve fitted to other recordings only (five folds)");
    }
    if let Some(others) = &others {
        others.print("the same with the curve fitted to the other sets only");
    }
    let worst = |r: &Option<Reliability>| r.as_ref().map(Reliability::worst);
    figures.insert("confidence_worst".into(), json!(given.worst()));
    figures.insert("confidence_held_out".into(), json!(folds.as_ref().map(Reliability::report)));
    figures.insert("confidence_held_out_worst".into(), json!(worst(&folds)));
    figures.insert("confidence_other_sets".into(), json!(others.as_ref().map(Reliability::report)));
    figures.insert("confidence_other_sets_worst".into(), json!(worst(&others)));
    figures.insert("sets".into(), Value::Object(by_set));
    if let Some(path) = report {
        output::write(path, format!("{:#}\n", Value::Object(figures)))?;
        if let Some(picture) = plot_path(path)? {
            // Without enough recordings for folds there is no second curve to draw.
            let painter = ErrorPlot { errors: &all, given, held_out: folds.unwrap_or_default() };
            plot::draw(&picture, (1400, 560), &painter)?;
        }
    }
    // Nobody's table is a metre off.
    let is_absurd = |error_m: &f64| *error_m > 1.0;
    if HORIZONS_MS.iter().all(|ms| all.prediction_errors_m(*ms).iter().all(is_absurd)) {
        eprintln!(
            "netcord: nothing was predicted, or all of it wrong by metres: times must rise and be in seconds, positions \
             in metres, several a flight"
        );
        return Ok(Outcome::Missed);
    }
    Ok(Outcome::Good)
}

/// The value below which a share of the values lies.
pub fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let place = share * last as f64;
    let (low, high) = (values[place.floor() as usize], values[place.ceil() as usize]);
    Some(if low == high { low } else { low + (high - low) * place.fract() })
}

fn errors(values: &[f64], unit: f64) -> Value {
    let mut values: Vec<f64> = values.iter().map(|v| v * unit).collect();
    json!({
        "median": quantile(&mut values, 0.5),
        "p90": quantile(&mut values, 0.9),
        "n": values.len(),
    })
}

fn by_ms(ms: &[u32], values: &[Vec<f64>]) -> Value {
    ms.iter().zip(values).map(|(ms, v)| (ms.to_string(), errors(v, 1e3))).collect::<Map<_, _>>().into()
}

/// A measured spin that points further than this from the one that bends its flight contradicts it, rad: 60°.
const CONTRADICTION_RAD: f64 = std::f64::consts::FRAC_PI_3;

fn figures(e: &Evaluation) -> Map<String, Value> {
    let agrees = |off_rad: &f64| *off_rad <= CONTRADICTION_RAD;
    let agreeing = e.spin_perpendicular.iter().zip(&e.spin_off_rad).filter(|(_, off)| agrees(off));
    let agreeing: Vec<f64> = agreeing.map(|(error, _)| *error).collect();
    let figures = json!({
        "prediction_error_mm": by_ms(&HORIZONS_MS, &HORIZONS_MS.map(|ms| e.prediction_errors_m(ms))),
        "landing_error_mm": by_ms(&LEADS_MS, &e.landing_m),
        "hitting_plane_error_mm": by_ms(&HORIZONS_MS, &e.hitting_m),
        "spin_error_ratio": errors(&e.spin_perpendicular, 1.0),
        "spin_vector_error_ratio": errors(&e.spin_full, 1.0),
        "spin_labels_contradicted": e.spin_perpendicular.len() - agreeing.len(),
        "spin_error_ratio_of_agreeing_labels": errors(&agreeing, 1.0),
        "confidence": Reliability::as_given(&e.bets).report(),
        "flights": e.flights,
        "predictions_without_flight": e.blind,
    });
    match figures {
        Value::Object(map) => map,
        _ => Map::new(),
    }
}

fn print(title: &str, figures: &Map<String, Value>) {
    let cell = |v: &Value, digits: usize| v.as_f64().map_or("–".into(), |v| format!("{v:.digits$}"));
    println!("{title}");
    for (key, name, unit) in [
        ("prediction_error_mm", "prediction error", "ms ahead"),
        ("landing_error_mm", "landing error", "ms before the bounce"),
        ("hitting_plane_error_mm", "hitting-plane error", "ms ahead"),
    ] {
        let Some(rows) = figures.get(key).and_then(Value::as_object) else { continue };
        println!("  {name}, mm {:>12} {:>8} {:>8}", "median", "p90", "n");
        let mut rows: Vec<_> = rows.iter().collect();
        rows.sort_by_key(|(ms, _)| ms.parse::<u32>().unwrap_or(0));
        for (ms, row) in rows {
            let (median, p90, n) = (cell(&row["median"], 1), cell(&row["p90"], 1), cell(&row["n"], 0));
            println!("  {:>26} {median:>8} {p90:>8} {n:>8}", format!("{ms} {unit}"));
        }
    }
    let spin = &figures["spin_error_ratio"];
    if spin["n"] != 0 {
        let full = &figures["spin_vector_error_ratio"]["median"];
        println!(
            "  spin error across the velocity: median {} of the spin ({} flights); whole vector {}",
            cell(&spin["median"], 2),
            spin["n"],
            cell(full, 2)
        );
        let agreeing = &figures["spin_error_ratio_of_agreeing_labels"];
        if figures["spin_labels_contradicted"] != 0 {
            println!(
                "  {} of these measured spins point more than 60° away from the one that bends their flight: labels \
                 of other flights? Without them {}",
                figures["spin_labels_contradicted"],
                cell(&agreeing["median"], 2)
            );
        }
    }
    println!(
        "  {} flights; {} predictions made while none was followed\n",
        figures["flights"], figures["predictions_without_flight"]
    );
}
