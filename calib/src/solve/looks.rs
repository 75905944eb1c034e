//! How a board moves in a camera's pictures, and where it was at another instant.

use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

use super::views::{CameraViews, PixelMotion, View};

/// Looks further apart than this, s, say nothing of the motion between: a hand that carries a board turns back within
/// a second.
const FURTHEST_S: f64 = 0.4;
/// Fewest corners that must be seen in three looks.
const LEAST_CORNERS: usize = 4;

/// Gives `views` the motion of their corners, from the camera's looks before and after each: the parabola through
/// three places of a corner, and for corners that one of the looks lacks what the others' motion says (affine over
/// the board). Views without a stamp, without looks on both sides or with a motion of their own stay as they are.
pub fn looks_around(views: &mut [View], looks: &[View]) {
    let mut stamped: Vec<(u64, &View)> = looks.iter().filter_map(|v| Some((v.stamp_ns?, v))).collect();
    stamped.sort_by_key(|(t, _)| *t);
    for view in views.iter_mut().filter(|v| v.motion.is_empty()) {
        let Some(now) = view.stamp_ns else { continue };
        let first = stamped.partition_point(|(t, _)| *t < now);
        let next = stamped.partition_point(|(t, _)| *t <= now);
        let around =
            first.checked_sub(1).zip(Some(next)).and_then(|(b, a)| Some((stamped[b], *stamped.get(a)?)));
        let Some(((t_before, before), (t_after, after))) = around else { continue };
        let (to_before, to_after) = ((now - t_before) as f64 * 1e-9, (t_after - now) as f64 * 1e-9);
        if to_before <= FURTHEST_S && to_after <= FURTHEST_S {
            // Too few corners in common: of this view no motion is known, as of one without looks beside it.
            view.motion = motion(view, (before, to_before), (after, to_after)).unwrap_or_default();
        }
    }
}

fn place_of(view: &View, object: &Vector3<f64>) -> Option<Vector2<f64>> {
    view.object.iter().position(|o| (o - object).norm() < 1e-9).map(|k| view.image[k])
}

fn motion(view: &View, before: (&View, f64), after: (&View, f64)) -> Option<Vec<PixelMotion>> {
    let own = |(object, pixel): (&Vector3<f64>, &Vector2<f64>)| {
        let from = (pixel - place_of(before.0, object)?) / before.1;
        let to = (place_of(after.0, object)? - pixel) / after.1;
        let acceleration = (to - from) * (2.0 / (before.1 + after.1));
        Some(PixelMotion { velocity: from + acceleration * (0.5 * before.1), acceleration })
    };
    let seen: Vec<Option<PixelMotion>> = view.object.iter().zip(&view.image).map(own).collect();
    if seen.iter().flatten().count() < LEAST_CORNERS {
        return None;
    }
    if seen.iter().all(Option::is_some) {
        return Some(seen.into_iter().flatten().collect());
    }
    let (mut normal, mut rhs) = (Matrix3::<f64>::zeros(), SMatrix::<f64, 3, 4>::zeros());
    let row = |o: &Vector3<f64>| Vector3::new(o.x, o.y, 1.0);
    for (object, motion) in view.object.iter().zip(&seen) {
        let Some(m) = motion else { continue };
        let terms = SMatrix::<f64, 1, 4>::new(m.velocity.x, m.velocity.y, m.acceleration.x, m.acceleration.y);
        normal += row(object) * row(object).transpose();
        rhs += row(object) * terms;
    }
    // None for corners in a line.
    let field = normal.cholesky()?.solve(&rhs);
    let elsewhere = |(object, motion): (&Vector3<f64>, &Option<PixelMotion>)| {
        motion.unwrap_or_else(|| {
            let m = field.transpose() * row(object);
            PixelMotion { velocity: Vector2::new(m[0], m[1]), acceleration: Vector2::new(m[2], m[3]) }
        })
    };
    Some(view.object.iter().zip(&seen).map(elsewhere).collect())
}

/// The instant of a shot, ns: the mean of its views' stamps; `None` where one has none.
pub(super) fn instant_ns<'a>(views: impl Iterator<Item = &'a View>) -> Option<u64> {
    let stamps: Vec<u64> = views.map(|v| v.stamp_ns).collect::<Option<_>>()?;
    let first = *stamps.iter().min()?;
    Some(first + stamps.iter().map(|s| s - first).sum::<u64>() / stamps.len() as u64)
}

/// How much later than `instant_ns` a view was exposed by its stamp, s; 0 where that is not known.
pub(super) fn after_s(view: &View, instant_ns: Option<u64>) -> f64 {
    let known = view.stamp_ns.zip(instant_ns);
    known.map_or(0.0, |(stamp, instant)| (i128::from(stamp) - i128::from(instant)) as f64 * 1e-9)
}

/// The views as they would be had all views of one name been exposed at once: each corner moved to the mean of the
/// name's stamps, for cameras whose frames are exposed `later_s` after their stamps. Where a clock is off, views
/// whose motion is not known are left out.
///
/// # Panics
/// When `cameras` and `later_s` differ in length.
pub fn on_time(cameras: &[CameraViews], later_s: &[f64]) -> Vec<CameraViews> {
    assert_eq!(cameras.len(), later_s.len(), "a clock's error for each camera");
    let moved = |view: &View, later_s: f64| -> Option<View> {
        if view.motion.is_empty() {
            return (later_s == 0.0).then(|| view.clone());
        }
        let of_name = cameras.iter().flat_map(|c| c.views.iter().filter(|v| v.name == view.name));
        let ago_s = after_s(view, instant_ns(of_name)) + later_s;
        let image = view.image.iter().zip(&view.motion).map(|(p, m)| m.before(p, ago_s)).collect();
        Some(View { image, ..view.clone() })
    };
    let camera = |(c, later_s): (&CameraViews, &f64)| CameraViews {
        views: c.views.iter().filter_map(|v| moved(v, *later_s)).collect(),
        ..c.clone()
    };
    cameras.iter().zip(later_s).map(camera).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_followed_also_by_a_corner_that_one_look_lacks() {
        let object: Vec<Vector3<f64>> =
            (0..9).map(|k| Vector3::new(f64::from(k % 3) * 0.05, f64::from(k / 3) * 0.05, 0.0)).collect();
        // Velocity and acceleration affine over the board.
        let at = |o: &Vector3<f64>, t: f64| {
            let (v, a) =
                (Vector2::new(40.0 + 200.0 * o.x, -10.0 + 90.0 * o.y), Vector2::new(60.0, 400.0 * o.x));
            o.xy() * 900.0 + v * t + a * (0.5 * t * t)
        };
        let look = |ms: u64, lacks: usize| {
            let seen: Vec<_> =
                object.iter().enumerate().filter(|(k, _)| *k != lacks).map(|(_, o)| *o).collect();
            let image = seen.iter().map(|o| at(o, (ms as f64 - 500.0) * 1e-3)).collect();
            View { stamp_ns: Some(ms * 1_000_000), ..View::new(format!("{ms}"), seen, image) }
        };
        let looks = [look(400, 99), look(500, 99), look(620, 4), look(1500, 99)];
        let mut views = looks.to_vec();
        looks_around(&mut views, &looks);
        assert!(views[0].motion.is_empty() && views[2].motion.is_empty(), "no look on one side");
        for (k, o) in object.iter().enumerate() {
            let then = views[1].motion[k].before(&views[1].image[k], 0.07);
            assert!((then - at(o, -0.07)).norm() < 1e-9, "corner {k}: {then}");
        }
    }
}
