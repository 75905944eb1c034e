//! The table's pose against simulated truth: marks with noise, a board on the table, bounces of the ball.

use nalgebra::{Rotation3, SVector, Vector2, Vector3};
use netcord_calib::{
    board::CalibrationBoard,
    table::{
        BoardOnTable, Contact, MARKS, Table, TableCalibration, TableCamera, TableError, TableSighting,
        TableStart, TrackedPoint, calibrate_table, find_bounces,
    },
};
use netcord_common::{
    geometry::{Point, Transform, World},
    rig::Rig,
};
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;

/// The example rig: its cameras in the first one's frame, and where the table truly is.
fn rig() -> (Vec<TableCamera>, Transform<World, Table>) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
    let rig = Rig::load(&path).expect("the example is valid");
    let first = rig.cameras[0].camera_from_world;
    let cameras = rig
        .cameras
        .iter()
        .map(|c| {
            let turn = c.camera_from_world.rotation * first.rotation.inverse();
            let moved = c.camera_from_world.translation - turn * first.translation;
            TableCamera {
                name: c.name.to_string(),
                model: c.model,
                camera_from_first: Transform::new(turn, moved),
            }
        })
        .collect();
    (cameras, Transform::new(first.rotation, first.translation))
}

/// Where the cameras see these places, each pixel off by noise; places out of sight are left out.
fn seen(
    cameras: &[TableCamera],
    truth: &Transform<World, Table>,
    places: &[(String, Vector3<f64>)],
    noise_px: f64,
    random: &mut impl Rng,
) -> Vec<TableSighting> {
    let noise = Normal::new(0.0, noise_px).expect("positive");
    let mut found = Vec::new();
    for (i, camera) in cameras.iter().enumerate() {
        for (name, on_table) in places {
            let at = &camera.camera_from_first * (truth * Point::from(*on_table));
            let Some(pixel) = camera.model.project(&at).filter(|p| camera.model.contains(p)) else {
                continue;
            };
            let pixel = pixel + Vector2::new(noise.sample(random), noise.sample(random));
            found.push(TableSighting { camera: i, mark: name.clone(), on_table: *on_table, pixel });
        }
    }
    found
}

fn marks() -> Vec<(String, Vector3<f64>)> {
    MARKS.iter().map(|(n, p)| ((*n).to_owned(), Vector3::from(*p))).collect()
}

/// How far the corners of the found table are from the true ones, at most, m.
fn worst_corner(found: &TableCalibration, truth: &Transform<World, Table>) -> f64 {
    let off =
        |p: &Vector3<f64>| (&found.first_from_table * Point::from(*p)).distance(&(truth * Point::from(*p)));
    marks()[..4].iter().map(|(_, p)| off(p)).fold(0.0, f64::max)
}

fn mahalanobis(found: &TableCalibration, truth: &Transform<World, Table>) -> f64 {
    let pose = &found.first_from_table;
    let turn = (truth.rotation * pose.rotation.inverse()).scaled_axis();
    let moved = truth.translation - pose.translation;
    let off = SVector::<f64, 6>::from_iterator(turn.iter().chain(moved.iter()).copied());
    (off.transpose() * found.covariance.try_inverse().expect("positive") * off)[0]
}

#[test]
fn marks_give_the_table_and_its_uncertainty_is_honest() {
    const RUNS: u64 = 400;
    /// 95 % quantile of χ² with six degrees of freedom.
    const CHI2_6: f64 = 12.592;
    let (cameras, truth) = rig();
    let (mut inside, mut worst) = (0, 0.0_f64);
    for seed in 0..RUNS {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let sightings = seen(&cameras, &truth, &marks(), 0.5, &mut random);
        let found = calibrate_table(&cameras, &sightings, &[], None, Some(0.5)).expect("settled");
        inside += usize::from(mahalanobis(&found, &truth) < CHI2_6);
        worst = worst.max(worst_corner(&found, &truth));
        assert!(found.residuals.iter().all(|r| !r.outlier || r.length > 2.0));
    }
    println!(
        "inside the 95 % ellipsoid: {inside} of {RUNS}; a corner is off by at most {:.2} mm",
        worst * 1e3
    );
    assert!((372..=390).contains(&inside), "{inside} of {RUNS}");
    assert!(worst < 5e-3, "{worst} m");
}

#[test]
fn four_corners_in_one_camera_are_enough_and_one_that_is_wrong_among_nine_is_left_out() {
    let (cameras, truth) = rig();
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let all = seen(&cameras, &truth, &marks(), 0.2, &mut random);
    let one: Vec<_> = all.iter().filter(|s| s.camera == 0).cloned().collect();
    assert!(one.len() >= 4, "{} marks in the first camera", one.len());
    let found = calibrate_table(&cameras, &one, &[], None, None).expect("settled");
    assert!(worst_corner(&found, &truth) < 8e-3, "{}", worst_corner(&found, &truth));

    let mut wrong = all.clone();
    wrong[2].pixel += Vector2::new(25.0, -10.0);
    let found = calibrate_table(&cameras, &wrong, &[], None, None).expect("settled");
    let outliers: Vec<&str> = found.residuals.iter().filter(|r| r.outlier).map(|r| r.mark.as_str()).collect();
    assert_eq!(outliers, [wrong[2].mark.as_str()]);
    assert!(worst_corner(&found, &truth) < 4e-3, "{}", worst_corner(&found, &truth));
}

#[test]
fn a_board_that_lies_on_the_table_gives_its_pose() {
    let (cameras, truth) = rig();
    let board =
        CalibrationBoard::parse("aruco:4x3:DICT_4X4_50:120mm:30mm", |_| Err("none".into())).expect("valid");
    let lies = BoardOnTable { origin_m: [-0.25, 0.3], yaw_rad: 0.4, height_m: 0.004 };
    let places: Vec<_> = board.corners().iter().map(|p| ("corner".to_owned(), lies.place(p))).collect();
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let sightings = seen(&cameras, &truth, &places, 0.1, &mut random);
    let found = calibrate_table(&cameras, &sightings, &[], None, None).expect("settled");
    let off = worst_corner(&found, &truth);
    println!("a corner of the table is off by {:.2} mm", off * 1e3);
    // The board spans a quarter of the table: at its corners the tilt's error has grown.
    assert!(off < 3e-3, "{off}");
    let predicted = found.sigma_at(&Vector3::new(0.7625, 1.37, 0.0)).norm();
    assert!(off < 4.0 * predicted, "{off} m, σ {predicted} m");
}

/// Flights with drag over the table, 180 positions a second, in the first camera's frame.
fn rally(truth: &Transform<World, Table>, noise_m: f64, random: &mut impl Rng) -> Vec<TrackedPoint> {
    let noise = Normal::new(0.0, noise_m).expect("positive");
    let mut track = Vec::new();
    for flight in 0..24 {
        let side = if flight % 2 == 0 { 1.0 } else { -1.0 };
        let mut at = Vector3::new(random.random_range(-0.4..0.4), -1.5 * side, random.random_range(0.2..0.4));
        let mut v = Vector3::new(
            random.random_range(-0.8..0.8),
            side * random.random_range(4.0..6.0),
            random.random_range(0.0..1.5),
        );
        for k in 0..110 {
            let mut shake = || noise.sample(random);
            let seen = at + Vector3::new(shake(), shake(), shake());
            let t_s = f64::from(flight) + f64::from(k) / 180.0;
            track.push(TrackedPoint { t_s, at: truth * Point::from(seen) });
            for _ in 0..20 {
                let dt = 1.0 / 3600.0;
                v += (Vector3::new(0.0, 0.0, -9.81) - v * v.norm() * 0.11) * dt;
                let next = at + v * dt;
                let over = next.x.abs() < 0.7625 && next.y.abs() < 1.37;
                if over && at.z >= 0.02 && next.z < 0.02 {
                    v.z *= -0.9;
                    v.x *= 0.95;
                    v.y *= 0.95;
                } else {
                    at = next;
                }
            }
        }
    }
    track
}

#[test]
fn bounces_tell_the_tables_plane() {
    let (cameras, truth) = rig();
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let track = rally(&truth, 5e-4, &mut random);
    let bounces = find_bounces(&track, None);
    assert!(bounces.len() >= 15, "{} bounces", bounces.len());
    let table_from_first = truth.inverse();
    for b in &bounces {
        let height = (&table_from_first * b.at).coords.z;
        assert!((height - 0.02).abs() < 0.004, "a bounce at {height} m");
    }
    let contacts: Vec<Contact> =
        bounces.iter().map(|b| Contact { at: b.at, height_m: 0.02, sigma_m: b.sigma_m }).collect();
    // Believed 6 mm too high and tilted by half a degree.
    let up = truth.rotation * Vector3::z();
    let lean = Rotation3::new(truth.rotation * Vector3::new(0.006, -0.007, 0.0));
    let start = TableStart {
        first_from_table: Transform::new(lean * truth.rotation, truth.translation + up * 0.006),
        sigma: [0.01, 0.01, 0.01, 0.01, 0.01, 0.01],
    };
    let found = calibrate_table(&cameras, &[], &contacts, Some(&start), None).expect("settled");
    let heights = marks()
        .into_iter()
        .map(|(_, p)| (&table_from_first * (&found.first_from_table * Point::from(p))).coords.z.abs());
    let worst = heights.fold(0.0, f64::max);
    println!("{} bounces; the table's height is off by at most {:.2} mm", bounces.len(), worst * 1e3);
    assert!(worst < 1.5e-3, "{worst}");
    let middle = found.sigma_at(&Vector3::zeros());
    assert!(middle.z < 5e-4 && middle.x > 5e-3, "bounces know the height, not the place: {middle}");

    // With two marks nothing has to be believed along the table, once the plane is known.
    let two: Vec<_> = seen(&cameras, &truth, &marks()[..2], 0.3, &mut random);
    let found = calibrate_table(&cameras, &two, &contacts, Some(&start), None).expect("settled");
    assert!(worst_corner(&found, &truth) < 6e-3, "{}", worst_corner(&found, &truth));
}

#[test]
fn what_does_not_settle_the_table_is_said() {
    let (cameras, truth) = rig();
    let mut random = Pcg64Mcg::seed_from_u64(4);
    let all = seen(&cameras, &truth, &marks(), 0.2, &mut random);
    let two: Vec<_> = all.iter().filter(|s| s.mark == "x-y0" || s.mark == "x+y0").cloned().collect();
    let error = calibrate_table(&cameras, &two, &[], None, None).expect_err("two places");
    assert!(matches!(error, TableError::TooFew { places: 2, .. }), "{error}");

    // The long sides taken for the short ones: as if seen in a mirror.
    let mut turned = all.clone();
    for s in &mut turned {
        s.on_table = Vector3::new(s.on_table.y, s.on_table.x, 0.0);
    }
    let error = calibrate_table(&cameras, &turned, &[], None, None).expect_err("mirrored");
    assert!(matches!(error, TableError::UpsideDown | TableError::Contradiction { .. }), "{error}");
    let mut mirrored = all.clone();
    for s in &mut mirrored {
        s.on_table.x = -s.on_table.x;
    }
    let error = calibrate_table(&cameras, &mirrored, &[], None, None).expect_err("mirrored");
    assert!(matches!(error, TableError::UpsideDown | TableError::Contradiction { .. }), "{error}");
    // Each mark named at random.
    let mut mixed = all;
    let places: Vec<_> = mixed.iter().map(|s| s.on_table).collect();
    for (i, s) in mixed.iter_mut().enumerate() {
        s.on_table = places[(i * 5 + 3) % places.len()];
    }
    let error = calibrate_table(&cameras, &mixed, &[], None, None).expect_err("mixed up");
    assert!(matches!(error, TableError::UpsideDown | TableError::Contradiction { .. }), "{error}");
}
