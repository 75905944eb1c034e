//! Gathering, matching and triangulating allocate nothing once they run.

use std::path::Path;

use netcord_common::{
    CountingAllocator, allocations,
    geometry::Point,
    rig::Rig,
    wire::{Detection, DetectionFlags, Detections, Scope},
};
use netcord_detect::triangulate::{Matcher, TriangulateOptions};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// What `camera` sees of a ball at `t` seconds, among look-alikes at rest and on the move.
fn seen(rig: &Rig, camera: usize, trigger_id: u64, scope: Scope) -> Detections {
    let t = (trigger_id % 40) as f64 * 0.01;
    let things = [
        Point::new(0.1 - t, -1.0 + 5.0 * t, 0.3 + 2.0 * t - 4.9 * t * t),
        Point::new(0.4, 0.9, 0.02),
        Point::new(-0.4, 0.3 + 0.2 * t, 0.5),
    ];
    let mut message =
        Detections { trigger_id, sequence: trigger_id, scope: scope.code(), ..Detections::default() };
    message.camera = u32::try_from(camera).expect("few");
    message.stamps.mid_exposure_ns = trigger_id * 10_000_000;
    for (i, thing) in things.iter().enumerate().take(if scope == Scope::Window { 1 } else { 3 }) {
        let c = &rig.cameras[camera];
        let Some(pixel) = c.model.project(&(&c.camera_from_world * *thing)) else { continue };
        message.insert(Detection {
            u_px: pixel.x,
            v_px: pixel.y,
            covariance_px2: [0.04, 0.0, 0.04],
            score: 0.9 - 0.1 * i as f64,
            flags: if trigger_id.is_multiple_of(2) { DetectionFlags::SPHERE_CORRECTED } else { 0 },
            ..Detection::default()
        });
    }
    message
}

/// Without the test runner, whose own thread allocates when it likes.
fn main() {
    for cameras in [2, 8] {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../common/rigs/example-{cameras}cam.toml"));
        let rig = Rig::load(&path).expect("an example rig");
        let mut matcher = Matcher::new(&rig, &TriangulateOptions::default());
        let mut before = 0;
        let mut found = 0;
        for trigger in 1..=400 {
            if trigger == 100 {
                before = allocations();
            }
            for scope in [Scope::Window, Scope::Full] {
                // Some triggers have no windows, and some miss a camera.
                if scope == Scope::Window && trigger % 3 == 0 {
                    continue;
                }
                for camera in usize::from(trigger % 10 == 0)..cameras {
                    matcher.offer(&seen(&rig, camera, trigger, scope), trigger);
                    while let Some(position) = matcher.next(trigger) {
                        found += u32::from(position.is_present());
                    }
                }
            }
        }
        assert_eq!(allocations() - before, 0, "{cameras} cameras");
        assert!(found > 300, "{found} positions: it did work");
    }
    println!("the steady state allocates nothing ... ok");
}
