use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};
use netcord_common::{
    camera::{CameraModel, INTRINSICS},
    geometry::{Camera, Point},
};

use super::block::{Block, cross};
use super::bundle::{Bundle, Sighting};

/// How uncertain the image of a far point is, for uncertain intrinsics.
///
/// Intrinsics may change together with a small turn of the camera without changing what the camera
/// measures; that part is no error (mrcal, *Projection uncertainty*). So the turn that best undoes a
/// change of the intrinsics over the calibration's own points is taken out first:
/// δq = (J_intrinsics − J_turn (ΣJ_turnᵀJ_turn)⁻¹ ΣJ_turnᵀJ_intrinsics) δθ.
#[derive(Debug, Clone, PartialEq)]
pub struct ProjectionUncertainty {
    model: CameraModel,
    covariance: SMatrix<f64, INTRINSICS, INTRINSICS>,
    turn_by_intrinsics: SMatrix<f64, 3, INTRINSICS>,
}

impl ProjectionUncertainty {
    /// For intrinsics with this covariance, solved from the sightings of `camera` in `bundle`.
    pub fn new<const D: usize, B: Block<D>>(
        bundle: &Bundle<D, B>,
        camera: usize,
        covariance: SMatrix<f64, INTRINSICS, INTRINSICS>,
    ) -> Option<Self> {
        let state = &bundle.cameras[camera];
        let mut turn = Matrix3::<f64>::zeros();
        let mut mixed = SMatrix::<f64, 3, INTRINSICS>::zeros();
        for Sighting { block, object, .. } in bundle.sightings.iter().filter(|s| s.camera == camera) {
            for o in object {
                let in_rig = Point::from(bundle.blocks[*block].place(o));
                let at = &state.camera_from_rig * in_rig;
                let p = state.model.project_with_jacobians(&at)?;
                let by_turn: Matrix2x3<f64> = -(p.by_point * cross(&at.coords));
                turn += by_turn.transpose() * by_turn;
                mixed += by_turn.transpose() * p.by_intrinsics;
            }
        }
        Some(Self { model: state.model, covariance, turn_by_intrinsics: turn.try_inverse()? * mixed })
    }

    /// Covariance, in px², of the image of the far point that is seen at `pixel`; `None` where the
    /// lens model has no inverse.
    pub fn at(&self, pixel: &Vector2<f64>) -> Option<Matrix2<f64>> {
        let n = self.model.undistort(pixel)?;
        let at = Point::<Camera>::from(Vector3::new(n.x, n.y, 1.0));
        let p = self.model.project_with_jacobians(&at)?;
        let by_turn: Matrix2x3<f64> = -(p.by_point * cross(&at.coords));
        let j = p.by_intrinsics - by_turn * self.turn_by_intrinsics;
        Some(j * self.covariance * j.transpose())
    }

    /// Standard deviation in px in the worst direction at `pixel`.
    pub fn worst_sd_px(&self, pixel: &Vector2<f64>) -> Option<f64> {
        self.at(pixel).map(|c| c.symmetric_eigenvalues().max().max(0.0).sqrt())
    }

    /// [`Self::worst_sd_px`] on a grid over the image: rows of `(u, v, sd)`, `None` where the lens has
    /// no inverse.
    pub fn grid(&self, columns: u32, rows: u32) -> Vec<(f64, f64, Option<f64>)> {
        let place = |i: u32, n: u32, size: u32| (f64::from(i) + 0.5) / f64::from(n) * f64::from(size) - 0.5;
        (0..rows)
            .flat_map(|r| (0..columns).map(move |c| (c, r)))
            .map(|(c, r)| {
                let pixel =
                    Vector2::new(place(c, columns, self.model.width), place(r, rows, self.model.height));
                (pixel.x, pixel.y, self.worst_sd_px(&pixel))
            })
            .collect()
    }
}
