use netcord_common::{FrameView, PixelFormat, rig::BallColour};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{LearnError, Learner, Mark, MarkError, separation::curve};
use crate::segment::{
    SegmentOptions, Segmenter,
    scene::{Backdrop, RADIUS_M, Stage, Style},
};

/// A frame with one ball, and where it truly is: centre, diameter and path, px.
fn shot(stage: &mut Stage, rng: &mut Pcg64Mcg, blur: f64) -> (Vec<u8>, [f64; 2], f64, [f64; 2]) {
    let place = [rng.random_range(80.0..560.0), rng.random_range(80.0..320.0)];
    let angle = rng.random_range(0.0..std::f64::consts::TAU);
    let path = [blur * angle.cos(), blur * angle.sin()];
    let flight = stage.flight(place, rng.random_range(16.0..30.0), path);
    let frame = stage.render(&[(flight, stage.style.ball)], &[], 1.0);
    let diameter = 2.0 * RADIUS_M * stage.camera.fx / flight.centre.z;
    (frame, stage.image(&flight), diameter, path)
}

fn view<'a>(stage: &Stage, frame: &'a [u8]) -> FrameView<'a> {
    let size = (stage.camera.width as usize, stage.camera.height as usize);
    FrameView::new(frame, size, size.0, stage.style.format).expect("a whole frame")
}

fn learner(stage: &mut Stage, seed: u64, frames: usize, boxes: bool) -> Learner {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut learner = Learner::new();
    for _ in 0..frames {
        let (frame, centre, diameter, path) = shot(stage, &mut rng, 6.0);
        let mark = if boxes {
            // Loose, and off by some pixels, as people draw them.
            let off: [f64; 2] = std::array::from_fn(|_| rng.random_range(-4.0..4.0));
            let half = 0.8 * diameter + 3.0;
            let edge = |sign: f64| [0, 1].map(|i| centre[i] + off[i] + sign * half);
            Mark::Box { low: edge(-1.0), high: edge(1.0) }
        } else {
            Mark::Outline { centre, diameter, path }
        };
        let labelled = learner.see(&view(stage, &frame), &[mark]).expect("a good mark");
        let (found, cells) = &labelled.balls[0];
        // In a box only the lit side may stand out.
        let most = if boxes { 0.4 } else { 1e-9 };
        assert!((found / diameter - 1.0).abs() <= most, "diameter {found}, truly {diameter}");
        let away = |cell: &usize| {
            let p = labelled.place(*cell);
            (p[0] - centre[0]).hypot(p[1] - centre[1])
        };
        assert!(cells.iter().all(|cell| away(cell) < 0.5 * diameter + 4.0), "cells outside the ball");
    }
    learner
}

#[test]
fn outlines_and_boxes_teach_a_gate_that_keeps_the_ball_and_little_else() {
    for format in PixelFormat::ALL.into_iter().filter(|f| *f != PixelFormat::Mono8) {
        for boxes in [false, true] {
            let mut stage = Stage::new(Style { format, backdrop: Backdrop::Clouds, ..Style::hall() }, 5);
            let lesson = learner(&mut stage, 21, 8, boxes).learn().expect("orange before clouds");
            let separation = &lesson.separation;
            println!("{format}, boxes {boxes}: {:?}, area {:.4}", separation.confusion, separation.area);
            assert!(separation.held_out && lesson.balls == 8 && lesson.frames == 8);
            assert!(separation.confusion.kept() > 0.9, "{format}: {:?}", separation.confusion);
            assert!(separation.confusion.let_through() < 0.02, "{format}: {:?}", separation.confusion);
            assert!(separation.area > 0.98);
            let [least, most] = lesson.colour.diameter_px;
            assert!(least > 11.0 && most < 40.0, "{least} to {most}");
        }
    }
}

#[test]
fn a_ball_of_no_colour_that_was_told_is_found_after_learning() {
    // Green: neither orange nor white.
    let style = Style { ball: [0.15, 0.75, 0.25], backdrop: Backdrop::Clouds, ..Style::hall() };
    let mut stage = Stage::new(style, 8);
    let lesson = learner(&mut stage, 3, 8, false).learn().expect("green before clouds");
    let mut rng = Pcg64Mcg::seed_from_u64(77);
    let mut found = |stage: &mut Stage, colour: Option<BallColour>| {
        let options = SegmentOptions { colour, single_frames: true, ..SegmentOptions::default() };
        let mut segmenter = Segmenter::new(&stage.rig, 0, options).expect("valid");
        let mut hits = 0;
        for _ in 0..12 {
            let (frame, centre, ..) = shot(stage, &mut rng, 4.0);
            let items = stage.search(&mut segmenter, &frame, None);
            let near = |d: &&netcord_common::wire::Detection| {
                d.score >= 0.5 && (d.u_px - centre[0]).hypot(d.v_px - centre[1]) < 2.0
            };
            hits += usize::from(items.items().iter().filter(near).count() == 1);
        }
        hits
    };
    let told = found(&mut stage, None);
    stage.rig.cameras[0].ball = Some(lesson.colour);
    let learnt = found(&mut stage, None);
    let overruled = found(&mut stage, Some(BallColour::Auto));
    println!("told {told}, learnt {learnt}, learnt but overruled {overruled} of 12");
    assert!(told <= 4 && learnt >= 11 && overruled <= 4);
}

#[test]
fn grey_frames_teach_brightness() {
    let style =
        Style { format: PixelFormat::Mono8, ball: [0.95; 3], backdrop: Backdrop::Plain, ..Style::hall() };
    let lesson = learner(&mut Stage::new(style, 2), 4, 6, false).learn().expect("white before grey");
    assert!(lesson.colour.tests().len() <= 2, "brightness has two ends");
    assert!(lesson.separation.confusion.kept() > 0.6, "{:?}", lesson.separation.confusion);
    assert!(lesson.separation.confusion.let_through() < 0.1, "{:?}", lesson.separation.confusion);
}

#[test]
fn what_cannot_be_learnt_from_is_refused_with_its_reason() {
    assert_eq!(Learner::new().learn(), Err(LearnError::NoMark));
    let mut stage = Stage::new(Style::hall(), 1);
    let frame = stage.render(&[], &[], 1.0);
    let view = view(&stage, &frame);
    let mut learner = Learner::new();
    let mut refuse = |mark| learner.see(&view, &[mark]).expect_err("no good mark");
    let outline = |u, v, diameter| Mark::Outline { centre: [u, v], diameter, path: [0.0; 2] };
    assert!(matches!(refuse(outline(700.0, 20.0, 20.0)), MarkError::Outside { .. }));
    assert!(matches!(refuse(outline(-3.0, 20.0, 20.0)), MarkError::Outside { .. }));
    assert!(matches!(refuse(outline(100.0, 20.0, 1.0)), MarkError::Size { .. }));
    assert!(matches!(refuse(outline(100.0, 20.0, f64::NAN)), MarkError::Size { .. }));
    assert!(matches!(refuse(outline(f64::NAN, 20.0, 9.0)), MarkError::Outside { .. }));
    let inverted = Mark::Box { low: [100.0, 100.0], high: [50.0, 120.0] };
    assert!(matches!(refuse(inverted), MarkError::Size { .. }));
    // A frame without a ball, which is allowed: all of it is something else.
    learner.see(&view, &[]).expect("no mark, no harm");
    assert_eq!(learner.learn(), Err(LearnError::NoMark));
    learner.see(&view, &[outline(300.0, 200.0, 8.0)]).expect("a small one");
    assert!(matches!(learner.learn(), Err(LearnError::TooFewCells { .. })));

    // Marks where there is no ball, before a backdrop that is the same everywhere.
    let mut plain = Stage::new(Style { backdrop: Backdrop::Plain, ..Style::hall() }, 1);
    let mut learner = Learner::new();
    for i in 0..4 {
        let frame = plain.render(&[], &[], 1.0);
        let view = super::tests::view(&plain, &frame);
        let mark = outline(150.0 + 90.0 * f64::from(i), 200.0, 30.0);
        learner.see(&view, &[mark]).expect("a good mark");
        let around = Mark::Box { low: [400.0, 40.0], high: [440.0, 80.0] };
        assert!(matches!(learner.see(&view, &[around]), Err(MarkError::NothingInBox { .. })));
    }
    let refused = learner.learn().expect_err("nothing differs");
    assert!(matches!(refused, LearnError::NotSeparable { .. }), "{refused}");
}

/// By counting all pairs.
#[test]
fn the_area_under_the_curve_is_the_chance_that_a_ball_is_deeper_than_another() {
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let ball = (0..70).map(|_| f64::from(rng.random_range(-2..9_i32))).collect::<Vec<_>>();
    let other = (0..90).map(|_| f64::from(rng.random_range(-8..3_i32))).collect::<Vec<_>>();
    let mut pairs = 0.0;
    for b in &ball {
        for o in &other {
            pairs += if b > o {
                1.0
            } else if b == o {
                0.5
            } else {
                0.0
            };
        }
    }
    let (roc, area) = curve(&ball, &other);
    assert!((area - pairs / (70.0 * 90.0)).abs() < 1e-12);
    assert!(roc.windows(2).all(|p| p[0].kept <= p[1].kept && p[0].let_through <= p[1].let_through));
    assert_eq!(roc.last().map(|p| p.kept), Some(1.0));
}
