//! What calibration contributes to the error of positions over the table, on the example rig, with corners
//! ± 0.1 px; and what more frames are worth.

use std::{sync::Arc, time::Instant};

use nalgebra::{Rotation3, Vector2, Vector3};
use netcord_calib::{
    board::CalibrationBoard,
    check::nearest_point,
    detect::{BoardView, Corner, Detector},
    gather::GatherOptions,
    session::{self, Session, SessionCamera, Shot, Sight, Task},
    solve::{CameraViews, MonoOptions, RigCalibration, RigOptions, View, calibrate_mono, calibrate_rig},
};
use netcord_common::{
    camera::CameraModel,
    geometry::{Board, Camera, Point, Transform, World},
    rig::Rig,
};
use rand::{RngExt as _, SeedableRng as _};
use rand_distr::{Distribution as _, Normal};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

const NOISE_PX: f64 = 0.1;

struct Setup {
    rig: Rig,
    board: Vec<Vector3<f64>>,
    middle: Vector3<f64>,
}

impl Setup {
    /// The example rig, and a grid of large markers, 0.57 × 0.42 m.
    fn new() -> Self {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
        let board = CalibrationBoard::parse("aruco:4x3:DICT_4X4_50:120mm:30mm", |_| Err("none".into()));
        let board = board.expect("valid");
        let (low, high) = board.extent();
        let middle = (low + high) / 2.0;
        Self {
            rig: Rig::load(&path).expect("valid"),
            board: board.corners(),
            middle: Vector3::new(middle.x, middle.y, 0.0),
        }
    }

    fn view(&self, camera: usize, name: &str, pose: &Transform<World, Board>, random: &mut Pcg64Mcg) -> View {
        let noise = Normal::new(0.0, NOISE_PX).expect("positive");
        let camera = &self.rig.cameras[camera];
        let camera_from_board = &camera.camera_from_world * pose;
        let mut view = View::new(name.to_owned(), Vec::new(), Vec::new());
        for object in &self.board {
            let pixel = camera.model.project(&(&camera_from_board * Point::from(*object)));
            let Some(pixel) = pixel.filter(|p| camera.model.contains(p)) else { continue };
            view.object.push(*object);
            view.image.push(pixel + Vector2::new(noise.sample(random), noise.sample(random)));
        }
        view
    }

    /// Views of the board held before one camera.
    fn alone(&self, camera: usize, count: usize, random: &mut Pcg64Mcg) -> CameraViews {
        let model = &self.rig.cameras[camera].model;
        let world_from_camera = self.rig.cameras[camera].camera_from_world.inverse();
        let mut views = Vec::new();
        while views.len() < count {
            let pixel = Vector2::new(random.random_range(250.0..1670.0), random.random_range(200.0..1000.0));
            let sight = model.ray(&pixel).expect("inside");
            let facing = Rotation3::rotation_between(&Vector3::z(), &sight).expect("in front");
            let mut any = |reach: f64| random.random_range(-reach..reach);
            let turn = facing * Rotation3::new(Vector3::new(any(0.6), any(0.6), any(0.5)));
            let distance = 0.75 + any(0.2);
            let pose = Transform::<Camera, Board>::new(turn, sight * distance - turn * self.middle);
            let view = self.view(camera, &format!("{}", views.len()), &(&world_from_camera * &pose), random);
            if view.image.len() >= 24 {
                views.push(view);
            }
        }
        CameraViews {
            name: self.rig.cameras[camera].name.to_string(),
            size: (model.width, model.height),
            views,
        }
    }

    /// Simultaneous views of the board held face up over the table.
    fn together(&self, count: usize, random: &mut Pcg64Mcg) -> Vec<CameraViews> {
        let mut cameras: Vec<CameraViews> = self
            .rig
            .cameras
            .iter()
            .map(|c| CameraViews {
                name: c.name.to_string(),
                size: (c.model.width, c.model.height),
                views: Vec::new(),
            })
            .collect();
        let flat = Rotation3::new(Vector3::x() * std::f64::consts::PI);
        while cameras[0].views.len() < count {
            let mut any = |reach: f64| random.random_range(-reach..reach);
            let turn = Rotation3::new(Vector3::new(any(0.5), any(0.5), any(3.0))) * flat;
            let at = Vector3::new(any(0.5), any(0.9), 0.55 + any(0.35));
            let pose = Transform::new(turn, at - turn * self.middle);
            let name = format!("{}", cameras[0].views.len());
            let views = [0, 1].map(|c| self.view(c, &name, &pose, random));
            if views.iter().all(|v| v.image.len() >= 24) {
                for (camera, view) in cameras.iter_mut().zip(views) {
                    camera.views.push(view);
                }
            }
        }
        cameras
    }

    /// The views that a session keeps of these.
    fn chosen(
        &self,
        views: &[CameraViews],
        models: &[CameraModel],
        options: GatherOptions,
    ) -> Vec<CameraViews> {
        let board = CalibrationBoard::parse("aruco:4x3:DICT_4X4_50:120mm:30mm", |_| Err("none".into()));
        let camera = |(c, model): (&CameraViews, &CameraModel)| SessionCamera {
            name: c.name.clone(),
            model: Some(*model),
            camera_from_first: None,
        };
        let cameras = views.iter().zip(models).map(camera).collect();
        let task = session::Setup { options, ..session::Setup::new(Task::Rig, cameras) };
        let mut session = Session::new(task, Arc::new(Detector::new(board.expect("valid"))));
        let id = |object: &Vector3<f64>| self.board.iter().position(|b| b == object).expect("on the board");
        let sight = |c: &CameraViews, k: usize| {
            let view = &c.views[k];
            let corners = view.object.iter().zip(&view.image).map(|(o, at)| Corner { id: id(o), at: *at });
            let board = BoardView { corners: corners.collect(), markers: Vec::new(), anchored: true };
            Some(Ok(Sight { size: c.size, stamp_ns: None, board: Ok(board), blur_px: None }))
        };
        let shot = |k: usize| Shot {
            name: views[0].views[k].name.clone(),
            sights: views.iter().map(|c| sight(c, k)).collect(),
        };
        session.offer_all((0..views[0].views.len()).map(shot).collect()).expect("gathers");
        session.views()
    }

    /// Median error, m, over the volume in which the ball is played, of positions triangulated from exact
    /// pixels with the found rig; in the first camera's frame, nothing aligned.
    fn error(&self, found: &RigCalibration) -> f64 {
        let first = self.rig.cameras[0].camera_from_world;
        let mut errors = Vec::new();
        for k in 0..11 * 15 * 5 {
            let (i, j, l) = (k % 11, k / 11 % 15, k / 165);
            let at = Vector3::new(
                -0.76 + 0.152 * f64::from(i),
                -1.37 + 0.1957 * f64::from(j),
                0.02 + 0.12 * f64::from(l),
            );
            let pixels = [0, 1].map(|c| {
                let camera = &self.rig.cameras[c];
                camera
                    .model
                    .project(&(&camera.camera_from_world * Point::from(at)))
                    .filter(|p| camera.model.contains(p))
            });
            let [Some(p), Some(q)] = pixels else { continue };
            let rays = [p, q].into_iter().zip(&found.cameras);
            let rays = rays.filter_map(|(p, c)| Some((&c.camera_from_first, c.model.ray(&p)?)));
            let position = nearest_point(rays).expect("in view");
            errors.push((position - (&first * Point::from(at)).coords).norm());
        }
        errors.sort_by(f64::total_cmp);
        assert!(errors.len() > 500, "{} places in both views", errors.len());
        errors[errors.len() / 2]
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn models(setup: &Setup, count: usize, random: &mut Pcg64Mcg) -> Vec<CameraModel> {
    let mono = |camera| calibrate_mono(&setup.alone(camera, count, random), &MonoOptions::default());
    [0, 1].map(mono).map(|c| c.expect("calibrates").model).to_vec()
}

#[test]
fn thirty_views_leave_less_than_half_a_millimetre() {
    let setup = Setup::new();
    let errors: Vec<f64> = (0..10_u64)
        .into_par_iter()
        .map(|seed| {
            let mut random = Pcg64Mcg::seed_from_u64(seed);
            let models = models(&setup, 30, &mut random);
            let views = setup.together(30, &mut random);
            let found = calibrate_rig(&views, &models, &RigOptions::default()).expect("calibrates");
            setup.error(&found)
        })
        .collect();
    let worst = errors.iter().copied().fold(0.0, f64::max);
    println!(
        "median error over the table: {:.3} mm (worst of 10 runs {:.3} mm)",
        median(errors) * 1e3,
        worst * 1e3
    );
    assert!(worst <= 0.5e-3, "{worst} m");
}

#[test]
fn few_frames_chosen_well_are_as_good_as_many() {
    let setup = Setup::new();
    let run = |count: usize, max_iou: f64| -> (f64, f64, usize) {
        let results: Vec<(f64, f64, usize)> = (0..4_u64)
            .map(|seed| {
                let mut random = Pcg64Mcg::seed_from_u64(100 + seed);
                let models = models(&setup, 30, &mut random);
                let mut views = setup.together(count, &mut random);
                let options = GatherOptions { max_iou, max_views: 30, ..GatherOptions::default() };
                if max_iou < 1.0 {
                    views = setup.chosen(&views, &models, options);
                }
                let begin = Instant::now();
                let found = calibrate_rig(&views, &models, &RigOptions::default()).expect("calibrates");
                (setup.error(&found), begin.elapsed().as_secs_f64() * 1e3, views[0].views.len())
            })
            .collect();
        let error = median(results.iter().map(|r| r.0).collect());
        (error, median(results.iter().map(|r| r.1).collect()), results[0].2)
    };
    println!("frames given   kept   median error   time");
    let mut errors = Vec::new();
    for (count, max_iou) in [(5, 1.0), (10, 1.0), (20, 1.0), (30, 1.0), (60, 1.0), (120, 1.0), (120, 0.5)] {
        let (error, time_ms, kept) = run(count, max_iou);
        println!("{count:>12} {kept:>6} {:>11.3} mm {time_ms:>6.1} ms", error * 1e3);
        errors.push(error);
    }
    let (five, thirty, all, chosen) = (errors[0], errors[3], errors[5], errors[6]);
    assert!(thirty < five, "thirty frames are better than five");
    // What the intrinsics leave does not go away with more frames of both cameras.
    assert!(thirty < 1.5 * all && chosen < 1.5 * all, "thirty {thirty}, chosen {chosen}, all {all}");
}
