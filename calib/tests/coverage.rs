//! Whether the covariances mean what they say: scatter of seeded noisy runs against the truth.

use nalgebra::{Rotation3, SVector, Vector2, Vector3};
use netcord_calib::solve::{CameraViews, MonoOptions, RigOptions, View, calibrate_mono, calibrate_rig};
use netcord_common::{
    camera::{CameraModel, Distortion},
    geometry::{Board, Camera, Point, Transform, World},
};
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

const RUNS: u64 = 1200;
const NOISE_PX: f64 = 0.1;

fn camera(f: f64) -> CameraModel {
    let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
    CameraModel::new((1920, 1200), (f, f + 0.4), (984.047, 602.967), lens).expect("valid")
}

/// A 7 × 5 board of 60 mm squares.
fn board() -> Vec<Vector3<f64>> {
    (0..35).map(|i| Vector3::new(f64::from(i % 7) * 0.06, f64::from(i / 7) * 0.06, 0.0)).collect()
}

/// Boards across the view, tilted every way.
fn poses(rng: &mut impl Rng, count: usize) -> Vec<Transform<World, Board>> {
    (0..count)
        .map(|_| {
            let mut any = |a: f64| rng.random_range(-a..a);
            let turn = Rotation3::new(Vector3::new(any(0.7), any(0.7), any(1.5)));
            let centre = Vector3::new(any(0.7), any(0.4), 0.8 + any(0.3));
            Transform::new(turn, centre - turn * Vector3::new(0.18, 0.12, 0.0))
        })
        .collect()
}

fn views(
    name: &str,
    model: &CameraModel,
    camera_from_world: &Transform<Camera, World>,
    boards: &[Transform<World, Board>],
    rng: &mut impl Rng,
) -> CameraViews {
    let noise = Normal::new(0.0, NOISE_PX).expect("positive");
    let views = boards
        .iter()
        .enumerate()
        .map(|(i, world_from_board)| {
            let mut view = View::new(format!("{i}"), Vec::new(), Vec::new());
            for object in board() {
                let at = &(camera_from_world * world_from_board) * Point::from(object);
                let Some(pixel) = model.project(&at).filter(|p| model.contains(p)) else { continue };
                view.object.push(object);
                view.image.push(pixel + Vector2::new(noise.sample(rng), noise.sample(rng)));
            }
            view
        })
        .collect();
    CameraViews { name: name.to_owned(), size: (model.width, model.height), views }
}

/// Whether `share` of `RUNS` lies in 93–97 %.
fn assert_covers(inside: usize, what: &str) {
    let share = inside as f64 / RUNS as f64;
    println!("{what}: the truth lies in the 95 % ellipsoid in {:.1} % of {RUNS} runs", 100.0 * share);
    assert!((0.93..=0.97).contains(&share), "{what}: {share}");
}

#[test]
fn the_true_intrinsics_lie_in_the_95_percent_ellipsoid() {
    /// 95 % quantile of χ² with nine degrees of freedom.
    const CHI2_9: f64 = 16.919;
    let truth = camera(672.282);
    let inside = (0..RUNS)
        .into_par_iter()
        .filter(|seed| {
            let mut rng = Pcg64Mcg::seed_from_u64(*seed);
            let boards = poses(&mut rng, 10);
            let views = views("only", &truth, &Transform::identity(), &boards, &mut rng);
            let found = calibrate_mono(&views, &MonoOptions::default()).expect("calibrates");
            let off = SVector::<f64, 9>::from(found.model.parameters())
                - SVector::<f64, 9>::from(truth.parameters());
            let inverse = found.covariance.try_inverse().expect("positive");
            (off.transpose() * inverse * off)[0] < CHI2_9
        })
        .count();
    assert_covers(inside, "intrinsics");
}

#[test]
fn the_true_pose_of_the_second_camera_lies_in_the_95_percent_ellipsoid() {
    /// 95 % quantile of χ² with six degrees of freedom.
    const CHI2_6: f64 = 12.592;
    let models = [camera(672.282), camera(686.5)];
    let second = Transform::<Camera, World>::from_rodrigues(
        Vector3::new(0.05, -0.6, 0.02),
        Vector3::new(0.5, 0.02, 0.25),
    );
    let inside = (0..RUNS)
        .into_par_iter()
        .filter(|seed| {
            let mut rng = Pcg64Mcg::seed_from_u64(*seed);
            let boards = poses(&mut rng, 6);
            let cameras = [
                views("first", &models[0], &Transform::identity(), &boards, &mut rng),
                views("second", &models[1], &second, &boards, &mut rng),
            ];
            let found = calibrate_rig(&cameras, &models, &RigOptions::default()).expect("calibrates");
            let pose = &found.cameras[1].camera_from_first;
            let turn = (second.rotation * pose.rotation.inverse()).scaled_axis();
            let moved = second.translation - pose.translation;
            let off = SVector::<f64, 6>::from_iterator(turn.iter().chain(moved.iter()).copied());
            let covariance = found.cameras[1].covariance.fixed_view::<6, 6>(9, 9).into_owned();
            (off.transpose() * covariance.try_inverse().expect("positive") * off)[0] < CHI2_6
        })
        .count();
    assert_covers(inside, "pose");
}
