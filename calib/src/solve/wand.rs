//! A wand in motion: its markers lie on a line, in distances that never change. That says which of two cameras
//! is wrong about a marker, where two rays alone cannot.

use nalgebra::{Matrix3x2, SMatrix, SVector, Unit, Vector2, Vector3};
use netcord_common::geometry::{Point, World};

use super::{block::Block, motion::median};

/// Where a wand lies at one instant: its middle, and the direction from its first marker to its last. A marker of
/// it is (0, 0, s), s along the wand from the middle. Unknowns: the middle, and two turns of the direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Wand {
    middle: Vector3<f64>,
    along: Unit<Vector3<f64>>,
}

impl Wand {
    /// Two directions across the wand.
    fn across(&self) -> Matrix3x2<f64> {
        // Whichever axis is furthest from the wand's.
        let axis = Vector3::ith(self.along.iamin(), 1.0);
        let first = self.along.cross(&axis).normalize();
        Matrix3x2::from_columns(&[first, self.along.cross(&first)])
    }
}

impl Block<5> for Wand {
    fn place(&self, object: &Vector3<f64>) -> Vector3<f64> {
        self.middle + self.along.as_ref() * object.z
    }

    fn jacobian(&self, object: &Vector3<f64>) -> SMatrix<f64, 3, 5> {
        let mut j = SMatrix::<f64, 3, 5>::zeros();
        j.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        j.fixed_view_mut::<3, 2>(0, 3).copy_from(&(self.across() * object.z));
        j
    }

    fn stepped(&self, step: &SVector<f64, 5>) -> Self {
        let turn = self.across() * Vector2::new(step[3], step[4]);
        Self {
            middle: self.middle + step.fixed_rows::<3>(0),
            along: Unit::new_normalize(self.along.as_ref() + turn),
        }
    }
}

/// The places of a wand's markers along it, from their middle.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WandShape(Vec<f64>);

/// Distances of a rigid wand's markers scatter by no more than this share of its length, robustly.
const RIGID: f64 = 0.02;
/// Fewest instants at which all markers were seen.
const LEAST_INSTANTS: usize = 20;

impl WandShape {
    /// The shape of a wand with `markers` markers, of which `points` gives the places instant by instant; `None`
    /// where they are no rigid wand, or too few.
    pub(super) fn of(points: &[Option<Point<World>>], markers: usize) -> Option<Self> {
        if markers < 2 {
            return None;
        }
        let whole: Vec<Vec<Vector3<f64>>> = points
            .chunks_exact(markers)
            .filter_map(|c| c.iter().map(|p| p.as_ref().map(|p| p.coords)).collect())
            .collect();
        if whole.len() < LEAST_INSTANTS {
            return None;
        }
        let lengths = |k: usize| whole.iter().map(|w| (w[k] - w[0]).norm()).collect::<Vec<f64>>();
        let places: Vec<f64> = (0..markers).map(|k| median(&lengths(k))).collect();
        let length = places[markers - 1];
        let steady = (1..markers).all(|k| {
            let off: Vec<f64> = lengths(k).iter().map(|l| (l - places[k]).abs()).collect();
            1.4826 * median(&off) < RIGID * length
        });
        // On one line every marker is as far from both ends as the ends are from each other.
        let straight = (1..markers - 1).all(|k| {
            let detour: Vec<f64> = whole
                .iter()
                .map(|w| {
                    (w[k] - w[0]).norm() + (w[markers - 1] - w[k]).norm() - (w[markers - 1] - w[0]).norm()
                })
                .collect();
            median(&detour) < 0.5 * RIGID * length
        });
        let middle = places.iter().sum::<f64>() / markers as f64;
        (steady && straight).then(|| Self(places.iter().map(|p| p - middle).collect()))
    }

    /// Marker `k` in the wand's own frame.
    pub(super) fn marker(&self, k: usize) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, self.0[k])
    }

    /// The wand that lies best among these places of its markers; `None` for fewer than two.
    pub(super) fn lay(&self, seen: &[Option<Point<World>>]) -> Option<Wand> {
        let known: Vec<(f64, Vector3<f64>)> =
            self.0.iter().zip(seen).filter_map(|(s, p)| Some((*s, (*p)?.coords))).collect();
        let count = known.len() as f64;
        if known.len() < 2 {
            return None;
        }
        let (s, p) =
            known.iter().fold((0.0, Vector3::zeros()), |(s, p), k| (s + k.0 / count, p + k.1 / count));
        let along = known.iter().map(|k| (k.1 - p) * (k.0 - s)).sum::<Vector3<f64>>();
        let along = Unit::try_new(along, 1e-12)?;
        Some(Wand { middle: p - along.as_ref() * s, along })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wand() -> Wand {
        Wand {
            middle: Vector3::new(0.3, -0.2, 2.0),
            along: Unit::new_normalize(Vector3::new(0.4, -1.0, 0.3)),
        }
    }

    #[test]
    fn the_jacobian_is_what_small_steps_do() {
        let (wand, marker) = (wand(), Vector3::new(0.0, 0.0, 0.35));
        for k in 0..5 {
            let step = |h: f64| wand.stepped(&SVector::<f64, 5>::ith(k, h)).place(&marker);
            let slope = (step(1e-6) - step(-1e-6)) / 2e-6;
            assert!((slope - wand.jacobian(&marker).column(k)).norm() < 1e-8, "unknown {k}");
        }
    }

    #[test]
    fn a_rigid_wand_is_known_by_its_distances_and_anything_else_is_none() {
        let truth = [0.0, 0.1, 0.3];
        let at = |instant: usize, k: usize| {
            let turn = 0.1 * instant as f64;
            let along = Vector3::new(turn.cos(), turn.sin(), 0.2).normalize();
            Some(Point::from(Vector3::new(turn, 0.0, 2.0) + along * truth[k]))
        };
        let points: Vec<_> = (0..40).flat_map(|i| (0..3).map(move |k| at(i, k))).collect();
        let shape = WandShape::of(&points, 3).expect("rigid");
        for (k, place) in truth.iter().enumerate() {
            assert!((shape.marker(k).z - shape.marker(0).z - place).abs() < 1e-9);
        }
        let laid = shape.lay(&points[..3]).expect("seen");
        assert!((laid.place(&shape.marker(2)) - points[2].expect("there").coords).norm() < 1e-9);
        assert_eq!(WandShape::of(&points, 1), None, "one ball");
        let bent: Vec<_> = (0..120)
            .map(|i| {
                points[i].map(|p| Point::from(p.coords + Vector3::z() * if i % 3 == 1 { 0.05 } else { 0.0 }))
            })
            .collect();
        assert_eq!(WandShape::of(&bent, 3), None, "bent");
        let loose: Vec<_> = (0..120)
            .map(|i| points[i].map(|p| Point::from(p.coords * (1.0 + 0.1 * (i / 3 % 5) as f64))))
            .collect();
        assert_eq!(WandShape::of(&loose, 3), None, "three balls");
    }
}
