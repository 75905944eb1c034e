//! Whether a camera that contradicts the others merely has another clock.

use nalgebra::{Vector2, Vector3};
use netcord_common::geometry::{Camera, Point, Transform, World};

use super::{
    motion::{LEAST_COMMON, median, undistorted},
    moving_points::MovingPoints,
    resection::{polish, resect},
};

/// A clock's error that makes a camera agree with the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Delay {
    /// How much later its frames were exposed than the others' of the same stamp, s; negative: earlier.
    pub later_s: f64,
    /// The median residual that is left when that is made good, px.
    pub median_px: f64,
}

/// Longest delay looked for, s: over longer times points do not move straight on.
const LONGEST_S: f64 = 0.05;
/// Steps of the first search, and how often they are halved then: to 20 µs.
const STEP_S: f64 = 0.005;
const HALVINGS: usize = 8;

/// The delay of `camera` against the known `points`: each pixel is moved along its velocity, the pose resected,
/// and the least median residual looked for. `None` where velocities are not known, or fewer points than a pose
/// needs.
pub(super) fn delay_of(camera: &MovingPoints, points: &[Option<Point<World>>]) -> Option<Delay> {
    let seen: Vec<(Vector3<f64>, Vector2<f64>, Vector2<f64>)> = points
        .iter()
        .zip(&camera.pixels)
        .zip(&camera.velocities)
        .filter_map(|((p, pixel), v)| Some(((*p)?.coords, (*pixel)?, (*v)?)))
        .collect();
    if seen.len() < LEAST_COMMON {
        return None;
    }
    let start = resect(camera, &undistorted(camera), points)?;
    let residual = |later_s: f64,
                    from: &Transform<Camera, World>|
     -> Option<(f64, Transform<Camera, World>)> {
        let moved: Vec<_> = seen.iter().map(|(p, pixel, v)| (*p, pixel - v * later_s)).collect();
        let pose = polish(camera, &moved, *from)?;
        let off: Vec<f64> = moved
            .iter()
            .filter_map(|(p, pixel)| Some((camera.model.project(&(&pose * Point::from(*p)))? - pixel).norm()))
            .collect();
        Some((median(&off), pose))
    };
    let steps = (LONGEST_S / STEP_S).round() as i32;
    let mut best: Option<(f64, f64, Transform<Camera, World>)> = None;
    let try_at = |later_s: f64, best: &mut Option<(f64, f64, Transform<Camera, World>)>| {
        let from = best.map_or(start, |b| b.2);
        if let Some((off, pose)) = residual(later_s, &from)
            && best.is_none_or(|b| off < b.1)
        {
            *best = Some((later_s, off, pose));
        }
    };
    (-steps..=steps).for_each(|k| try_at(f64::from(k) * STEP_S, &mut best));
    let mut step = STEP_S;
    for _ in 0..HALVINGS {
        step /= 2.0;
        let middle = best?.0;
        try_at(middle - step, &mut best);
        try_at(middle + step, &mut best);
    }
    let (later_s, median_px, _) = best?;
    Some(Delay { later_s, median_px })
}
