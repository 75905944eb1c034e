//! What methods say of poses and pixels that give no point.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::*;
use crate::triangulate::testing::{Plain, observe_all, ring};

fn two_side_by_side(apart_m: f64) -> (Vec<Plain>, Vec<PosedCamera>) {
    let mut plain = vec![Plain::looking([0.0, -2.0, 1.0], [0.0, 2.0, 1.0]); 2];
    plain[1].t -= Vector3::new(apart_m, 0.0, 0.0);
    let posed = plain.iter().map(Plain::posed).collect();
    (plain, posed)
}

fn seen_at(cameras: &[PosedCamera], pixels: &[(f64, f64)]) -> Vec<Observation> {
    let at = |(i, (u, v)): (usize, &(f64, f64))| {
        cameras[i].observe(i, Vector2::new(*u, *v), Matrix2::identity()).expect("a pixel")
    };
    pixels.iter().enumerate().map(at).collect()
}

#[test]
fn one_view_and_none_have_no_depth() {
    let (plain, posed) = ring(2);
    let seen = observe_all(&plain, &posed, &Vector3::new(0.0, 0.0, 0.2), 1.0);
    for method in all_methods() {
        assert_eq!(method.locate(&posed, &seen[..1]), Err(NoPosition::OneView), "{}", method.code());
        assert_eq!(method.locate(&posed, &[]), Err(NoPosition::NoDetection), "{}", method.code());
    }
}

#[test]
fn parallel_rays_meet_nowhere() {
    let (_, posed) = two_side_by_side(0.5);
    let seen = seen_at(&posed, &[(900.0, 600.0), (900.0, 600.0)]);
    for method in all_methods() {
        assert_eq!(method.locate(&posed, &seen), Err(NoPosition::ParallelRays), "{}", method.code());
    }
}

#[test]
fn rays_that_diverge_would_meet_behind_the_cameras() {
    let (_, posed) = two_side_by_side(0.5);
    // The right camera sees further right what the left sees further left.
    let seen = seen_at(&posed, &[(700.0, 602.0), (1200.0, 602.0)]);
    for method in all_methods() {
        assert_eq!(method.locate(&posed, &seen), Err(NoPosition::BehindCamera), "{}", method.code());
    }
}

#[test]
fn rays_that_pass_far_from_each_other_do_not_agree() {
    let (_, posed) = ring(2);
    let seen = seen_at(&posed, &[(900.0, 300.0), (900.0, 900.0)]);
    let robust = Robust::with_slack_px(0.75);
    assert_eq!(robust.locate(&posed, &seen), Err(NoPosition::ResidualTooLarge));
}

#[test]
fn a_narrow_baseline_still_gives_the_point() {
    let (plain, posed) = two_side_by_side(0.02);
    let truth = Vector3::new(0.1, 1.0, 1.1);
    let seen = observe_all(&plain, &posed, &truth, 1.0);
    for method in all_methods() {
        let found = method.locate(&posed, &seen).expect("2 cm are enough without noise");
        assert!((found.coords - truth).norm() < 1e-9, "{}", method.code());
    }
}
