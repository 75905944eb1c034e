use std::{fmt, marker::PhantomData, ops::Mul};

use nalgebra::{Matrix3, Rotation3, Vector3};
use thiserror::Error;

use super::{Point, ReferenceFrame};

/// How far R Rᵀ may lie from the identity, entry by entry. Files give about six digits; a matrix
/// further off than this was not a rotation before it was printed.
const ROTATION_TOLERANCE: f64 = 1e-4;

/// A rigid transform `X_to = R X_from + t`, to be named destination first: `camera_from_world`.
pub struct Transform<To, From> {
    /// R.
    pub rotation: Rotation3<f64>,
    /// t in metres: the origin of `From`, seen in `To`.
    pub translation: Vector3<f64>,
    frames: PhantomData<(To, From)>,
}

/// A matrix or vector that is no rigid transform.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum TransformError {
    /// The matrix is not orthonormal.
    #[error(
        "the matrix is no rotation: R Rᵀ differs from the identity by {0:.3e} (at most {ROTATION_TOLERANCE:e} is \
         accepted)"
    )]
    NotOrthonormal(f64),
    /// The matrix turns a right-handed frame into a left-handed one.
    #[error("the matrix is a reflection (its determinant is −1), not a rotation")]
    Reflection,
    /// An entry is infinite or not a number.
    #[error("an entry of the pose is not a finite number")]
    NotFinite,
}

impl<To: ReferenceFrame, From: ReferenceFrame> Transform<To, From> {
    /// The transform with rotation R and translation t in metres. That they link the two frames is
    /// the caller's claim: only the rig loader and calibration make it.
    pub const fn new(rotation: Rotation3<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation, frames: PhantomData }
    }

    /// The transform that changes nothing.
    pub fn identity() -> Self {
        Self::new(Rotation3::identity(), Vector3::zeros())
    }

    /// From a matrix that should be a rotation, and a translation in metres. What printing has cost
    /// in orthonormality is restored (the nearest rotation, by singular values).
    ///
    /// # Errors
    /// [`TransformError`] when the matrix is further from a rotation than rounding explains.
    pub fn from_matrix(matrix: &Matrix3<f64>, translation: Vector3<f64>) -> Result<Self, TransformError> {
        if !matrix.iter().chain(translation.iter()).all(|v| v.is_finite()) {
            return Err(TransformError::NotFinite);
        }
        let off = (matrix * matrix.transpose() - Matrix3::identity()).amax();
        if off > ROTATION_TOLERANCE {
            return Err(TransformError::NotOrthonormal(off));
        }
        if matrix.determinant() < 0.0 {
            return Err(TransformError::Reflection);
        }
        let svd = matrix.svd(true, true);
        let (u, v_t) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
        Ok(Self::new(Rotation3::from_matrix_unchecked(u * v_t), translation))
    }

    /// From a Rodrigues vector (axis times angle, radians) and a translation in metres.
    pub fn from_rodrigues(rotation: Vector3<f64>, translation: Vector3<f64>) -> Self {
        Self::new(Rotation3::new(rotation), translation)
    }

    /// The way back.
    pub fn inverse(&self) -> Transform<From, To> {
        let rotation = self.rotation.inverse();
        Transform::new(rotation, -(rotation * self.translation))
    }

    /// Where the origin of `To` lies in `From`, in metres (a camera's centre in the world).
    pub fn origin(&self) -> Point<From> {
        Point::from(self.inverse().translation)
    }
}

impl<To: ReferenceFrame, From: ReferenceFrame> Mul<Point<From>> for &Transform<To, From> {
    type Output = Point<To>;

    fn mul(self, point: Point<From>) -> Point<To> {
        Point::from(self.rotation * point.coords + self.translation)
    }
}

impl<A: ReferenceFrame, B: ReferenceFrame, C: ReferenceFrame> Mul<&Transform<B, C>> for &Transform<A, B> {
    type Output = Transform<A, C>;

    fn mul(self, a_b: &Transform<B, C>) -> Transform<A, C> {
        Transform::new(self.rotation * a_b.rotation, self.rotation * a_b.translation + self.translation)
    }
}

impl<To, From> Clone for Transform<To, From> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<To, From> Copy for Transform<To, From> {}
impl<To, From> PartialEq for Transform<To, From> {
    fn eq(&self, other: &Self) -> bool {
        self.rotation == other.rotation && self.translation == other.translation
    }
}
impl<To, From> fmt::Debug for Transform<To, From> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "R = {:?}, t = {:?} m", self.rotation.scaled_axis(), self.translation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Board, Camera, World};

    #[test]
    fn neighbours_cancel_in_a_chain() {
        let camera_from_world = Transform::<Camera, World>::from_rodrigues(
            Vector3::new(0.1, -0.4, 1.2),
            Vector3::new(0.3, -0.2, 2.0),
        );
        let world_from_board = Transform::<World, Board>::from_rodrigues(
            Vector3::new(-0.7, 0.2, 0.1),
            Vector3::new(-1.0, 0.5, 0.1),
        );
        let on_board = Point::<Board>::new(0.3, 0.1, 0.0);
        let direct = &(&camera_from_world * &world_from_board) * on_board;
        let by_steps = &camera_from_world * (&world_from_board * on_board);
        assert!(direct.distance(&by_steps) < 1e-15);
        let back = &camera_from_world.inverse() * by_steps;
        assert!(back.distance(&(&world_from_board * on_board)) < 1e-15);
        let centre = &camera_from_world * camera_from_world.origin();
        assert!(centre.coords.norm() < 1e-15);
    }

    #[test]
    fn a_matrix_that_is_no_rotation_is_refused_and_a_rounded_one_repaired() {
        let exact = Rotation3::new(Vector3::new(0.4, 0.2, -0.9));
        let rounded = exact.matrix().map(|v: f64| (v * 1e5).round() * 1e-5);
        let read =
            Transform::<Camera, World>::from_matrix(&rounded, Vector3::zeros()).expect("within rounding");
        assert!(
            (read.rotation.matrix() * read.rotation.matrix().transpose() - Matrix3::identity()).amax()
                < 1e-14
        );
        assert!((read.rotation.matrix() - exact.matrix()).amax() < 2e-5);

        let scaled = exact.matrix() * 1.01;
        let error = Transform::<Camera, World>::from_matrix(&scaled, Vector3::zeros()).expect_err("scaled");
        assert!(matches!(error, TransformError::NotOrthonormal(_)), "{error}");
        let mirrored = exact.matrix() * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        assert_eq!(
            Transform::<Camera, World>::from_matrix(&mirrored, Vector3::zeros()),
            Err(TransformError::Reflection)
        );
    }
}
