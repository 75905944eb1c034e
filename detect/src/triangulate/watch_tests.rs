//! A camera that is knocked while the ball flies.

use nalgebra::{Rotation3, Vector3};
use netcord_common::wire::Scope;
use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::{
    TriangulateOptions, Triangulator,
    testing::{Plain, detection, example, message, stroke},
};

struct Session {
    triangulator: Triangulator,
    random: Pcg64,
    trigger: u64,
}

impl Session {
    /// Plays on; returns the worst error of the last half, m.
    fn play(&mut self, plain: &[Plain], triggers: u64) -> f64 {
        let mut worst = 0.0_f64;
        for i in 0..triggers {
            self.trigger += 1;
            let ball = stroke((self.trigger % 45) as f64 * 0.01);
            let messages: Vec<_> = (0..plain.len())
                .map(|c| {
                    let d = detection(&plain[c], &ball, 0.2, &mut self.random);
                    message(c, self.trigger, Scope::Full, &[d])
                })
                .collect();
            let position = self.triangulator.process(&messages.iter().collect::<Vec<_>>());
            if 2 * i >= triggers && position.is_present() {
                worst = worst.max((Vector3::from(position.position_m) - ball).norm());
            }
        }
        worst
    }
}

fn knocked(plain: &[Plain], camera: usize, degrees: f64) -> Vec<Plain> {
    let mut plain = plain.to_vec();
    let turn = Rotation3::new(Vector3::new(0.6, 0.6, 0.5) * degrees.to_radians());
    plain[camera].r = turn.matrix() * plain[camera].r;
    plain[camera].t = turn.matrix() * plain[camera].t;
    plain
}

#[test]
fn a_knocked_camera_is_named_left_out_and_trusted_again_when_it_fits() {
    for n in [4, 8] {
        for degrees in [0.5, 3.0] {
            let (rig, plain) = example(n);
            let mut session = Session {
                triangulator: Triangulator::new(&rig, &TriangulateOptions::default()),
                random: Pcg64::seed_from_u64(1),
                trigger: 0,
            };
            let before = session.play(&plain, 300);
            assert_eq!(session.triangulator.watch().distrusted(), 0);
            let after = session.play(&knocked(&plain, 2, degrees), 600);
            assert_eq!(session.triangulator.watch().distrusted(), 1 << 2, "{n} cameras, {degrees}°");
            assert!(after < 2.0 * before + 0.002, "{n} cameras, {degrees}°: {before} m, then {after} m");
            session.play(&plain, 600);
            assert_eq!(session.triangulator.watch().distrusted(), 0, "straightened");
        }
    }
}

#[test]
fn of_two_cameras_that_no_longer_fit_neither_is_named() {
    let (rig, plain) = example(2);
    let mut session = Session {
        triangulator: Triangulator::new(&rig, &TriangulateOptions::default()),
        random: Pcg64::seed_from_u64(2),
        trigger: 0,
    };
    session.play(&plain, 300);
    assert_eq!(session.triangulator.watch().unfit_pairs().count(), 0);
    // So hard that no two rays come near each other, and softly.
    for degrees in [3.0, 0.6] {
        session.play(&knocked(&plain, 1, degrees), 600);
        assert_eq!(session.triangulator.watch().distrusted(), 0);
        assert_eq!(session.triangulator.watch().unfit_pairs().collect::<Vec<_>>(), [(0, 1)], "{degrees}°");
        session.play(&plain, 600);
        assert_eq!(session.triangulator.watch().unfit_pairs().count(), 0);
    }
}
