use nalgebra::{Rotation3, SMatrix, SVector, Vector3};
use netcord_common::geometry::{Board, Point, Transform, World};

/// What is seen at one instant and has unknowns of its own: a board with its pose, or free points.
/// `D` unknowns; they couple to no other instant, which the solver uses.
pub trait Block<const D: usize>: Clone + Send + Sync {
    /// Where a point of the object lies in the rig's frame.
    fn place(&self, object: &Vector3<f64>) -> Vector3<f64>;
    /// ∂place/∂unknowns, at zero step.
    fn jacobian(&self, object: &Vector3<f64>) -> SMatrix<f64, 3, D>;
    /// The block after a step of its unknowns.
    #[must_use]
    fn stepped(&self, step: &SVector<f64, D>) -> Self;
}

/// [v]ₓ, the matrix of the cross product.
pub(crate) fn cross(v: &Vector3<f64>) -> SMatrix<f64, 3, 3> {
    v.cross_matrix()
}

/// A board: rotated by exp(δω) from the left, moved by δt; unknowns (δω, δt).
impl Block<6> for Transform<World, Board> {
    fn place(&self, object: &Vector3<f64>) -> Vector3<f64> {
        (self * Point::from(*object)).coords
    }

    fn jacobian(&self, object: &Vector3<f64>) -> SMatrix<f64, 3, 6> {
        let mut j = SMatrix::<f64, 3, 6>::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).copy_from(&-cross(&(self.rotation * object)));
        j.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        j
    }

    fn stepped(&self, step: &SVector<f64, 6>) -> Self {
        let turn = Rotation3::new(step.fixed_rows::<3>(0).into_owned());
        let mut rotation = turn * self.rotation;
        rotation.renormalize();
        Self::new(rotation, self.translation + step.fixed_rows::<3>(3))
    }
}

/// One free point; what it is seen as has no shape, so `object` is ignored.
impl Block<3> for Point<World> {
    fn place(&self, _object: &Vector3<f64>) -> Vector3<f64> {
        self.coords
    }

    fn jacobian(&self, _object: &Vector3<f64>) -> SMatrix<f64, 3, 3> {
        SMatrix::identity()
    }

    fn stepped(&self, step: &SVector<f64, 3>) -> Self {
        Self::from(self.coords + step)
    }
}
