//! The check of a finished rig, against simulated views: it passes what is well, and names what is not.

use nalgebra::{Rotation3, Vector2, Vector3};
use netcord_calib::{
    check::{Limits, check_boards, check_rod},
    solve::{CameraViews, MovingPoints, View},
    table::TableCamera,
};
use netcord_common::{
    camera::{CameraModel, Distortion},
    geometry::{Board, Point, Transform, World},
};
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;

/// Three cameras that look at one place from 60° apart.
fn rig() -> Vec<TableCamera> {
    let lens = Distortion::from_array([-0.1, 0.05, 5e-4, -3e-4, 0.0]);
    let model = CameraModel::new((1920, 1200), (900.0, 901.0), (962.0, 597.0), lens).expect("valid");
    (0..3)
        .map(|i| {
            let turn = Rotation3::new(Vector3::new(0.0, f64::from(i) * 0.6, 0.0));
            // About the point two metres before the first camera.
            let centre = Vector3::new(0.0, 0.0, 2.0);
            TableCamera {
                name: ["left", "middle", "right"][i as usize].to_owned(),
                model,
                camera_from_first: Transform::new(turn, centre - turn * centre),
            }
        })
        .collect()
}

fn views(cameras: &[TableCamera], scale: f64, random: &mut impl Rng) -> Vec<CameraViews> {
    let noise = Normal::new(0.0, 0.1).expect("positive");
    let object: Vec<_> =
        (0..48).map(|i| Vector3::new(f64::from(i % 8) * 0.06, f64::from(i / 8) * 0.06, 0.0)).collect();
    let mut seen: Vec<CameraViews> = cameras
        .iter()
        .map(|c| CameraViews { name: c.name.clone(), size: (1920, 1200), views: Vec::new() })
        .collect();
    for k in 0..8 {
        let turn = Rotation3::new(Vector3::new(
            random.random_range(-0.4..0.4),
            random.random_range(-0.9..-0.3),
            random.random_range(-0.5..0.5),
        ));
        let middle = Vector3::new(random.random_range(-0.3..0.3), random.random_range(-0.2..0.2), 2.0);
        let pose =
            Transform::<World, Board>::new(turn, middle - turn * Vector3::new(0.21, 0.15, 0.0) * scale);
        for (camera, seen) in cameras.iter().zip(&mut seen) {
            let mut view = View::new(format!("{k}"), Vec::new(), Vec::new());
            for o in &object {
                let at = &camera.camera_from_first * (&pose * Point::from(o * scale));
                let Some(pixel) = camera.model.project(&at).filter(|p| camera.model.contains(p)) else {
                    continue;
                };
                view.object.push(*o);
                view.image.push(pixel + Vector2::new(noise.sample(random), noise.sample(random)));
            }
            seen.views.push(view);
        }
    }
    seen
}

#[test]
fn a_good_rig_passes_and_a_knocked_camera_is_named() {
    let cameras = rig();
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let seen = views(&cameras, 1.0, &mut random);
    let (check, corners) = check_boards(&cameras, &seen, &Limits::default());
    assert!(check.redo.is_empty(), "{:?}", check.redo);
    assert_eq!(check.pairs.len(), 3);
    assert_eq!(corners.len(), seen.iter().flat_map(|c| &c.views).map(|v| v.image.len()).sum::<usize>());
    let median = check.cameras[1].common_px.expect("seen").median;
    // The median length of a residual of σ = 0.1 px in both directions is 0.118 px.
    assert!((0.09..0.13).contains(&median), "{median}");
    assert!(check.board_scale_error.expect("measured").abs() < 1e-3);

    // The file says one thing, the camera now stands a fifth of a degree off.
    let mut knocked = cameras.clone();
    let pose = &mut knocked[2].camera_from_first;
    *pose =
        Transform::new(Rotation3::new(Vector3::new(0.0035, 0.001, 0.0)) * pose.rotation, pose.translation);
    let (check, _) = check_boards(&knocked, &seen, &Limits::default());
    assert!(check.redo.iter().any(|r| r.contains("camera right has moved")), "{:?}", check.redo);
    assert!(check.pairs[0].epipolar_px.median < 0.2 && check.pairs[1].epipolar_px.median > 0.5);

    let mut refocused = cameras;
    let p = refocused[0].model.parameters();
    // One axis only: a longer focal length alone is mostly taken for a nearer board.
    let longer = [p[0] * 1.03, p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]];
    refocused[0].model = refocused[0].model.with_parameters(longer).expect("valid");
    let (check, _) = check_boards(&refocused, &seen, &Limits { reprojection_px: 0.2, ..Limits::default() });
    assert!(check.redo.iter().any(|r| r.contains("left") && r.contains("calib mono")), "{:?}", check.redo);
}

#[test]
fn a_board_or_a_rod_of_another_size_shows_in_the_scale() {
    let cameras = rig();
    let mut random = Pcg64Mcg::seed_from_u64(2);
    // Printed one percent too large.
    let seen = views(&cameras, 1.01, &mut random);
    let (mut check, _) = check_boards(&cameras, &seen, &Limits::default());
    assert!(
        (check.board_scale_error.expect("measured") - 0.01).abs() < 1e-3,
        "{:?}",
        check.board_scale_error
    );
    assert!(check.redo.iter().any(|r| r.contains("lengths on the board")), "{:?}", check.redo);

    let noise = Normal::new(0.0, 0.1).expect("positive");
    let mut points: Vec<MovingPoints> = cameras
        .iter()
        .map(|c| MovingPoints {
            name: c.name.clone(),
            model: c.model,
            pixels: Vec::new(),
            velocities: Vec::new(),
        })
        .collect();
    for _ in 0..60 {
        let middle = Vector3::new(
            random.random_range(-0.4..0.4),
            random.random_range(-0.3..0.3),
            random.random_range(1.7..2.3),
        );
        let along = Vector3::new(
            random.random_range(-1.0..1.0),
            random.random_range(-1.0..1.0),
            random.random_range(-1.0..1.0),
        )
        .normalize()
            * 0.25;
        for end in [middle - along, middle + along] {
            for (camera, own) in cameras.iter().zip(&mut points) {
                let at = &camera.camera_from_first * Point::<World>::from(end);
                let pixel = camera.model.project(&at).filter(|p| camera.model.contains(p));
                let shaken =
                    pixel.map(|p| p + Vector2::new(noise.sample(&mut random), noise.sample(&mut random)));
                own.pixels.push(shaken);
            }
        }
    }
    let ends = || (0..60).map(|i| (2 * i, 2 * i + 1));
    let rod = check_rod(&cameras, &points, ends(), 0.5).expect("seen");
    assert!(rod.scale_error.abs() < 1e-3 && rod.error_m.p95 < 1e-3, "{} {:?}", rod.scale_error, rod.error_m);
    check.redo.clear();
    let wrong = check_rod(&cameras, &points, ends(), 0.505).expect("seen");
    check.add_rod(wrong, &Limits::default());
    assert!(check.redo.iter().any(|r| r.contains("the rod comes out -0.9")), "{:?}", check.redo);
}
