//! How a small sphere looks through a camera with distortion.

use nalgebra::{Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point},
};

use super::{patch::Rectifier, sweep::Light};

/// Step of the numeric derivative across the line of sight, rad: well above rounding, well below the
/// angle over which the lens bends.
const STEP_RAD: f64 = 5e-4;

/// Points of the outline that its centre is taken from.
const OUTLINE_POINTS: usize = 12;

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
    Some(Place {
        rectifier: Rectifier { anchor: pixel, forward },
        angle_per_px: Some(1.0 / scale),
        axes: [sight.across[0], sight.across[1], -sight.along],
    })
}

/// What must be added to the centre of a sphere's outline, at `pixel`, to give the image of the sphere's
/// centre; `angle` is half the angle that the sphere subtends, rad.
///
/// The outline is the image of a cone about the line to the sphere's centre. Seen off the axis the far side
/// of the cone is stretched more than the near one: the outline's centre lies further out.
pub fn outline_to_centre(camera: &CameraModel, pixel: [f64; 2], angle: f64) -> Option<[f64; 2]> {
    // The shift is a property of the centre, which the first round finds to a few per cent.
    let first = shift_of(camera, pixel, angle)?;
    shift_of(camera, [pixel[0] + first[0], pixel[1] + first[1]], angle)
}

fn shift_of(camera: &CameraModel, pixel: [f64; 2], angle: f64) -> Option<[f64; 2]> {
    let sight = sight(camera, pixel)?;
    let (sin, cos) = angle.sin_cos();
    let middle = image(camera, &sight.along)?;
    let mut rim = [Vector2::zeros(); OUTLINE_POINTS];
    for (i, rim) in rim.iter_mut().enumerate() {
        let (s, c) = (std::f64::consts::TAU * i as f64 / OUTLINE_POINTS as f64).sin_cos();
        let direction = sight.along * cos + (sight.across[0] * c + sight.across[1] * s) * sin;
        *rim = image(camera, &direction)? - middle;
    }
    // Centroid of the polygon: the mean of its corners would be drawn to where they lie close.
    let (mut area, mut moment) = (0.0, Vector2::zeros());
    for (i, a) in rim.iter().enumerate() {
        let b = rim[(i + 1) % OUTLINE_POINTS];
        let twice = a.x * b.y - a.y * b.x;
        area += twice;
        moment += (a + b) * twice;
    }
    let shift = -moment / (3.0 * area);
    Some([shift.x, shift.y])
}

#[cfg(test)]
mod tests {
    use netcord_common::camera::Distortion;

    use super::*;

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
            let shift = outline_to_centre(&camera, [outline.x, outline.y], angle).expect("in view");
            let corrected = outline + Vector2::new(shift[0], shift[1]);
            // The nearest of these balls are 60 px and more across: their second order is left out.
            assert!(
                (corrected - truth).norm() < 0.05 + 0.1 * (outline - truth).norm(),
                "{truth}: {outline} {corrected}"
            );
            if x != 0.0 {
                assert!((outline - truth).norm() > 0.1, "there is something to correct");
            }
            let place = place(&camera, [truth.x, truth.y]);
            let (map, per_px) = (place.rectifier, place.angle_per_px.expect("in view"));
            let area = std::f64::consts::PI * (angle / per_px).powi(2);
            let found = n * (2.0 * reach / f64::from(steps)).powi(2);
            assert!((area / found - 1.0).abs() < 0.02, "{area} {found}");
            let [u, v] = map.pixel([3.0, -2.0]);
            let back = map.rectify_offset([u - map.anchor[0], v - map.anchor[1]]);
            assert_eq!(back.map(|v| (v * 1e9).round()), [3e9, -2e9]);
        }
    }
}
