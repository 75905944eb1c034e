use std::{fmt, marker::PhantomData};

use nalgebra::Vector3;

use super::ReferenceFrame;

/// A point, in metres, in the frame `F`.
pub struct Point<F> {
    /// Coordinates in metres.
    pub coords: Vector3<f64>,
    frame: PhantomData<F>,
}

impl<F: ReferenceFrame> Point<F> {
    /// The point with these coordinates, in metres.
    pub const fn new(x: f64, y: f64, z: f64) -> Self {
        Self { coords: Vector3::new(x, y, z), frame: PhantomData }
    }

    /// The distance to `other`, in metres.
    pub fn distance(&self, other: &Self) -> f64 {
        (self.coords - other.coords).norm()
    }
}

impl<F> From<Vector3<f64>> for Point<F> {
    fn from(coords: Vector3<f64>) -> Self {
        Self { coords, frame: PhantomData }
    }
}

// Written out, since a derive would ask the same of the frame, which has no values.
impl<F> Clone for Point<F> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<F> Copy for Point<F> {}
impl<F> PartialEq for Point<F> {
    fn eq(&self, other: &Self) -> bool {
        self.coords == other.coords
    }
}
impl<F> fmt::Debug for Point<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}, {}, {})", self.coords.x, self.coords.y, self.coords.z)
    }
}
