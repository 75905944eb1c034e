//! The whole triangulator on simulated scenes, projected by other code than its own.

use nalgebra::{Matrix3, Vector2, Vector3};
use netcord_common::wire::{
    BallPosition, Detection, DetectionFlags, Detections, NoPosition, PositionOutcome, Scope,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::{
    TriangulateOptions, Triangulator,
    testing::{Plain, detection, example, message, stroke},
};

fn process(triangulator: &mut Triangulator, messages: &[Detections]) -> BallPosition {
    let refs: Vec<_> = messages.iter().collect();
    triangulator.process(&refs)
}

fn error_m(position: &BallPosition, truth: &Vector3<f64>) -> f64 {
    assert_eq!(position.outcome(), PositionOutcome::Position);
    (Vector3::from(position.position_m) - truth).norm()
}

fn clutter(random: &mut Pcg64) -> Detection {
    Detection {
        u_px: random.random_range(0.0..1919.0),
        v_px: random.random_range(0.0..1199.0),
        covariance_px2: [0.1, 0.0, 0.1],
        diameter_px: random.random_range(5.0..30.0),
        score: random.random_range(0.0..0.9),
        flags: DetectionFlags::SPHERE_CORRECTED,
        ..Detection::default()
    }
}

fn seen_by_all(plain: &[Plain], ball: &Vector3<f64>, trigger: u64, random: &mut Pcg64) -> Vec<Detections> {
    (0..plain.len())
        .map(|i| message(i, trigger, Scope::Full, &[detection(&plain[i], ball, 0.2, random)]))
        .collect()
}

#[test]
fn a_clean_ball_is_found_to_millimetres_by_2_4_and_8_cameras() {
    let mut random = Pcg64::seed_from_u64(1);
    for n in [2, 4, 8] {
        let (rig, plain) = example(n);
        let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
        let mut squares = 0.0;
        for trigger in 1..=40 {
            let ball = stroke(trigger as f64 * 0.01);
            let position = process(&mut triangulator, &seen_by_all(&plain, &ball, trigger, &mut random));
            squares += error_m(&position, &ball).powi(2);
            assert_eq!((position.view_count() as usize, position.rejected), (n, 0));
            assert_eq!((position.trigger_id, position.sequence), (trigger, trigger));
            assert_eq!(position.stamps.mid_exposure_ns, trigger * 10_000_000);
        }
        let rms = (squares / 40.0).sqrt();
        assert!(rms < 1.5e-3, "{n} cameras: {rms}");
    }
}

#[test]
fn the_ball_is_picked_among_fifteen_others_in_each_camera() {
    let mut random = Pcg64::seed_from_u64(2);
    for n in [2, 4, 8] {
        let (rig, plain) = example(n);
        let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
        let (mut right, mut shown) = (0, 0);
        for trigger in 1..=400 {
            let ball = stroke((trigger % 45) as f64 * 0.01);
            let messages: Vec<_> = (0..n)
                .map(|i| {
                    let mut items: Vec<_> = (0..15).map(|_| clutter(&mut random)).collect();
                    items.push(detection(&plain[i], &ball, 0.2, &mut random));
                    message(i, trigger, Scope::Full, &items)
                })
                .collect();
            let position = process(&mut triangulator, &messages);
            shown += 1;
            right += u32::from(position.is_present() && error_m(&position, &ball) < 0.02);
        }
        let share = f64::from(right) / f64::from(shown);
        // With two cameras a chance pair on one epipolar line is a ball as good as any, but for its size.
        assert!(share > if n == 2 { 0.97 } else { 0.999 }, "{n} cameras: {share}");
    }
}

/// A thing that does not move and looks better than the ball.
fn decoy(plain: &Plain, random: &mut Pcg64, flagged: bool) -> Detection {
    let mut d = detection(plain, &Vector3::new(0.4, 0.9, 0.32), 0.1, random);
    d.score = 0.99;
    d.flags |= if flagged { DetectionFlags::AT_REST } else { 0 };
    d
}

#[test]
fn what_does_not_move_never_beats_the_moving_ball_but_is_reported_alone() {
    let mut random = Pcg64::seed_from_u64(3);
    for (n, flagged) in [(2, true), (2, false), (4, true), (4, false)] {
        let (rig, plain) = example(n);
        let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
        let spot = Vector3::new(0.4, 0.9, 0.32);
        let mut scene = |trigger: u64, ball: Option<Vector3<f64>>, views: usize| {
            let messages: Vec<_> = (0..n)
                .map(|i| {
                    let mut items = vec![decoy(&plain[i], &mut random, flagged)];
                    if let Some(ball) = ball.filter(|_| i < views) {
                        items.push(detection(&plain[i], &ball, 0.2, &mut random));
                    }
                    message(i, trigger, Scope::Full, &items)
                })
                .collect();
            process(&mut triangulator, &messages)
        };
        for trigger in 1..=60 {
            assert!(error_m(&scene(trigger, None, 0), &spot) < 0.01, "alone it is the ball");
        }
        for trigger in 61..=100 {
            let ball = stroke((trigger - 61) as f64 * 0.01);
            // With four cameras the decoy has four views and the ball only three.
            let position = scene(trigger, Some(ball), 3);
            assert!(error_m(&position, &ball) < 0.01, "{n} cameras, flagged {flagged}, trigger {trigger}");
        }
        let position = scene(101, None, 0);
        assert_eq!(
            position.outcome(),
            PositionOutcome::None(NoPosition::NoDetection),
            "it was there beside the ball, so it is none"
        );
    }
}

#[test]
fn what_lies_on_the_table_is_no_ball_in_play_but_what_bounces_there_is() {
    let mut random = Pcg64::seed_from_u64(5);
    let (rig, plain) = example(2);
    let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
    for trigger in 1..=5 {
        let lying = Vector3::new(0.4, 0.9, 0.02);
        let position = process(&mut triangulator, &seen_by_all(&plain, &lying, trigger, &mut random));
        assert_eq!(position.outcome(), PositionOutcome::None(NoPosition::NoDetection));
    }
    for i in 0..40 {
        // Down at 3 m/s from 0.32 m above the point of contact, and up again.
        let t = f64::from(i) * 0.01 - 0.1;
        let ball = Vector3::new(0.1, -0.5 + 4.0 * t, 0.02 + 3.0 * t.abs());
        let trigger = 6 + i as u64;
        let position = process(&mut triangulator, &seen_by_all(&plain, &ball, trigger, &mut random));
        assert!(error_m(&position, &ball) < 0.01, "trigger {trigger}");
    }
}

#[test]
fn every_absence_has_its_reason() {
    let mut random = Pcg64::seed_from_u64(4);
    let (rig, plain) = example(2);
    let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
    let ball = Vector3::new(0.1, 0.2, 0.3);
    let [left, right] = [0, 1].map(|i| detection(&plain[i], &ball, 0.1, &mut random));
    let mut outcome = |l: &[Detection], r: &[Detection], skew_ns: u64| {
        let mut messages = [message(0, 1, Scope::Full, l), message(1, 1, Scope::Full, r)];
        messages[1].stamps.mid_exposure_ns += skew_ns;
        process(&mut triangulator, &messages).outcome()
    };
    let none = PositionOutcome::None;
    assert_eq!(outcome(&[], &[], 0), none(NoPosition::NoDetection));
    assert_eq!(outcome(&[left], &[], 0), none(NoPosition::OneView));
    assert_eq!(outcome(&[left], &[right], 0), PositionOutcome::Position);
    assert_eq!(outcome(&[left], &[right], rig.tolerance_ns), PositionOutcome::Position);
    assert_eq!(outcome(&[left], &[right], rig.tolerance_ns + 1), none(NoPosition::NotSynchronised));
    let off = Detection { v_px: right.v_px + 30.0, u_px: right.u_px + 30.0, ..right };
    assert_eq!(outcome(&[left], &[off], 0), none(NoPosition::ResidualTooLarge));
    let nan = Detection { u_px: f64::NAN, ..right };
    assert_eq!(outcome(&[left], &[nan], 0), none(NoPosition::OneView));
    let mut one = message(0, 2, Scope::Full, &[left]);
    assert_eq!(triangulator.process(&[&one]).outcome(), none(NoPosition::OneView));
    assert_eq!(triangulator.process(&[]).outcome(), none(NoPosition::NoDetection));
    one.camera = 99;
    assert_eq!(triangulator.process(&[&one]).outcome(), none(NoPosition::NoDetection), "no such camera");
}

#[test]
fn a_camera_that_exposes_at_another_time_is_left_out_while_others_suffice() {
    let mut random = Pcg64::seed_from_u64(5);
    let (rig, plain) = example(4);
    let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
    let ball = Vector3::new(0.1, 0.2, 0.3);
    let mut messages = seen_by_all(&plain, &ball, 1, &mut random);
    messages[0].stamps.mid_exposure_ns += rig.tolerance_ns + 1;
    let position = process(&mut triangulator, &messages);
    assert!(error_m(&position, &ball) < 0.005);
    assert_eq!(position.views, 0b1110);
    assert_eq!(position.stamps.mid_exposure_ns, 10_000_000, "that of the first camera that took part");
}

/// Upper 95 % point of χ² with three degrees of freedom.
const CHI2_3_95: f64 = 7.814_728;

#[test]
fn of_the_true_errors_93_to_97_per_cent_lie_in_the_95_per_cent_ellipsoid() {
    for (n, stated) in [(2, 1.0), (4, 1.0), (8, 1.0), (2, 0.5), (4, 2.0)] {
        let (rig, plain) = example(n);
        let mut random = Pcg64::seed_from_u64(6);
        let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
        let (mut inside, mut all) = (0, 0);
        for trigger in 1..=6000_u64 {
            let ball = stroke((trigger % 45) as f64 * 0.01);
            let messages: Vec<_> = (0..n)
                .map(|i| {
                    let sigma = random.random_range(0.05..0.4);
                    let mut d = detection(&plain[i], &ball, sigma, &mut random);
                    // The segmenter may be wrong about its accuracy: the rolling variance finds out.
                    d.covariance_px2 = d.covariance_px2.map(|c| c * stated * stated);
                    message(i, trigger, Scope::Full, &[d])
                })
                .collect();
            let position = process(&mut triangulator, &messages);
            if trigger <= 500 {
                continue;
            }
            let error = Vector3::from(position.position_m) - ball;
            let covariance = Matrix3::from_row_slice(&position.covariance_m2);
            let distance2 = error.dot(&(covariance.try_inverse().expect("regular") * error));
            all += 1;
            inside += u32::from(position.is_present() && distance2 <= CHI2_3_95);
        }
        let share = f64::from(inside) / f64::from(all);
        println!("{n} cameras, stated / true sigma {stated}: {:.1} % inside", 100.0 * share);
        assert!((0.93..=0.97).contains(&share), "{n} cameras, stated {stated}: {share}");
    }
}

#[test]
fn an_uncorrected_outline_is_corrected_for_the_sphere() {
    // The outline: the circle in which the cone from the projection centre touches the sphere. Its image
    // without distortion is symmetric about its centre: the middle of its extremes.
    let outline_centre = |plain: &Plain, ball: &Vector3<f64>, radius: f64| {
        let c = plain.r * ball + plain.t;
        let along = c.normalize();
        let across = along.cross(&Vector3::x()).normalize();
        let third = along.cross(&across);
        let middle = c - along * (radius * radius / c.norm());
        let r = radius * (1.0 - (radius / c.norm()).powi(2)).sqrt();
        let (mut low, mut high) = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
        for i in 0..100_000 {
            let a = f64::from(i) * std::f64::consts::TAU / 1e5;
            let p = middle + across * (r * a.cos()) + third * (r * a.sin());
            let pixel =
                Vector2::new(plain.k[0] * p.x / p.z + plain.k[2], plain.k[1] * p.y / p.z + plain.k[3]);
            (low, high) = (low.inf(&pixel), high.sup(&pixel));
        }
        (low + high) * 0.5
    };
    let (mut rig, mut plain) = example(2);
    for (camera, p) in rig.cameras.iter_mut().zip(&mut plain) {
        p.d = [0.0; 5];
        camera.model = netcord_common::camera::CameraModel::new(
            (1920, 1200),
            (p.k[0], p.k[1]),
            (p.k[2], p.k[3]),
            netcord_common::camera::Distortion::default(),
        )
        .expect("valid");
    }
    rig.ball.diameter_m = 0.1; // So large that the bias is a third of a pixel.
    let ball = Vector3::new(0.5, -0.9, 0.5);
    let mut random = Pcg64::seed_from_u64(7);
    let messages: Vec<_> = (0..2)
        .map(|i| {
            let centre = outline_centre(&plain[i], &ball, 0.05);
            let mut d = detection(&plain[i], &ball, 0.01, &mut random);
            (d.u_px, d.v_px, d.flags, d.diameter_px) = (centre.x, centre.y, 0, 0.0);
            message(i, 1, Scope::Full, &[d])
        })
        .collect();
    let corrected = process(&mut Triangulator::new(&rig, &TriangulateOptions::default()), &messages);
    assert!(error_m(&corrected, &ball) < 2e-6, "{:e}", error_m(&corrected, &ball));
    let mut as_points = messages;
    as_points.iter_mut().for_each(|m| m.items[0].flags = DetectionFlags::SPHERE_CORRECTED);
    let biased = process(&mut Triangulator::new(&rig, &TriangulateOptions::default()), &as_points);
    assert!(error_m(&biased, &ball) > 2e-4, "the bias that was corrected");
}

#[test]
fn a_slightly_wrong_calibration_costs_accuracy_but_no_position() {
    let mut random = Pcg64::seed_from_u64(8);
    for n in [2, 4, 8] {
        let (rig, mut plain) = example(n);
        for p in &mut plain {
            let turn = Vector3::from_fn(|_, _| random.random_range(-0.001..0.001));
            p.r = nalgebra::Rotation3::new(turn).matrix() * p.r;
        }
        let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
        for trigger in 1..=200 {
            let ball = stroke((trigger % 45) as f64 * 0.01);
            let position = process(&mut triangulator, &seen_by_all(&plain, &ball, trigger, &mut random));
            assert!(error_m(&position, &ball) < 0.01, "{n} cameras, trigger {trigger}");
        }
    }
}

#[test]
fn two_look_alikes_make_no_phantom_where_their_lines_of_sight_cross() {
    let mut random = Pcg64::seed_from_u64(9);
    let (rig, plain) = example(2);
    let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
    // The plane through both cameras and one ball on the table cuts the table in a line: another ball on it.
    let centre = |p: &Plain| -(p.r.transpose() * p.t);
    let (a, b) = (centre(&plain[0]), centre(&plain[1]));
    let first = Vector3::new(0.1, -0.3, 0.020);
    let normal = (a - first).cross(&(b - first));
    let along = normal.cross(&Vector3::z()).normalize();
    let second = first + along * 0.05;
    assert!((second.z - first.z).abs() < 1e-12);
    let mut false_positions = 0;
    for trigger in 1..=200_u64 {
        let rolled = along * (0.0004 * trigger as f64);
        let messages: Vec<_> = (0..2)
            .map(|i| {
                let items =
                    [first, second].map(|ball| detection(&plain[i], &(ball + rolled), 0.1, &mut random));
                message(i, trigger, Scope::Full, &items)
            })
            .collect();
        false_positions += u32::from(process(&mut triangulator, &messages).is_present());
    }
    assert_eq!(false_positions, 0);
}

#[test]
fn two_limbs_that_happen_to_lie_on_one_epipolar_line_are_no_ball() {
    let mut random = Pcg64::seed_from_u64(10);
    let (rig, plain) = example(2);
    let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
    for trigger in 1..=20_u64 {
        let place = Vector3::new(0.3, 0.5 + 0.004 * trigger as f64, 0.5);
        let messages: Vec<_> = (0..2)
            .map(|i| {
                let limb = Detection { score: 0.4, ..detection(&plain[i], &place, 0.2, &mut random) };
                message(i, trigger, Scope::Full, &[limb])
            })
            .collect();
        assert!(!process(&mut triangulator, &messages).is_present(), "trigger {trigger}");
    }
}

#[test]
fn views_that_may_be_anywhere_do_not_agree_by_chance() {
    let mut random = Pcg64::seed_from_u64(11);
    let (rig, plain) = example(2);
    let place = Vector3::new(0.3, 0.5, 0.5);
    let mut found = |variance: f64| {
        let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
        let messages: Vec<_> = (0..2)
            .map(|i| {
                let mut seen = Detection { score: 0.6, ..detection(&plain[i], &place, 0.1, &mut random) };
                seen.covariance_px2 = [variance, 0.0, variance];
                message(i, 1, Scope::Full, &[seen])
            })
            .collect();
        process(&mut triangulator, &messages).is_present()
    };
    assert!(found(0.01) && found(0.5));
    assert!(!found(100.0), "they lie anywhere within twenty pixels, and look little like a ball");
}

#[test]
fn paths_of_two_things_are_not_those_of_a_ball() {
    const EXPOSURE_S: f64 = 0.004;
    let mut random = Pcg64::seed_from_u64(12);
    let (rig, plain) = example(2);
    let place = Vector3::new(0.3, 0.5, 0.5);
    let mut found = |velocities: [Vector3<f64>; 2]| {
        let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
        let messages: Vec<_> = (0..2)
            .map(|i| {
                let half = velocities[i] * (0.5 * EXPOSURE_S);
                let path = plain[i].pixel(&(place + half)) - plain[i].pixel(&(place - half));
                let mut seen = Detection { score: 0.75, ..detection(&plain[i], &place, 0.3, &mut random) };
                (seen.blur_u_px, seen.blur_v_px) = (path.x, path.y);
                seen.flags |= DetectionFlags::BLUR_MEASURED;
                // Off the axis it matters which way the width is taken.
                seen.diameter_px = 0.0;
                let mut message = message(i, 1, Scope::Full, &[seen]);
                message.exposure_ns = (EXPOSURE_S * 1e9) as u64;
                message
            })
            .collect();
        process(&mut triangulator, &messages).is_present()
    };
    let (up, on) = (Vector3::new(0.0, 0.0, 15.0), Vector3::new(3.0, 12.0, 1.0));
    assert!(found([on, on]) && found([up, up]));
    assert!(!found([on, up]) && !found([up, on]), "a hand that goes up, and an arm that swings");
}

#[test]
fn a_ball_that_bounces_beside_one_that_rolls_is_not_taken_for_it() {
    let mut random = Pcg64::seed_from_u64(13);
    let (rig, plain) = example(2);
    let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
    let mut found = 0;
    for i in 0..60_u32 {
        let t = f64::from(i).mul_add(0.01, -0.35);
        let rolls = Vector3::new(0.05 + 0.2 * t, -0.45, 0.020);
        let ball = Vector3::new(0.1, -0.5 + 4.0 * t, 0.02 + 3.0 * t.abs());
        // For some frames their images are one, of which the segmenter sees the one that rolls.
        let hidden = (36..=38).contains(&i);
        let messages: Vec<_> = (0..2)
            .map(|c| {
                let mut items = vec![detection(&plain[c], &rolls, 0.2, &mut random)];
                if !hidden {
                    items.push(detection(&plain[c], &ball, 0.2, &mut random));
                }
                message(c, 1 + u64::from(i), Scope::Full, &items)
            })
            .collect();
        let position = process(&mut triangulator, &messages);
        if !position.is_present() {
            continue;
        }
        assert!(!hidden, "frame {i}: {:?} is what rolls", position.position_m);
        assert!(error_m(&position, &ball) < 0.01, "frame {i}");
        found += 1;
    }
    assert_eq!(found, 57, "all but the hidden ones");
}

#[test]
fn what_stays_in_one_place_is_no_ball_that_flies_through_it() {
    const EXPOSURE_S: f64 = 0.004;
    let mut random = Pcg64::seed_from_u64(14);
    let (rig, plain) = example(2);
    let place = Vector3::new(0.3, 0.5, 0.5);
    let mut found = |speed: f64| {
        let mut triangulator = Triangulator::new(&rig, &TriangulateOptions::default());
        let half = Vector3::new(0.3, 0.9, 0.3).normalize() * (0.5 * speed * EXPOSURE_S);
        let shown = (1..=12_u64).map(|trigger| {
            let messages: Vec<_> = (0..2)
                .map(|i| {
                    let path = plain[i].pixel(&(place + half)) - plain[i].pixel(&(place - half));
                    let mut seen = Detection { score: 0.8, ..detection(&plain[i], &place, 0.3, &mut random) };
                    (seen.blur_u_px, seen.blur_v_px) = (path.x, path.y);
                    seen.flags |= DetectionFlags::BLUR_MEASURED;
                    seen.diameter_px = 0.0;
                    let mut message = message(i, trigger, Scope::Full, &[seen]);
                    message.exposure_ns = (EXPOSURE_S * 1e9) as u64;
                    message
                })
                .collect();
            u32::from(process(&mut triangulator, &messages).is_present())
        });
        shown.sum::<u32>()
    };
    assert_eq!(found(0.3), 12, "a ball in a hand");
    assert!(found(18.0) <= 2, "an arm that seems to be smeared stays where it is");
}
