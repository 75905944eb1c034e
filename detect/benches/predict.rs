//! Time from a position to its trajectory and the next search windows, over a rally with bounces, hits, gaps,
//! outliers and late positions.
//!
//! `cargo bench -p netcord-detect --bench predict`; under `valgrind --tool=callgrind` the counts do not depend on
//! what else the machine does.

#[path = "../tests/rally/mod.rs"]
mod rally;

use std::{hint::black_box, path::Path, time::Instant};

use netcord_common::rig::Rig;
use netcord_detect::flight::{PredictOptions, Predictor};

/// The mark for 99 of 100 positions, µs.
const MARK_US: f64 = 300.0;

fn main() {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../common/rigs/example-2cam.toml"));
    let rig = Rig::load(path).expect("the example rig is valid");
    let mut best = Vec::new();
    // The least of several rounds, position by position: what the machine does beside it does not count.
    for round in 0..5 {
        let mut predictor = Predictor::new(&rig, PredictOptions::default());
        for (n, position) in rally::positions().take(6_000).enumerate() {
            let started = Instant::now();
            black_box(predictor.update(black_box(&position)));
            let next_ns = position.stamps.mid_exposure_ns + rally::INTERVAL_NS;
            black_box(predictor.windows(next_ns).count());
            let us = started.elapsed().as_secs_f64() * 1e6;
            if round == 0 {
                best.push(us);
            } else {
                best[n] = f64::min(best[n], us);
            }
        }
    }
    best.sort_by(f64::total_cmp);
    let at = |share: f64| best[(share * (best.len() - 1) as f64) as usize];
    println!(
        "position to trajectory and windows, µs: median {:.1}, 99 % {:.1} (mark {MARK_US}), worst {:.1}",
        at(0.5),
        at(0.99),
        at(1.0)
    );
}
