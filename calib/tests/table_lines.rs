//! The table's lines found in rendered pictures, and the table's pose from them, against the truth.

use nalgebra::{Rotation3, Vector2, Vector3};
use netcord_calib::{
    detect::Luma,
    table::{
        BORDER_LINE_M, FoundMark, TABLE_LENGTH_M, TABLE_WIDTH_M, Table, TableCamera, TableSighting,
        calibrate_table, find_marks,
    },
};
use netcord_common::{
    camera::{CameraModel, Distortion},
    geometry::{Camera, Point, Transform},
};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// A wide camera of 1280 × 800 px.
fn lens() -> CameraModel {
    let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
    CameraModel::new((1280, 800), (730.0, 730.0), (656.0, 402.0), lens).expect("valid")
}

/// Camera from table, by where the camera stands and what it looks at.
fn looking(from: Vector3<f64>, to: Vector3<f64>) -> Transform<Camera, Table> {
    let z = (to - from).normalize();
    let x = z.cross(&Vector3::z()).normalize();
    let turn = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]).inverse();
    Transform::new(turn, -(turn * from))
}

/// Grey of what lies at a place: a table with its lines, 0.76 m above a floor of boards, someone's arm over it.
fn grey(at: &Vector2<f64>, arm: bool) -> f64 {
    let (x, y) = (TABLE_WIDTH_M / 2.0 - at.x.abs(), TABLE_LENGTH_M / 2.0 - at.y.abs());
    if arm && (at.y - 0.4).abs() < 0.15 && at.x > 0.1 {
        return 150.0;
    }
    if x < 0.0 || y < 0.0 {
        // Boards, lighter and darker ones.
        return if (at.x * 4.0).rem_euclid(1.0) < 0.5 { 95.0 } else { 120.0 };
    }
    if x < BORDER_LINE_M || y < BORDER_LINE_M || at.x.abs() < 0.0015 { 215.0 } else { 60.0 }
}

fn picture(model: &CameraModel, pose: &Transform<Camera, Table>, arm: bool, noise: f64) -> Luma {
    let table_from_camera = pose.inverse();
    let origin = table_from_camera.translation;
    let (w, h) = (model.width as usize, model.height as usize);
    let noise = Normal::new(0.0, noise).expect("positive");
    let data: Vec<u8> = (0..h)
        .into_par_iter()
        .flat_map_iter(|v| {
            let mut random = Pcg64Mcg::seed_from_u64(v as u64);
            (0..w)
                .map(|u| {
                    let ray = |u: f64, v: f64| model.undistort(&Vector2::new(u, v)).expect("inside");
                    let middle = ray(u as f64, v as f64);
                    let (right, down) =
                        (ray(u as f64 + 1.0, v as f64) - middle, ray(u as f64, v as f64 + 1.0) - middle);
                    let mut sum = 0.0;
                    // Samples spread as a triangle of 3 px: a blur of 0.6 px.
                    let spread = |k: i32| f64::from(k) * 0.5;
                    let weight = |k: i32| 1.0 - f64::from(k.abs()) / 3.0;
                    let (mut total, taps) = (0.0, -2..=2);
                    for (i, j) in taps.clone().flat_map(|j| taps.clone().map(move |i| (i, j))) {
                        let n = middle + right * spread(i) + down * spread(j);
                        let way = table_from_camera.rotation * Vector3::new(n.x, n.y, 1.0);
                        let hit = origin - way * (origin.z / way.z);
                        let shade = if way.z < -1e-3 { grey(&hit.xy(), arm) } else { 100.0 };
                        sum += weight(i) * weight(j) * shade;
                        total += weight(i) * weight(j);
                    }
                    (sum / total + noise.sample(&mut random)).round().clamp(0.0, 255.0) as u8
                })
                .collect::<Vec<_>>()
        })
        .collect();
    Luma::new(w, h, data).expect("fits")
}

/// The pose as somebody who clicks in a hurry has it: 2 cm and half a degree off.
fn rough(pose: &Transform<Camera, Table>, random: &mut Pcg64Mcg) -> Transform<Camera, Table> {
    let mut any = |reach: f64| random.random_range(-reach..reach);
    let turn = Rotation3::new(Vector3::new(any(0.008), any(0.008), any(0.008)));
    let moved = Vector3::new(any(0.02), any(0.02), any(0.02));
    Transform::new(turn * pose.rotation, pose.translation + moved)
}

fn off_px(found: &[FoundMark], model: &CameraModel, pose: &Transform<Camera, Table>) -> Vec<f64> {
    let truth = |m: &FoundMark| model.project(&(pose * Point::from(m.on_table))).expect("in view");
    found.iter().map(|m| (m.at - truth(m)).norm()).collect()
}

#[test]
fn crossings_are_found_to_a_fraction_of_a_pixel_and_give_the_pose() {
    let model = lens();
    let mut random = Pcg64Mcg::seed_from_u64(1);
    // From beside the table, from behind an end, and from a corner near the table.
    let stands = [
        (Vector3::new(2.6, 0.3, 1.6), Vector3::new(0.0, 0.0, 0.0)),
        (Vector3::new(0.4, -3.2, 1.9), Vector3::new(0.0, 0.1, 0.0)),
        (Vector3::new(-1.9, -2.0, 1.5), Vector3::new(0.0, 0.0, 0.0)),
    ];
    for (arm, noise, limit_px) in [(false, 1.5, 0.1), (true, 4.0, 0.12)] {
        for (from, to) in stands {
            let pose = looking(from, to);
            let image = picture(&model, &pose, arm, noise);
            let found = find_marks(&image, &model, &rough(&pose, &mut random));
            let off = off_px(&found, &model, &pose);
            let named: Vec<String> = found
                .iter()
                .zip(&off)
                .map(|(m, o)| format!("{} {o:.2} (± {:.2})", m.mark, m.sigma_px))
                .collect();
            println!("arm {arm}, from {:.1?}: {}", from.as_slice(), named.join(", "));
            assert!(found.len() >= 5, "{} marks", found.len());
            assert!(off.iter().all(|o| *o < limit_px), "{off:?}");

            let cameras =
                [TableCamera { name: "camera".to_owned(), model, camera_from_first: Transform::identity() }];
            let sightings: Vec<TableSighting> = found
                .iter()
                .map(|m| TableSighting { camera: 0, mark: m.mark.clone(), on_table: m.on_table, pixel: m.at })
                .collect();
            let table = calibrate_table(&cameras, &sightings, &[], None, None).expect("a pose");
            let far = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(x, y): (f64, f64)| {
                let corner = Point::new(x * TABLE_WIDTH_M / 2.0, y * TABLE_LENGTH_M / 2.0, 0.0);
                ((&table.first_from_table * corner).coords - (&pose * corner).coords).norm()
            });
            let worst = far.into_iter().fold(0.0, f64::max);
            println!("  a corner of the table is off by at most {:.1} mm", worst * 1e3);
            assert!(worst < 1e-3, "{worst} m");
        }
    }
}

#[test]
fn without_a_table_nothing_is_found() {
    let model = lens();
    let pose = looking(Vector3::new(2.6, 0.3, 1.6), Vector3::zeros());
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let data = (0..1280 * 800).map(|_| random.random_range(80..120)).collect();
    let noise = Luma::new(1280, 800, data).expect("fits");
    assert_eq!(find_marks(&noise, &model, &pose), []);
    // A table that stands 30 cm from where it is looked for gives nothing that passes for it.
    let image = picture(&model, &pose, false, 1.5);
    let elsewhere = looking(Vector3::new(2.6, 0.6, 1.6), Vector3::new(0.0, 0.3, 0.0));
    let found = find_marks(&image, &model, &elsewhere);
    assert!(found.len() <= 1, "{found:?}");
}
