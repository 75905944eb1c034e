//! A recording that is replayed to the live stages gives what `process` gives.

use std::{collections::BTreeMap, fs};

use netcord_tests::{Lab, Watch, one_at_a_time, until};
use toml_edit::{Array, ArrayOfTables, Item, Table, value};

/// Positions by the recording's own stamp.
type Positions = BTreeMap<u64, [f64; 3]>;

/// Films four seconds of a rally, and processes them.
fn film(path: &str) -> Positions {
    let lab = Lab::new();
    let rig = lab.synthetic_rig(20.0, &[]).display().to_string();
    let capture = lab.start(&["capture", "--rig", &rig, "--scene", "clean", "--seed", "3"]);
    // What the recorder misses on a busy machine is in neither of the two that are compared.
    let recorded = lab.start(&["record", path, "--rig", &rig, "--seconds", "4"]).wait();
    assert!(matches!(recorded.code, Some(0 | 1)), "{}", recorded.err);
    capture.stop();
    let table = lab.path("positions.csv").display().to_string();
    let processed = lab.start(&["process", path, "--rig", &rig, "--positions", &table]).wait();
    assert!(matches!(processed.code, Some(0 | 1)), "{}", processed.err);
    let text = fs::read_to_string(table).expect("positions");
    text.lines()
        .skip(1)
        .map(|line| {
            let mut fields = line.split(',');
            let t_ns = fields.next().and_then(|f| f.parse().ok()).expect("a stamp");
            (t_ns, std::array::from_fn(|_| fields.next().and_then(|f| f.parse().ok()).expect("a number")))
        })
        .collect()
}

#[test]
fn a_recording_at_the_readers_pace_gives_the_positions_that_process_gives() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let path = lab.path("film.mcap").display().to_string();
    let processed = film(&path);
    assert!(processed.len() >= 20, "{} positions", processed.len());

    let replay = ["--source", "replay", "--recording", &path, "--pace", "readers", "--loop"];
    // The wait for the other camera is the only thing that depends on how busy the machine is.
    let stages: [(&str, &[&str]); 4] = [
        ("segment", &[]),
        ("triangulate", &["--patience-ms", "60000"]),
        ("predict", &[]),
        ("capture", &replay),
    ];
    let rig = lab.rig_file(|document| {
        document["rate_hz"] = value(20.0);
        let mut processes = ArrayOfTables::new();
        for (command, arguments) in stages {
            let mut table = Table::new();
            table["command"] = value(command);
            table["args"] = value(Array::from_iter(arguments.iter().copied()));
            processes.push(table);
        }
        document["process"] = Item::ArrayOfTables(processes);
    });
    let bus = lab.bus();
    let watch = Watch::attach(&bus);
    let up = lab.start(&["up", &rig.display().to_string(), "--quiet"]);
    let mut live: BTreeMap<u64, Option<[f64; 3]>> = BTreeMap::new();
    until("all triggers of the recording", || {
        for position in watch.positions() {
            let found = position.is_present().then_some(position.position_m);
            // A second lap has later stamps.
            live.entry(position.stamps.mid_exposure_ns).or_insert(found);
        }
        processed.keys().all(|t_ns| live.contains_key(t_ns)).then_some(())
    });
    drop((watch, bus));
    drop(up.stop());

    let mut off: Vec<f64> = Vec::new();
    for (t_ns, expected) in &processed {
        let found = live[t_ns].unwrap_or_else(|| panic!("no position at {t_ns}"));
        off.push(found.iter().zip(expected).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt());
    }
    off.sort_by(f64::total_cmp);
    // A search window that came later than the frame changes where the fit begins, and so its last digits.
    let (median, largest) = (off[off.len() / 2], off[off.len() - 1]);
    assert!(median < 1e-4 && largest < 0.01, "{median} m in the median, {largest} m at most");
}
