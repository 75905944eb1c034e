//! Following, predicting and aiming search windows allocate nothing once they run.

mod rally;

use std::path::Path;

use netcord_common::{CountingAllocator, allocations, rig::Rig, wire::TrajectoryOutcome};
use netcord_detect::flight::{PredictOptions, Predictor};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Without the test runner, whose own thread allocates when it likes.
fn main() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-4cam.toml");
    let rig = Rig::load(&path).expect("an example rig");
    let mut predictor = Predictor::new(&rig, PredictOptions::default());
    let (mut before, mut in_flight, mut windows, mut flights) = (0, 0, 0, 0);
    for (n, position) in rally::positions().take(1_200).enumerate() {
        if n == 1 {
            before = allocations();
        }
        let trajectory = predictor.update(&position);
        in_flight += u32::from(trajectory.outcome == TrajectoryOutcome::InFlight.code());
        flights = trajectory.flight_id;
        let next_ns = position.stamps.mid_exposure_ns + rally::INTERVAL_NS;
        windows += predictor.windows(next_ns).map(|w| w.present).sum::<u32>();
    }
    assert_eq!(allocations() - before, 0);
    assert!(
        in_flight > 900 && flights >= 18 && windows > 1_000,
        "it did work: {in_flight} predictions, {flights} flights, {windows} windows"
    );
    println!("the steady state allocates nothing ... ok");
}
