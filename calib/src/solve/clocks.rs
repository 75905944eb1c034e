//! Cameras whose clocks are off: a board that is carried about is seen too early or too late by them.

use netcord_common::geometry::{Board, Transform, World};
use rayon::prelude::*;

use super::{
    bundle::{Bundle, Sighting, Solution, SolveOptions},
    loss::Loss,
};

/// How far a camera's clock is off.
#[derive(Debug, Clone, PartialEq)]
pub struct Clock {
    /// How much later its frames were exposed than the others' of the same stamp, s; negative: earlier.
    pub later_s: f64,
    /// Its standard deviation, s: from the noise of the corners, or from how much the clock differs where a part of
    /// the views is left out, whichever is more. The latter holds jitter, and clocks that drift.
    pub sd_s: f64,
}

/// A clock that is believed to be off.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Found {
    /// As [`Clock::later_s`]; 0 where nothing is to be claimed.
    pub(super) later_s: f64,
    /// Its standard deviation by the jackknife, s.
    spread_s: f64,
}

type Boards = Bundle<6, Transform<World, Board>>;

/// A clock is believed from so many standard deviations…
const SURE: f64 = 4.0;
/// …if without it views that took no part cost more by this share: what a lens or a wrong corner feigns helps no
/// other view.
const GAIN: f64 = 0.1;
/// Longest error looked for, s: further on, a parabola through three looks no longer tells where a board is.
const LONGEST_S: f64 = 0.25;
/// Fewest views in motion, in common with other cameras, for a camera's clock.
const LEAST_VIEWS: usize = 6;
/// Parts into which views are divided to judge by those left out.
const FOLDS: usize = 2;
/// Parts of neighbouring views of which one at a time is left out to see how much a clock differs.
const PARTS: usize = 10;
/// As for views that contradict others: a pixel is no noise.
const LOSS: Loss = Loss::Cauchy { scale_px: 1.0 };

/// How much later each camera's frames were exposed than its stamps say, against the camera whose clock is in
/// the middle. The bundle must be near its solution.
///
/// Minimises Cauchy's loss of the corners, moved along their motion, over poses, boards and clocks. A clock is
/// accepted when it is [`SURE`] standard deviations off, by the noise and by the jackknife, and views that were left
/// out fit worse without it by [`GAIN`]; the least certain is dropped first.
pub(super) fn find_clocks(bundle: &Boards) -> Vec<Found> {
    let nothing = vec![Found::default(); bundle.cameras.len()];
    let moving = in_motion(bundle);
    let views = |c: usize| moving.sightings.iter().filter(|s| s.camera == c).count();
    let able: Vec<usize> = (0..bundle.cameras.len()).filter(|c| views(*c) >= LEAST_VIEWS).collect();
    if able.len() < 2 {
        return nothing;
    }
    let Some(all) = solved(&moving, &able[1..]) else { return nothing };
    // Against the clock in the middle as few as can be are off.
    let mut order = able.clone();
    order.sort_by(|a, b| all.0.cameras[*a].later_s.total_cmp(&all.0.cameras[*b].later_s));
    let middle = if able.len() == 2 { able[0] } else { order[(order.len() - 1) / 2] };
    let mut free: Vec<usize> = able.into_iter().filter(|c| *c != middle).collect();
    let Some(mut cost) = held_out(&moving, &free) else { return nothing };
    loop {
        let Some((solution, sd_s)) = solved(&moving, &free) else { return nothing };
        let sigmas = |c: usize| solution.cameras[c].later_s.abs() / sd_s[c].unwrap_or(f64::INFINITY);
        let Some(least) = free.iter().copied().min_by(|a, b| sigmas(*a).total_cmp(&sigmas(*b))) else {
            return nothing;
        };
        let without: Vec<usize> = free.iter().copied().filter(|c| *c != least).collect();
        let Some(cost_without) = held_out(&moving, &without) else { return nothing };
        let believed = sigmas(least) >= SURE
            && cost_without > (1.0 + GAIN) * cost
            && solution.cameras[least].later_s.abs() < LONGEST_S;
        if believed && let Some(spread_s) = spread(&solution) {
            let found: Vec<Found> = solution
                .cameras
                .iter()
                .zip(spread_s)
                .map(|(c, spread_s)| Found { later_s: c.later_s, spread_s })
                .collect();
            if free.iter().all(|c| found[*c].later_s.abs() >= SURE * found[*c].spread_s) {
                return found;
            }
        }
        (free, cost) = (without, cost_without);
    }
}

/// Standard deviations of the clocks of `free`, s, by the jackknife over [`PARTS`] of neighbouring views: what one
/// exposure's jitter does to all corners of a view, and a drift to all views of a while, the noise of corners does not
/// tell. (Efron and Tibshirani 1993, chapter 11, with groups.)
fn spread(solution: &Boards) -> Option<Vec<f64>> {
    let count = solution.blocks.len();
    let parts = PARTS.min(count);
    let without = |p: usize| -> Option<Vec<f64>> {
        let mut rest = part(solution, |b| b * parts / count != p);
        for (c, camera) in rest.cameras.iter_mut().enumerate() {
            // A camera that none of these boards ties to the others stays where it is.
            let seen = rest.sightings.iter().any(|s| s.camera == c);
            camera.freedom.pose &= seen;
            camera.freedom.clock &= seen;
        }
        // It begins at the solution: a few steps lead to where a part less puts it.
        rest.solve(&SolveOptions { loss: LOSS, max_steps: 12 })?;
        Some(rest.cameras.iter().map(|c| c.later_s).collect())
    };
    let found: Vec<Vec<f64>> = (0..parts).into_par_iter().map(without).collect::<Option<_>>()?;
    let n = parts as f64;
    let of_camera = |c: usize| {
        let mean = found.iter().map(|f| f[c]).sum::<f64>() / n;
        ((n - 1.0) / n * found.iter().map(|f| (f[c] - mean).powi(2)).sum::<f64>()).sqrt()
    };
    Some((0..solution.cameras.len()).map(of_camera).collect())
}

/// Whether the views tell anything of clocks: two cameras saw the board in motion at once, often enough.
pub(super) fn tells_of_clocks(bundle: &Boards) -> bool {
    let moving = in_motion(bundle);
    let able = |c: usize| moving.sightings.iter().filter(|s| s.camera == c).count() >= LEAST_VIEWS;
    (0..bundle.cameras.len()).filter(|c| able(*c)).count() >= 2
}

/// Only what moves, seen by two cameras or more; lenses stay as they are.
fn in_motion(bundle: &Boards) -> Boards {
    let mut moving = bundle.clone();
    moving.sightings.retain(|s| !s.motion.is_empty());
    for camera in &mut moving.cameras {
        camera.freedom.intrinsics = [false; 9];
    }
    part(&moving, |b| moving.sightings.iter().filter(|s| s.block == b).count() >= 2)
}

/// The part of a bundle that these boards make.
fn part(bundle: &Boards, keep: impl Fn(usize) -> bool) -> Boards {
    let mut place = vec![None; bundle.blocks.len()];
    let mut blocks = Vec::new();
    for (b, block) in bundle.blocks.iter().enumerate().filter(|(b, _)| keep(*b)) {
        place[b] = Some(blocks.len());
        blocks.push(*block);
    }
    let sightings = bundle.sightings.iter();
    let sightings =
        sightings.filter_map(|s| Some(Sighting { block: place[s.block]?, ..s.clone() })).collect();
    Bundle { cameras: bundle.cameras.clone(), blocks, sightings }
}

/// The bundle with the clocks of `free` found, and their standard deviations.
fn solved(bundle: &Boards, free: &[usize]) -> Option<(Boards, Vec<Option<f64>>)> {
    let mut bundle = bundle.clone();
    for (c, camera) in bundle.cameras.iter_mut().enumerate() {
        camera.freedom.clock = free.contains(&c);
        // A camera that none of these boards ties to the others stays where it is.
        camera.freedom.pose &= bundle.sightings.iter().any(|s| s.camera == c);
    }
    let solution = settle(&mut bundle)?;
    let variance = variance_px2(&bundle)?;
    let sd = |(c, state)| solution.clock_sd_s(c, state, variance);
    let sd_s = bundle.cameras.iter().enumerate().map(sd).collect();
    Some((bundle, sd_s))
}

/// Solves in two steps: far from the solution a loss that forgets what is far off would keep it far.
fn settle(bundle: &mut Boards) -> Option<Solution> {
    bundle.solve(&SolveOptions { loss: Loss::Huber { scale_px: 1.0 }, max_steps: 30 })?;
    bundle.solve(&SolveOptions { loss: LOSS, max_steps: 30 })
}

/// Variance of one coordinate, weighted as the solution was.
fn variance_px2(bundle: &Boards) -> Option<f64> {
    let (mut squares, mut weights) = (0.0, 0.0);
    for s in &bundle.sightings {
        for r in bundle.residuals(s)? {
            let weight = LOSS.weight(r.norm_squared());
            squares += weight * r.norm_squared();
            weights += weight;
        }
    }
    (weights > 0.0).then(|| squares / (2.0 * weights))
}

/// Mean cost of corners in views that took no part, with the clocks of `free` found from the others.
fn held_out(bundle: &Boards, free: &[usize]) -> Option<f64> {
    let (mut cost, mut points) = (0.0, 0usize);
    for fold in 0..FOLDS {
        let (found, _) = solved(&part(bundle, |b| b % FOLDS != fold), free)?;
        let mut fresh = part(bundle, |b| b % FOLDS == fold);
        for (camera, found) in fresh.cameras.iter_mut().zip(&found.cameras) {
            *camera = found.clone();
            camera.freedom.pose = false;
            camera.freedom.clock = false;
        }
        // Only the boards may move.
        cost += settle(&mut fresh)?.cost;
        points += fresh.points();
    }
    (points > 0).then(|| cost / points as f64)
}

/// The clock of camera `c` after the last solution.
pub(super) fn clock_of(
    bundle: &Boards,
    solution: &Solution,
    c: usize,
    variance_px2: f64,
    found: &Found,
) -> Option<Clock> {
    let state = &bundle.cameras[c];
    let by_noise = solution.clock_sd_s(c, state, variance_px2)?;
    Some(Clock { later_s: state.later_s, sd_s: by_noise.max(found.spread_s) })
}

/// Sightings of cameras whose clock is off and of which nobody knows how they move: where the board was is not
/// known, either. Per camera their number; they are taken out.
pub(super) fn drop_unmoved(bundle: &mut Boards) -> Vec<usize> {
    let mut dropped = vec![0; bundle.cameras.len()];
    let cameras = &bundle.cameras;
    bundle.sightings.retain(|s| {
        let useless = cameras[s.camera].later_s != 0.0 && s.motion.is_empty();
        dropped[s.camera] += usize::from(useless);
        !useless
    });
    dropped
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::{Rotation3, Vector2, Vector3};
    use netcord_common::{
        camera::{CameraModel, Distortion},
        geometry::{Board, Camera, Point, Transform, World},
    };
    use rand::{RngExt as _, SeedableRng as _};
    use rand_distr::{Distribution as _, Normal};
    use rand_pcg::Pcg64Mcg;

    use crate::solve::{CameraViews, RigCalibration, RigOptions, View, calibrate_rig, looks_around};

    /// Where a hand carries a board: three swings of different periods in each direction.
    fn pose(t: f64, phase: &[f64; 6]) -> Transform<World, Board> {
        let swing = |k: usize, reach: f64, period: f64| reach * (t / period * TAU + phase[k]).sin();
        let turn = Rotation3::new(Vector3::new(swing(0, 0.3, 3.1), swing(1, 0.4, 4.3), swing(2, 0.3, 5.7)));
        let at = Vector3::new(swing(3, 0.35, 3.7), swing(4, 0.25, 2.9), 2.0 + swing(5, 0.3, 4.1));
        Transform::new(turn, at - turn * Vector3::new(0.15, 0.1, 0.0))
    }

    /// Three cameras that see it 8 times a second, their frames exposed so much later than their stamps say.
    fn rig(later_s: [f64; 3], noise_px: f64, seed: u64) -> (Vec<CameraViews>, Vec<CameraModel>) {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let noise = Normal::new(0.0, noise_px).expect("positive");
        let phase: [f64; 6] = std::array::from_fn(|_| random.random_range(0.0..TAU));
        let lens = Distortion::from_array([-0.1, 0.05, 5e-4, -3e-4, 0.0]);
        let model = CameraModel::new((1280, 720), (900.0, 901.0), (642.0, 357.0), lens).expect("valid");
        let object: Vec<_> =
            (0..12).map(|i| Vector3::new(f64::from(i % 4) * 0.1, f64::from(i / 4) * 0.1, 0.0)).collect();
        let mut cameras = Vec::new();
        for (c, later_s) in later_s.into_iter().enumerate() {
            let turn = Rotation3::new(Vector3::new(0.0, c as f64 * 0.5, 0.0));
            let centre = Vector3::new(0.0, 0.0, 2.0);
            let camera_from_rig = Transform::<Camera, World>::new(turn, centre - turn * centre);
            let mut views = Vec::new();
            for k in 0..40 {
                // No two cameras are read out at quite the same instant.
                let stamp_ns = 1_000_000_000 + k * 125_000_000 + random.random_range(0..2_000_000);
                let at = pose(stamp_ns as f64 * 1e-9 + later_s, &phase);
                let mut view = View::new(format!("{k:03}"), Vec::new(), Vec::new());
                view.stamp_ns = Some(stamp_ns);
                for o in &object {
                    let pixel = model.project(&(&camera_from_rig * (&at * Point::from(*o))));
                    let Some(pixel) = pixel.filter(|p| model.contains(p)) else { continue };
                    view.object.push(*o);
                    view.image
                        .push(pixel + Vector2::new(noise.sample(&mut random), noise.sample(&mut random)));
                }
                if view.object.len() >= 8 {
                    views.push(view);
                }
            }
            let looks = views.clone();
            looks_around(&mut views, &looks);
            cameras.push(CameraViews { name: format!("cam{c}"), size: (1280, 720), views });
        }
        (cameras, vec![model; 3])
    }

    fn baseline_error_m(found: &RigCalibration) -> f64 {
        let turn = Rotation3::new(Vector3::new(0.0, 1.0, 0.0));
        let centre = Vector3::new(0.0, 0.0, 2.0);
        (found.cameras[2].camera_from_first.translation - (centre - turn * centre)).norm()
    }

    #[test]
    fn a_clock_that_is_off_is_found_with_its_uncertainty_and_its_views_stay() {
        for (seed, later_s) in [(1, [0.0, -0.06, 0.0]), (2, [0.03, 0.0, 0.0]), (3, [0.0, 0.0, 0.1])] {
            let (views, models) = rig(later_s, 0.15, seed);
            let found = calibrate_rig(&views, &models, &RigOptions::default()).expect("calibrates");
            for (member, truth) in found.cameras.iter().zip(later_s) {
                println!("{}: {:?}, true {truth} s", member.name, member.clock);
                match &member.clock {
                    Some(clock) => {
                        assert!(truth != 0.0, "{}: {clock:?}", member.name);
                        // The parabola through three looks is off by some 1 % of the way.
                        let allowed = 4.0 * clock.sd_s + 0.03 * truth.abs();
                        assert!((clock.later_s - truth).abs() < allowed, "{clock:?}, true {truth}");
                        assert!(clock.sd_s > 0.0 && clock.sd_s < 1e-3, "{clock:?}");
                    }
                    None => assert_eq!(truth, 0.0, "{}", member.name),
                }
            }
            assert!(found.rms_px < 0.5 && baseline_error_m(&found) < 2e-3, "{} px", found.rms_px);
            assert!(found.rejected.is_empty(), "{:?}", found.rejected);
        }
    }

    #[test]
    fn where_clocks_are_right_none_is_claimed() {
        for seed in 0..3 {
            let (mut views, models) = rig([0.0; 3], 0.3, 10 + seed);
            let found = calibrate_rig(&views, &models, &RigOptions::default()).expect("calibrates");
            assert!(found.cameras.iter().all(|c| c.clock.is_none()), "{:?}", found.cameras);
            // Nor where a lens is not as given, which is no matter of time.
            let mut wrong = models.clone();
            let mut p = wrong[1].parameters();
            (p[2], p[4]) = (p[2] + 5.0, p[4] + 0.02);
            wrong[1] = wrong[1].with_parameters(p).expect("valid");
            let found = calibrate_rig(&views, &wrong, &RigOptions::default()).expect("calibrates");
            assert!(found.cameras.iter().all(|c| c.clock.is_none()), "a lens: {:?}", found.cameras);
            // Without stamps nothing can be known.
            for view in views.iter_mut().flat_map(|c| &mut c.views) {
                (view.stamp_ns, view.motion) = (None, Vec::new());
            }
            let found = calibrate_rig(&views, &models, &RigOptions::default()).expect("calibrates");
            assert!(found.cameras.iter().all(|c| c.clock.is_none()));
        }
    }
}
