use nalgebra::{Matrix3, Vector3};
use netcord_common::{
    geometry::{Point, World},
    wire::{MethodCode, NoPosition},
};

use super::{Method, at_least_two, in_front};
use crate::triangulate::{Observation, PosedCamera};

/// The point of least summed squared distance to all rays; for two rays the middle of their common
/// perpendicular. Minimises metres, not pixels: a far camera weighs more than its accuracy deserves.
#[derive(Debug, Clone, Copy, Default)]
pub struct Midpoint;

/// Rays closer to parallel than this (sine of the angle) leave depth undetermined: 0.06 mrad, less than
/// a twentieth of a pixel.
const PARALLEL: f64 = 6e-5;

impl Method for Midpoint {
    fn code(&self) -> MethodCode {
        MethodCode::Midpoint
    }

    fn locate(
        &self,
        cameras: &[PosedCamera],
        observations: &[Observation],
    ) -> Result<Point<World>, NoPosition> {
        at_least_two(observations)?;
        let point = if let [a, b] = observations {
            middle((&cameras[a.camera].centre, &a.ray), (&cameras[b.camera].centre, &b.ray))
        } else {
            nearest_to_all(cameras, observations)
        };
        in_front(cameras, observations, point.ok_or(NoPosition::ParallelRays)?)
    }
}

/// Middle of the common perpendicular of two rays (centre, unit direction); `None` when parallel.
pub(in crate::triangulate) fn middle(
    (c1, d1): (&Vector3<f64>, &Vector3<f64>),
    (c2, d2): (&Vector3<f64>, &Vector3<f64>),
) -> Option<Vector3<f64>> {
    let cross = d1.cross(d2);
    let sine2 = cross.norm_squared();
    if sine2 < PARALLEL * PARALLEL {
        return None;
    }
    let between = c2 - c1;
    let along_1 = between.cross(d2).dot(&cross) / sine2;
    let along_2 = between.cross(d1).dot(&cross) / sine2;
    Some(0.5 * (c1 + along_1 * d1 + c2 + along_2 * d2))
}

fn nearest_to_all(cameras: &[PosedCamera], observations: &[Observation]) -> Option<Vector3<f64>> {
    // Σ (I − d dᵀ)(X − c) = 0, with the centres taken from the first so that digits are not lost.
    let origin = cameras[observations[0].camera].centre;
    let mut a = Matrix3::zeros();
    let mut b = Vector3::zeros();
    for o in observations {
        let across = Matrix3::identity() - o.ray * o.ray.transpose();
        a += across;
        b += across * (cameras[o.camera].centre - origin);
    }
    // The determinant is that of n rays' spread: about n sin² of the angle between them.
    if a.determinant() < PARALLEL * PARALLEL {
        return None;
    }
    Some(a.cholesky()?.solve(&b) + origin)
}
