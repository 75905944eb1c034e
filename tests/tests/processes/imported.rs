//! Pictures that somebody took with one camera: imported and searched without a rig file and a calibration.

use std::fs;

use image::{Rgb, RgbImage};
use netcord_tests::Lab;

const RADIUS_PX: f64 = 12.0;
const PICTURES: u32 = 12;

/// Where the ball is in picture `k`, px.
fn ball(k: u32) -> [f64; 2] {
    [80.0 + 40.3 * f64::from(k), 150.0 + 10.7 * f64::from(k)]
}

/// A white disc before a dull wall, each pixel by sixty-four samples.
fn picture(k: u32) -> RgbImage {
    let [u, v] = ball(k);
    RgbImage::from_fn(640, 400, |x, y| {
        let wall = [70.0 + 15.0 * f64::from((x / 40 + y / 40) % 2), 80.0, 60.0 + 10.0 * f64::from(y / 100)];
        let inside = (0..64)
            .filter(|i| {
                let at = |pixel: u32, step: u32| f64::from(pixel) + (f64::from(step) + 0.5) / 8.0 - 0.5;
                (at(x, i % 8) - u).hypot(at(y, i / 8) - v) < RADIUS_PX
            })
            .count();
        let share = inside as f64 / 64.0;
        Rgb(wall.map(|level| (level + share * (225.0 - level)).round() as u8))
    })
}

#[test]
fn pictures_of_one_camera_are_searched_without_a_calibration() {
    let lab = Lab::new();
    fs::create_dir_all(lab.path("pictures")).expect("a folder");
    for k in 0..PICTURES {
        picture(k).save(lab.path("pictures").join(format!("{k:02}.png"))).expect("written");
    }
    let path = |name: &str| lab.path(name).display().to_string();
    let (pictures, film, out) = (path("pictures"), path("film.mcap"), path("out.mcap"));
    let (positions, detections) = (path("positions.csv"), path("detections.csv"));
    let ended = lab.start(&["import", &pictures, "--out", &film]).wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    let files = ["--out", &out, "--positions", &positions, "--detections", &detections];
    let ended = lab.start(&[&["process", &film, "--ball", "white"], &files[..]].concat()).wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    assert!(ended.err.contains("no calibration"), "{}", ended.err);

    let table = fs::read_to_string(&detections).expect("detections");
    let rows: Vec<Vec<f64>> = table
        .lines()
        .skip(1)
        .map(|row| row.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect())
        .collect();
    // A hundred pictures a second, unless told otherwise; the last one has a ball for certain.
    let last_ns = rows.iter().map(|row| row[0]).fold(0.0, f64::max);
    // The background is learnt from the first pictures; in the first of all, any ball is part of it.
    let found = (PICTURES / 2..PICTURES).filter(|k| {
        let [u, v] = ball(*k);
        rows.iter().any(|row| {
            let before_last = ((last_ns - row[0]) * 1e-7).round();
            before_last == f64::from(PICTURES - 1 - k) && (row[2] - u).hypot(row[3] - v) < 0.5 && row[8] > 0.5
        })
    });
    assert_eq!(found.count() as u32, PICTURES / 2, "{table}");
}
