use nalgebra::{Matrix3, Vector3};

use super::Paint;

/// An ellipsoid in the world: the one shape that balls, limbs, heads and paddles are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Centre, m, world frame.
    pub centre: Vector3<f64>,
    /// The unit sphere's axes as they lie in the world, m: columns.
    pub axes: Matrix3<f64>,
    /// Its surface.
    pub paint: Paint,
}

impl Body {
    /// A ball.
    pub fn sphere(centre: Vector3<f64>, radius_m: f64, paint: Paint) -> Self {
        Self { centre, axes: Matrix3::identity() * radius_m, paint }
    }

    /// An ellipsoid with half-axes `half_m` along x, y and z.
    pub fn upright(centre: Vector3<f64>, half_m: [f64; 3], paint: Paint) -> Self {
        Self { centre, axes: Matrix3::from_diagonal(&Vector3::from(half_m)), paint }
    }

    /// A limb from `a` to `b`, `thick_m` in radius.
    pub fn limb(a: Vector3<f64>, b: Vector3<f64>, thick_m: f64, paint: Paint) -> Self {
        let along = b - a;
        let axis = along.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        let side = axis.cross(&Vector3::new(0.37, 0.61, 0.7)).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let half = 0.5 * along.norm() + 0.6 * thick_m;
        let axes = Matrix3::from_columns(&[side * thick_m, axis.cross(&side) * thick_m, axis * half]);
        Self { centre: (a + b) * 0.5, axes, paint }
    }

    /// A disc with this normal.
    pub fn disc(centre: Vector3<f64>, normal: Vector3<f64>, radius_m: f64, paint: Paint) -> Self {
        let normal = normal.try_normalize(1e-9).unwrap_or_else(Vector3::y);
        let side = normal.cross(&Vector3::new(0.37, 0.61, 0.7)).normalize();
        let axes = Matrix3::from_columns(&[side * radius_m, normal.cross(&side) * radius_m, normal * 0.008]);
        Self { centre, axes, paint }
    }
}
