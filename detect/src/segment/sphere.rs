//! How a small sphere looks through a camera with distortion.

use nalgebra::{Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point},
};

use super::{look::Light, patch::Rectifier};

/// Step of the numeric derivative across the line of sight, rad: well above rounding, well below the
/// angle over which the lens bends.
const STEP_RAD: f64 = 5e-4;

/// Step of the second derivatives: wider, for differences of differences.
const WIDE_STEP_RAD: f64 = 5e-3;

/// A line of sight and two directions across it.
struct Sight {
    along: Vector3<f64>,
    across: [Vector3<f64>; 2],
}

fn sight(camera: &CameraModel, pixel: [f64; 2]) -> Option<Sight> {
    let along = camera.ray(&Vector2::new(pixel[0], pixel[1]))?;
    let right = (Vector3::x() - along * along.x).try_normalize(1e-6)?;
    Some(Sight { along, across: [right, along.cross(&right)] })
}

fn image(camera: &CameraModel, direction: &Vector3<f64>) -> Option<Vector2<f64>> {
    camera.project(&Point::<Camera>::from(*direction))
}

/// What the measuring of a candidate needs to know of its place in the frame.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// The local map in which the outline of a small sphere is a circle.
    pub rectifier: Rectifier,
    /// The angle that one pixel subtends there, rad; none where the lens model does not reach.
    pub angle_per_px: Option<f64>,
    /// The axes of the patch in the camera's frame: x, y, and towards the camera.
    pub axes: [Vector3<f64>; 3],
}

impl Place {
    /// A light's direction and two directions across it on the patch's axes.
    pub fn light(&self, towards: &Vector3<f64>) -> Light {
        self.light_vectors(towards).map(|v| self.axes.map(|axis| v.dot(&axis) as f32))
    }

    /// The direction of a light after it has been turned to its two sides.
    pub fn turned(&self, towards: &Vector3<f64>, turn: [f32; 2]) -> Vector3<f64> {
        let [light, a, b] = self.light_vectors(towards);
        (light + a * f64::from(turn[0]) + b * f64::from(turn[1])).normalize()
    }

    /// The image of the centre of a sphere whose outline in the patch has this centre and radius; none where the lens
    /// model does not reach.
    ///
    /// The patch lies in a plane across the line of sight through its origin, where a sphere on that line shows a
    /// circle about it. Of one beside it the outline is an ellipse, whose centre lies farther out by tan² of the angle
    /// that the sphere subtends.
    pub fn sphere_centre_px(&self, camera: &CameraModel, centre: [f64; 2], radius: f64) -> Option<[f64; 2]> {
        let angle = self.angle_per_px?;
        let out = 1.0 + (radius * angle).powi(2);
        let [x, y] = centre.map(|c| c * angle / out);
        let pixel = image(camera, &(self.axes[0] * x + self.axes[1] * y - self.axes[2]))?;
        Some([pixel.x, pixel.y])
    }

    fn light_vectors(&self, towards: &Vector3<f64>) -> [Vector3<f64>; 3] {
        // Any two directions across serve; these have no pole for light from above or from the side.
        let across = towards.cross(&self.axes[2]);
        let across = across.try_normalize(1e-3).unwrap_or(self.axes[0]);
        [*towards, across, across.cross(towards)]
    }
}

/// Of `pixel`.
pub fn place(camera: &CameraModel, pixel: [f64; 2]) -> Place {
    local_map(camera, pixel).unwrap_or(Place {
        rectifier: Rectifier::plain(pixel),
        angle_per_px: None,
        axes: [Vector3::x(), Vector3::y(), -Vector3::z()],
    })
}

fn local_map(camera: &CameraModel, pixel: [f64; 2]) -> Option<Place> {
    let sight = sight(camera, pixel)?;
    let column = |across: &Vector3<f64>| -> Option<Vector2<f64>> {
        let step = across * STEP_RAD;
        let ahead = image(camera, &(sight.along + step))?;
        let behind = image(camera, &(sight.along - step))?;
        Some((ahead - behind) / (2.0 * STEP_RAD))
    };
    let (a, b) = (column(&sight.across[0])?, column(&sight.across[1])?);
    let determinant = a.x * b.y - a.y * b.x;
    if determinant <= 0.0 {
        return None;
    }
    let scale = determinant.sqrt();
    // scale × J⁻¹, J having the columns a and b.
    let forward = [[b.y / scale, -b.x / scale], [-a.y / scale, a.x / scale]];
    // Second differences: of the direction across, the other, and both together.
    let middle = image(camera, &sight.along)?;
    let curvature = |across: Vector3<f64>| -> Option<Vector2<f64>> {
        let step = across * WIDE_STEP_RAD;
        let ends = image(camera, &(sight.along + step))? + image(camera, &(sight.along - step))?;
        Some((ends - middle * 2.0) / (WIDE_STEP_RAD * scale).powi(2))
    };
    let [e, f] = sight.across;
    let (ee, ff, both) = (curvature(e)?, curvature(f)?, curvature(e + f)?);
    let ef = (both - ee - ff) * 0.5;
    let unbend = [0, 1].map(|i| [0.5 * ee[i], ef[i], 0.5 * ff[i]]);
    Some(Place {
        rectifier: Rectifier { anchor: pixel, forward, bend: inverse_bend(&forward, &unbend), unbend },
        angle_per_px: Some(1.0 / scale),
        axes: [e, f, -sight.along],
    })
}

/// The second order of the inverse of x + U(F x), F being `forward`, of which F is the first: −F U(F x).
fn inverse_bend(forward: &[[f64; 2]; 2], unbend: &[[f64; 3]; 2]) -> [[f64; 3]; 2] {
    let [[a, b], [c, d]] = *forward;
    // U's terms of F x, in x², x y and y².
    let terms = unbend.map(|[xx, xy, yy]| {
        [
            xx * a * a + xy * a * c + yy * c * c,
            2.0 * xx * a * b + xy * (a * d + b * c) + 2.0 * yy * c * d,
            xx * b * b + xy * b * d + yy * d * d,
        ]
    });
    forward.map(|[p, q]| std::array::from_fn(|k| -(p * terms[0][k] + q * terms[1][k])))
}

#[cfg(test)]
mod tests {
    use netcord_common::camera::Distortion;

    use super::*;

    /// How much larger a small area becomes by the map.
    fn jacobian(map: &Rectifier, [u, v]: [f64; 2]) -> f64 {
        let h = 1e-3;
        let slope = |du: f64, dv: f64| {
            let (ahead, behind) = (map.rectify([u + du, v + dv]), map.rectify([u - du, v - dv]));
            [0, 1].map(|i| (ahead[i] - behind[i]) / (2.0 * h))
        };
        let ([a, c], [b, d]) = (slope(h, 0.0), slope(0.0, h));
        a * d - b * c
    }

    /// The outline found by rays: pixels whose line of sight meets the sphere.
    #[test]
    fn the_centre_of_area_of_a_ray_traced_sphere_is_corrected_to_the_image_of_its_centre() {
        let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
        let camera =
            CameraModel::new((1920, 1200), (672.282, 672.689), (984.047, 602.967), lens).expect("valid");
        let radius = 0.02;
        for (x, y, z) in [(0.0, 0.0, 0.7), (0.7, 0.3, 0.6), (-0.9, -0.5, 0.8), (0.3, 0.45, 0.6)] {
            let centre = Vector3::new(x, y, z);
            let truth = image(&camera, &centre).expect("in view");
            let (mut n, mut sum) = (0.0, Vector2::zeros());
            let reach = 60.0;
            let steps = 480;
            for i in 0..steps * steps {
                let offset = |k: i32| (f64::from(k) + 0.5) / f64::from(steps) * 2.0 * reach - reach;
                let pixel = truth + Vector2::new(offset(i % steps), offset(i / steps));
                let Some(ray) = camera.ray(&pixel) else { continue };
                if (centre - ray * ray.dot(&centre)).norm() < radius {
                    n += 1.0;
                    sum += pixel;
                }
            }
            let outline = sum / n;
            let angle = (radius / centre.norm()).asin();
            if x != 0.0 {
                assert!((outline - truth).norm() > 0.1, "there is something to correct");
            }
            // Wherever the patch begins, its outline is a circle, and leads to the centre.
            for start in [[0.0, 0.0], [4.0, -3.0]] {
                let place = place(&camera, [truth.x + start[0], truth.y + start[1]]);
                let (mut middle, mut count) = (Vector2::zeros(), 0.0);
                let mut moments = [0.0; 3];
                for i in 0..steps * steps {
                    let offset = |k: i32| (f64::from(k) + 0.5) / f64::from(steps) * 2.0 * reach - reach;
                    let pixel = truth + Vector2::new(offset(i % steps), offset(i / steps));
                    let Some(ray) = camera.ray(&pixel) else { continue };
                    if (centre - ray * ray.dot(&centre)).norm() < radius {
                        let [x, y] = place.rectifier.rectify([pixel.x, pixel.y]);
                        let area = jacobian(&place.rectifier, [pixel.x, pixel.y]);
                        count += area;
                        middle += Vector2::new(x, y) * area;
                        moments[0] += x * x * area;
                        moments[1] += x * y * area;
                        moments[2] += y * y * area;
                        let [u, v] = place.rectifier.pixel([x, y]);
                        let back = (Vector2::new(u, v) - pixel).norm();
                        assert!(
                            back < 0.1 || (pixel - truth).norm() > 15.0,
                            "off by {back} px there and back"
                        );
                    }
                }
                middle /= count;
                let [xx, xy, yy] = moments.map(|m| m / count);
                let (xx, xy, yy) =
                    (xx - middle.x * middle.x, xy - middle.x * middle.y, yy - middle.y * middle.y);
                assert!((xx / yy - 1.0).abs() < 0.02 && (xy / yy).abs() < 0.02, "round: {xx} {xy} {yy}");
                let radius = 2.0 * (0.5 * (xx + yy)).sqrt();
                let found = place.sphere_centre_px(&camera, [middle.x, middle.y], radius).expect("in view");
                let off = (Vector2::from(found) - truth).norm();
                assert!(off < 0.02, "{truth} from {start:?}: off by {off} px");
            }
            let place = place(&camera, [truth.x, truth.y]);
            let (map, per_px) = (place.rectifier, place.angle_per_px.expect("in view"));
            let area = std::f64::consts::PI * (angle / per_px).powi(2);
            let found = n * (2.0 * reach / f64::from(steps)).powi(2);
            assert!((area / found - 1.0).abs() < 0.02, "{area} {found}");
            let [u, v] = map.pixel([3.0, -2.0]);
            let back = map.rectify([u, v]);
            assert!((back[0] - 3.0).abs() < 1e-3 && (back[1] + 2.0).abs() < 1e-3, "{back:?}");
        }
    }
}
