//! What is given when, as messages arrive in any order and at any time.

use nalgebra::Vector3;
use netcord_common::wire::{BallPosition, Detections, Frameset, NoPosition, PositionOutcome, Scope, Verdict};
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::{
    Matcher, TriangulateOptions,
    testing::{Plain, detection, example, message, stroke},
};

const MS: u64 = 1_000_000;

struct Scene {
    plain: Vec<Plain>,
    matcher: Matcher,
    random: Pcg64,
}

impl Scene {
    fn new(cameras: usize) -> Self {
        let (rig, plain) = example(cameras);
        let matcher = Matcher::new(&rig, &TriangulateOptions::default());
        Self { plain, matcher, random: Pcg64::seed_from_u64(1) }
    }

    fn seen(&mut self, camera: usize, trigger: u64, scope: Scope) -> Detections {
        let d = detection(&self.plain[camera], &stroke(trigger as f64 * 0.01), 0.2, &mut self.random);
        message(camera, trigger, scope, &[d])
    }

    fn offer(&mut self, camera: usize, trigger: u64, scope: Scope, now_ns: u64) -> Option<BallPosition> {
        let m = self.seen(camera, trigger, scope);
        self.matcher.offer(&m, now_ns);
        self.matcher.next(now_ns)
    }
}

fn at(position: Option<BallPosition>) -> (u64, PositionOutcome) {
    let position = position.expect("ready");
    (position.trigger_id, position.outcome())
}

#[test]
fn windows_that_agree_are_given_at_once_and_the_full_search_gives_no_second_position() {
    let mut s = Scene::new(2);
    assert_eq!(s.offer(0, 5, Scope::Window, 0), None);
    let position = s.offer(1, 5, Scope::Window, 10).expect("both windows agree");
    assert_eq!(position.scope, Scope::Window.code());
    assert_eq!(position.stamps.triangulate_start_ns, 10);
    assert_eq!(s.offer(0, 5, Scope::Full, 20), None);
    assert_eq!(s.offer(1, 5, Scope::Full, 30), None);
    assert_eq!(s.matcher.deadline_ns(), None);
    assert_eq!(s.matcher.counts().from_windows, 1);
    assert_eq!(s.matcher.counts().late, 0);
}

#[test]
fn windows_that_disagree_wait_for_the_whole_frames() {
    let mut s = Scene::new(2);
    assert_eq!(s.offer(0, 5, Scope::Window, 0), None);
    let mut wrong = s.seen(1, 5, Scope::Window);
    wrong.items[0].u_px += 60.0;
    wrong.items[0].v_px += 60.0;
    s.matcher.offer(&wrong, 0);
    assert_eq!(s.matcher.next(0), None);
    assert_eq!(s.offer(0, 5, Scope::Full, 1), None);
    let position = s.offer(1, 5, Scope::Full, 2).expect("both whole frames");
    assert!(position.is_present());
    assert_eq!(position.scope, Scope::Full.code());
}

#[test]
fn a_late_camera_is_waited_for_less_long_where_others_suffice() {
    let mut s = Scene::new(2);
    assert_eq!(s.offer(0, 1, Scope::Full, 0), None);
    assert_eq!(s.matcher.deadline_ns(), Some(10 * MS));
    assert_eq!(s.matcher.next(10 * MS - 1), None);
    assert_eq!(at(s.matcher.next(10 * MS)), (1, PositionOutcome::None(NoPosition::OneView)));
    assert_eq!(s.offer(1, 1, Scope::Full, 11 * MS), None, "too late: at most one answer for a trigger");
    assert_eq!((s.matcher.counts().late, s.matcher.counts().incomplete), (1, 1));

    let mut s = Scene::new(4);
    for camera in 0..3 {
        assert_eq!(s.offer(camera, 1, Scope::Full, 0), None);
    }
    let position = s.matcher.next(5 * MS).expect("due");
    assert!(position.is_present(), "three of four suffice");
    assert_eq!(position.views, 0b0111);
}

#[test]
fn nothing_is_waited_for_that_cannot_come_any_more() {
    // Capture says that the frame was lost.
    let mut s = Scene::new(4);
    let verdict = Frameset {
        trigger_id: 1,
        expected: 0b1111,
        delivered: 0b1011,
        verdict: Verdict::Incomplete.code(),
        ..Frameset::default()
    };
    s.matcher.offer_frameset(&verdict, 0);
    assert_eq!(s.matcher.next(100 * MS), None, "the segmenters may be slow");
    assert_eq!(s.offer(0, 1, Scope::Full, 1), None);
    assert_eq!(s.offer(1, 1, Scope::Full, 1), None);
    assert!(s.offer(3, 1, Scope::Full, 1).expect("complete as far as can be").is_present());
    // The camera's segmenter is at the next trigger already.
    let mut s = Scene::new(2);
    assert_eq!(s.offer(0, 1, Scope::Full, 0), None);
    let first = s.offer(1, 2, Scope::Full, 1).expect("camera 1 has passed trigger 1");
    assert_eq!((first.trigger_id, first.outcome()), (1, PositionOutcome::None(NoPosition::OneView)));
    assert_eq!(at(s.offer(0, 2, Scope::Full, 2)), (2, PositionOutcome::Position));
}

#[test]
fn triggers_are_matched_by_their_id_in_any_order_of_arrival_and_given_in_order() {
    let mut s = Scene::new(2);
    // Camera 1 is one trigger behind all the time.
    assert_eq!(s.offer(0, 1, Scope::Full, 0), None);
    for trigger in 2..30 {
        assert_eq!(s.offer(0, trigger, Scope::Full, trigger), None);
        let position = s.offer(1, trigger - 1, Scope::Full, trigger).expect("complete");
        assert_eq!(position.trigger_id, trigger - 1);
        let truth = stroke((trigger - 1) as f64 * 0.01);
        assert!((Vector3::from(position.position_m) - truth).norm() < 0.01);
    }
    // Duplicates of what has been decided change nothing.
    assert_eq!(s.offer(1, 3, Scope::Full, 50), None);
    // Ids jump when capture is restarted.
    assert_eq!(at(s.offer(1, 5_000_000, Scope::Full, 60)), (29, PositionOutcome::None(NoPosition::OneView)));
    assert_eq!(at(s.offer(0, 5_000_000, Scope::Full, 61)).0, 5_000_000);
}

#[test]
fn an_unsynchronised_pair_has_no_position() {
    let mut s = Scene::new(2);
    let verdict = Frameset {
        trigger_id: 1,
        expected: 0b11,
        delivered: 0b11,
        verdict: Verdict::Unsynchronised.code(),
        ..Frameset::default()
    };
    s.matcher.offer_frameset(&verdict, 0);
    assert_eq!(s.offer(0, 1, Scope::Window, 0), None);
    assert_eq!(s.offer(1, 1, Scope::Window, 0), None, "windows that agree do not help");
    assert_eq!(s.offer(0, 1, Scope::Full, 0), None);
    let outcome = at(s.offer(1, 1, Scope::Full, 0));
    assert_eq!(outcome, (1, PositionOutcome::None(NoPosition::NotSynchronised)));
    assert_eq!(s.matcher.counts().unsynchronised, 1);
}

#[test]
fn framesets_without_segmenters_fill_nothing_up() {
    let mut s = Scene::new(2);
    for trigger in 1..30 {
        let verdict =
            Frameset { trigger_id: trigger, expected: 0b11, delivered: 0b11, ..Frameset::default() };
        s.matcher.offer_frameset(&verdict, trigger);
        assert_eq!(s.matcher.next(trigger), None);
    }
    assert_eq!(s.offer(0, 30, Scope::Full, 200), None);
    assert_eq!(at(s.offer(1, 30, Scope::Full, 200)), (30, PositionOutcome::Position));
}
