//! What becomes of folders of pictures that are not as they should be.

mod support;

use std::{fs, path::Path, sync::Arc};

use netcord_calib::{
    detect::Depth,
    gather::{Rejection, pictures, read},
    session::{Reason, Session, SessionCamera, Setup, Shot, Sight, Task},
    solve::{CalibrationError, CameraViews, MonoOptions, RigOptions, calibrate_mono, calibrate_rig},
};
use support::{detector, shared};

/// What a session keeps of a folder, and why not the rest.
struct Gathered {
    views: CameraViews,
    rejected: Vec<(String, Rejection)>,
}

fn gathered(folder: &Path, spec: &str) -> Gathered {
    let detector = Arc::new(detector(spec));
    let camera = SessionCamera { name: "camera".to_owned(), model: None, camera_from_first: None };
    let mut session = Session::new(Setup::new(Task::Mono, vec![camera]), Arc::clone(&detector));
    let shot = |p: netcord_calib::gather::Picture| {
        let sight = read(&p.path).map(|luma| Sight::of(&luma, &detector, Depth::Final, None));
        Shot { name: p.name, sights: vec![Some(sight)] }
    };
    let shots = pictures(folder).expect("readable").into_iter().map(shot).collect();
    let offered = session.offer_all(shots).expect("gathers");
    let rejected = offered.into_iter().filter_map(|o| match o.verdict.cameras.into_iter().next()? {
        Some(Err(Reason::View(rejection))) => Some((o.name, rejection)),
        Some(Err(other)) => panic!("{}: {other}", o.name),
        _ => None,
    });
    let rejected = rejected.collect();
    Gathered { views: session.views().remove(0), rejected }
}

/// A folder with the left pictures of the stereo set; `None`, said aloud, where they are absent.
fn left() -> Option<tempfile::TempDir> {
    let from = shared("boards/chessboard-stereo")?;
    let folder = tempfile::tempdir().expect("a folder");
    for n in [1, 3, 5, 8, 11, 13] {
        let name = format!("left{n:02}.jpg");
        fs::copy(from.join(&name), folder.path().join(&name)).expect("copied");
    }
    Some(folder)
}

/// The reason why `name` was not kept.
fn reason<'a>(gathered: &'a Gathered, name: &str) -> &'a Rejection {
    &gathered.rejected.iter().find(|(n, _)| n == name).expect(name).1
}

#[test]
fn other_boards_are_told_by_what_was_seen_instead() {
    let Some(folder) = left() else { return };
    // Smaller than the board in the pictures: each says which it is.
    let found = gathered(folder.path(), "chessboard:8x5:25mm");
    assert!(found.views.views.is_empty(), "{} views", found.views.views.len());
    let said = reason(&found, "left01").to_string();
    assert!(said.contains("9 × 6 inner corners"), "{said}");
    // Larger: never seen whole.
    let found = gathered(folder.path(), "chessboard:10x7:25mm");
    assert!(
        matches!(reason(&found, "left01"), Rejection::NeverWhole { seen: (9, 6), .. }),
        "{:?}",
        found.rejected
    );
    let found = gathered(folder.path(), "charuco:5x7:DICT_6X6_250:40mm:20mm");
    let said = reason(&found, "left01").to_string();
    assert!(said.contains("charuco:5x7") && said.contains("9 × 6 inner corners"), "{said}");

    let Some(aruco) = shared("boards/aruco-opencv/opencv_charuco_calib") else { return };
    let found = gathered(&aruco, "charuco:5x7:DICT_4X4_50:40mm:20mm");
    let said = reason(&found, "img_00").to_string();
    assert!(found.views.views.is_empty() && said.contains("DICT_6X6"), "{said}");
}

#[test]
fn corrupt_files_and_other_sizes_are_named_and_the_rest_goes_on() {
    let Some(folder) = left() else { return };
    fs::write(folder.path().join("a-text.png"), "no picture").expect("written");
    let whole = fs::read(folder.path().join("left03.jpg")).expect("readable");
    fs::write(folder.path().join("cut.jpg"), &whole[..200]).expect("written");
    // The first by name has another size: that of most counts.
    let picture = image::open(folder.path().join("left05.jpg")).expect("a picture");
    let small = picture.resize_exact(480, 360, image::imageops::FilterType::Triangle);
    small.save(folder.path().join("aa.png")).expect("written");
    let found = gathered(folder.path(), "chessboard:9x6:25mm");
    assert_eq!(found.views.size, (640, 480));
    assert_eq!(found.views.views.len(), 6, "{:?}", found.rejected);
    assert!(matches!(reason(&found, "a-text"), Rejection::Unreadable(_)));
    assert!(matches!(reason(&found, "cut"), Rejection::Unreadable(_)));
    assert!(matches!(reason(&found, "aa"), Rejection::Size { found: (480, 360), expected: (640, 480) }));
}

#[test]
fn too_few_alike_and_unconnected_views_are_refused_with_advice() {
    let Some(folder) = left() else { return };
    let found = gathered(folder.path(), "chessboard:9x6:25mm").views;
    let mut few = found.clone();
    few.views.truncate(2);
    let error = calibrate_mono(&few, &MonoOptions::default()).expect_err("two views");
    assert!(matches!(error, CalibrationError::TooFewViews { found: 2, .. }), "{error}");

    let mut alike = found.clone();
    alike.views = vec![found.views[0].clone(); 5];
    for (i, view) in alike.views.iter_mut().enumerate() {
        view.name = format!("{i}");
    }
    let error = calibrate_mono(&alike, &MonoOptions::default()).expect_err("one view five times");
    assert!(matches!(error, CalibrationError::Alike { .. }), "{error}");
    let again = folder.path().join("left01-again.jpg");
    fs::copy(folder.path().join("left01.jpg"), &again).expect("copied");
    let twice = gathered(folder.path(), "chessboard:9x6:25mm");
    assert!(matches!(reason(&twice, "left01-again"), Rejection::Alike { .. }), "{:?}", twice.rejected);

    // Three views of four corners: 24 equations for 9 intrinsics and 18 of poses.
    let mut poor = found.clone();
    poor.views.truncate(3);
    for view in &mut poor.views {
        let corners = [0, 8, 45, 53];
        view.object = corners.map(|k| view.object[k]).to_vec();
        view.image = corners.map(|k| view.image[k]).to_vec();
    }
    let error = calibrate_mono(&poor, &MonoOptions::default()).expect_err("fewer equations than unknowns");
    assert!(
        matches!(error, CalibrationError::Underdetermined { equations: 24, unknowns: 27, .. }),
        "{error}"
    );

    let model = calibrate_mono(&found, &MonoOptions::default()).expect("calibrates").model;
    let mut other = found.clone();
    other.name = "other".to_owned();
    for view in &mut other.views {
        view.name.push('b');
    }
    let error = calibrate_rig(&[found, other], &[model, model], &RigOptions::default())
        .expect_err("nothing in common");
    let said = error.to_string();
    assert!(said.contains("other") && said.contains("no usable view"), "{said}");
}
