//! Where in each image the ball will be.

use nalgebra::{Matrix2, Matrix2x3, Vector2};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point, Transform, World},
    rig::Rig,
    wire::SearchWindow,
};

use super::bank::{Bank, Hypothesis};

/// Half size of a window, in standard deviations of the ball's place.
const SIGMAS: f64 = 5.0;
/// Beside the uncertainty, the ball and its blur: for soft edges and the segmenter's own
/// neighbourhood, px.
const MARGIN_PX: f64 = 6.0;
/// Growth of the margin with each trigger that had no position.
const GROWTH_PER_MISS: f64 = 1.0;
/// A window of more than this share of the image saves nothing: the whole image is searched.
const LARGEST_SHARE: f64 = 0.25;
/// Hypotheses of less weight are not looked for.
const NEGLIGIBLE: f64 = 1e-4;

#[derive(Debug, Clone)]
struct View {
    model: CameraModel,
    camera_from_world: Transform<Camera, World>,
    exposure_s: f64,
}

/// Projects hypotheses into the cameras of a rig.
#[derive(Debug, Clone)]
pub struct WindowMaker {
    views: Vec<View>,
    diameter_m: f64,
}

/// The image of one hypothesis.
struct Image {
    centre: Vector2<f64>,
    covariance: Matrix2<f64>,
    velocity: Vector2<f64>,
    diameter: f64,
    /// Half extent of the window along u and v.
    half: Vector2<f64>,
}

impl WindowMaker {
    /// For the cameras of `rig`.
    pub fn new(rig: &Rig) -> Self {
        let views = rig
            .cameras
            .iter()
            .map(|c| View {
                model: c.model,
                camera_from_world: c.camera_from_world,
                exposure_s: c.exposure_ns as f64 * 1e-9,
            })
            .collect();
        Self { views, diameter_m: rig.ball.diameter_m }
    }

    /// The windows that hold the ball according to every hypothesis of `bank`, which is as of
    /// `mid_exposure_ns`. A window is absent where the ball is not expected in the image, or could be
    /// nearly anywhere in it.
    pub fn windows(
        &self,
        bank: Bank,
        misses: u32,
        made_from_trigger: u64,
        mid_exposure_ns: u64,
    ) -> impl Iterator<Item = SearchWindow> + '_ {
        (0_u32..).zip(&self.views).map(move |(camera, view)| {
            let none = SearchWindow { made_from_trigger, mid_exposure_ns, camera, ..SearchWindow::default() };
            self.window(view, &bank, misses, none).unwrap_or(none)
        })
    }

    fn window(
        &self,
        view: &View,
        bank: &Bank,
        misses: u32,
        mut window: SearchWindow,
    ) -> Option<SearchWindow> {
        let best = self.image(view, bank.best()?, misses)?;
        let (mut low, mut high) = (best.centre - best.half, best.centre + best.half);
        for hypothesis in bank.all().iter().filter(|h| h.weight > NEGLIGIBLE) {
            let image = self.image(view, hypothesis, misses)?;
            low = low.inf(&(image.centre - image.half));
            high = high.sup(&(image.centre + image.half));
        }
        let size = Vector2::new(f64::from(view.model.width), f64::from(view.model.height));
        let edge = Vector2::repeat(-0.5);
        let (low, high) = (low.sup(&edge), high.inf(&(size + edge)));
        let extent = high - low;
        if extent.min() <= 0.0 || extent.x * extent.y > LARGEST_SHARE * size.x * size.y {
            return None;
        }
        window.present = 1;
        (window.x0_px, window.y0_px, window.x1_px, window.y1_px) = (low.x, low.y, high.x, high.y);
        (window.u_px, window.v_px) = (best.centre.x, best.centre.y);
        window.covariance_px2 = [best.covariance[(0, 0)], best.covariance[(0, 1)], best.covariance[(1, 1)]];
        window.diameter_px = best.diameter;
        window.velocity_px_s = best.velocity.into();
        Some(window)
    }

    fn image(&self, view: &View, hypothesis: &Hypothesis, misses: u32) -> Option<Image> {
        let belief = &hypothesis.belief;
        let in_camera = &view.camera_from_world * Point::<World>::from(belief.position());
        let projected = view.model.project_with_jacobians(&in_camera)?;
        let by_world: Matrix2x3<f64> = projected.by_point * view.camera_from_world.rotation.matrix();
        let covariance = by_world * belief.position_covariance() * by_world.transpose();
        let velocity = by_world * belief.velocity();
        // The widest that a sphere appears, whatever the direction: scale along the ray's normal.
        let scale = by_world.row(0).norm().max(by_world.row(1).norm());
        let diameter = self.diameter_m * scale;
        let grown = 1.0 + GROWTH_PER_MISS * f64::from(misses.min(10));
        let half = Vector2::from_fn(|i, _| {
            SIGMAS * covariance[(i, i)].max(0.0).sqrt()
                + 0.5 * diameter
                + 0.5 * velocity[i].abs() * view.exposure_s
                + MARGIN_PX * grown
        });
        // The outline is an ellipse off the axis: the diameter that is told is that of a circle of its area.
        let area_scale = by_world.row(0).cross(&by_world.row(1)).norm();
        let diameter = self.diameter_m * area_scale.sqrt();
        Some(Image { centre: projected.pixel, covariance, velocity, diameter, half })
    }
}
