use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point, Transform, World},
};

use super::Rect;
use crate::synthetic::scene::Body;

/// An ellipsoid as a camera sees it: its exact outline, and the depth and normal of each of its points.
///
/// In coordinates in which it is the unit sphere at `c`, a ray along `d` meets it where
/// h = (d·c)²/|d|² − |c|² + 1 is positive. 1 − h is the square of t, the ray's distance from the centre as
/// a share of the outline's: t = 1 is the outline. It grows evenly across the image, so that (1 − t) over
/// the length of its gradient is the distance to the outline in pixels. Nothing here approximates the
/// outline by a circle or an ellipse; only the scale at which it fades is taken at its centre.
#[derive(Debug, Clone, Copy)]
pub struct Outline {
    /// Camera's directions to the unit sphere's coordinates.
    pub to_unit: Matrix3<f64>,
    /// The camera's centre sees the sphere here.
    pub centre: Vector3<f64>,
    /// |c|² − 1.
    pub beyond: f64,
    /// The unit sphere's normals to the world's, but for their length.
    pub normal_to_world: Matrix3<f64>,
    /// ∂(normalised)/∂(pixel).
    pub by_pixel: Matrix2<f64>,
    /// Below the first t a ray is certainly inside, above the second certainly outside.
    pub edge_t: (f64, f64),
    /// Standard deviation of pixel and lens together, px.
    pub blur_px: f64,
    /// Image of its centre, px.
    #[cfg(test)]
    image: Vector2<f64>,
    /// Pixels that it may touch.
    pub rect: Rect,
    /// Depth of its centre, m.
    pub depth_m: f64,
}

/// A point of a body, as a pixel sees it.
#[cfg(test)]
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// Share of the pixel that the body covers, 0–1.
    pub coverage: f64,
    /// Depth (camera z), m.
    pub depth_m: f64,
    /// Unit normal in the world.
    pub normal: Vector3<f64>,
    /// The point in the unit sphere's coordinates; on the rim a little outside.
    pub on_body: Vector3<f64>,
}

/// A pixel's square as blur: the variance of a box one pixel wide, in any direction.
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

/// Beyond so many standard deviations an edge is fully in or out: 0.3 % of a step.
pub const EDGE_SIGMAS: f64 = 3.0;

/// A body whose image would be farther out than so many frames is not in view.
const FAR_FRAMES: f64 = 3.0;

/// The pixels that an ellipsoid with these half-axes (columns, in the camera's frame) may touch inside the frame, and
/// `margin` more. `None` where the lens model does not hold at some corner of it.
fn bounds(model: &CameraModel, centre: &Vector3<f64>, axes: &Matrix3<f64>, margin: f64) -> Option<Rect> {
    // The planes x = k z that touch the ellipsoid: (n·c)² = |Aᵀ n|² with n = (1, 0, −k), and so for y.
    let touching = |axis: usize| {
        let (own, deep) = (axes.row(axis), axes.row(2));
        let a = centre.z * centre.z - deep.norm_squared();
        let b = centre[axis] * centre.z - own.dot(&deep);
        let c = centre[axis] * centre[axis] - own.norm_squared();
        let root = (b * b - a * c).max(0.0).sqrt();
        ((b - root) / a, (b + root) / a)
    };
    // No farther out than the frame reaches.
    let (width, height) = (f64::from(model.width), f64::from(model.height));
    let mut frame = [(f64::MAX, f64::MIN); 2];
    for (x, y) in
        [(0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (0.0, 0.5), (1.0, 0.5), (0.0, 1.0), (0.5, 1.0), (1.0, 1.0)]
    {
        let ray = model.undistort(&Vector2::new(x * width, y * height))?;
        for (range, at) in frame.iter_mut().zip([ray.x, ray.y]) {
            *range = (range.0.min(at), range.1.max(at));
        }
    }
    let within = |(low, high): (f64, f64), (least, most): (f64, f64)| {
        (low.clamp(least, most), high.clamp(least, most))
    };
    let (left, right) = within(touching(0), frame[0]);
    let (top, bottom) = within(touching(1), frame[1]);
    let (mut low, mut high) = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
    for step in 0..=EDGE_STEPS {
        let share = f64::from(step) / f64::from(EDGE_STEPS);
        let (x, y) = (left + share * (right - left), top + share * (bottom - top));
        for ray in [(x, top), (x, bottom), (left, y), (right, y)] {
            let pixel = model.project(&Point::from(Vector3::new(ray.0, ray.1, 1.0)))?;
            (low, high) = (low.inf(&pixel), high.sup(&pixel));
        }
    }
    let (middle, half) = ((low + high) * 0.5, (high - low) * 0.5);
    // What an edge bulges between two of its places.
    let half = half * 1.02 + Vector2::repeat(margin);
    Some(Rect::around((middle.x, middle.y), (half.x, half.y)))
}

/// Parts of each side of a rectangle of rays whose ends are looked at.
const EDGE_STEPS: u32 = 4;

impl Outline {
    /// How `camera` sees `body`; `None` when it is behind the camera, around it, or outside the model's
    /// field of view.
    pub fn new(
        model: &CameraModel,
        camera_from_world: &Transform<Camera, World>,
        body: &Body,
        lens_blur_px: f64,
    ) -> Option<Self> {
        let centre = camera_from_world * Point::<World>::from(body.centre);
        let axes = camera_from_world.rotation.matrix() * body.axes;
        let projected = model.project_with_jacobians(&centre)?;
        // Far outside, lens models of high order send a body's image anywhere, and make it as large as they like.
        let far = FAR_FRAMES * f64::from(model.width.max(model.height));
        if projected.pixel.amax() > far {
            return None;
        }
        let z = centre.coords.z;
        // Half of the image's extent is the support of the ellipsoid, to first order; nearness adds.
        let reach = axes.row(2).norm();
        if z <= 2.0 * reach {
            return None;
        }
        let blur_px = (PIXEL_VARIANCE + lens_blur_px * lens_blur_px).sqrt();
        let half = projected.by_point * axes;
        let near = 1.1 * z / (z - reach);
        let margin = EDGE_SIGMAS * blur_px + 1.0;
        // The smaller half-axis of the image bounds how fast t grows; a third is left for its changes.
        let narrow_px = half.singular_values().min();
        let edge = EDGE_SIGMAS * blur_px * 1.33 / narrow_px;
        let half = (half.row(0).norm() * near + margin, half.row(1).norm() * near + margin);
        let normalised = centre.coords.xy() / z;
        let (_, lens) = model.distort_with_jacobian(&normalised)?;
        let to_pixel = Matrix2::from_diagonal(&Vector2::new(model.fx, model.fy)) * lens;
        let to_unit = axes.try_inverse()?;
        let normal_to_world = camera_from_world.rotation.matrix().tr_mul(&to_unit.transpose());
        let centre = to_unit * centre.coords;
        Some(Self {
            to_unit,
            centre,
            beyond: centre.norm_squared() - 1.0,
            normal_to_world,
            by_pixel: to_pixel.try_inverse()?,
            edge_t: ((1.0 - edge).max(0.3), 1.0 + edge),
            blur_px,
            #[cfg(test)]
            image: projected.pixel,
            rect: Rect::around((projected.pixel.x, projected.pixel.y), half),
            depth_m: z,
        })
    }

    /// Draws the rectangle as close about the part inside the frame as can be: the plain one of a body that is
    /// large, or far off the camera's axis, has several times its pixels.
    pub fn enclose(
        &mut self,
        model: &CameraModel,
        camera_from_world: &Transform<Camera, World>,
        body: &Body,
    ) {
        let centre = camera_from_world * Point::<World>::from(body.centre);
        let axes = camera_from_world.rotation.matrix() * body.axes;
        let margin = EDGE_SIGMAS * self.blur_px + 1.0;
        if let Some(tight) = bounds(model, &centre.coords, &axes, margin) {
            self.rect = tight;
        }
    }

    /// Share of the pixel whose ray has the normalised coordinates `ray` that the body covers; `None` where none.
    pub fn covered(&self, ray: [f32; 2]) -> Option<f64> {
        let direction = self.direction(ray);
        let (dd, dc) = (direction.norm_squared(), direction.dot(&self.centre));
        // A ray that is not a number is refused too.
        if dc <= 0.0 || dc.is_nan() {
            return None;
        }
        let h = dc * dc / dd - self.beyond;
        let (inside, outside) = self.edge_t;
        if 1.0 - h > outside * outside {
            return None;
        }
        let t = (1.0 - h).max(0.0).sqrt();
        if t < inside { Some(1.0) } else { self.coverage(t, &direction, dd, dc) }
    }

    /// A ray in the unit sphere's coordinates.
    fn direction(&self, ray: [f32; 2]) -> Vector3<f64> {
        self.to_unit * Vector3::new(f64::from(ray[0]), f64::from(ray[1]), 1.0)
    }

    /// What the pixel whose ray has the normalised coordinates `ray` sees of the body.
    #[cfg(test)]
    pub fn seen(&self, ray: [f32; 2]) -> Option<Seen> {
        let coverage = self.covered(ray)?;
        let direction = self.direction(ray);
        let (dd, dc) = (direction.norm_squared(), direction.dot(&self.centre));
        let root = (dc * dc - dd * self.beyond).max(0.0).sqrt();
        let depth_m = (dc - root) / dd;
        let on_body = direction * depth_m - self.centre;
        Some(Seen { coverage, depth_m, normal: (self.normal_to_world * on_body).normalize(), on_body })
    }

    fn coverage(&self, t: f64, direction: &Vector3<f64>, dd: f64, dc: f64) -> Option<f64> {
        let (x, y) = (self.to_unit.column(0), self.to_unit.column(1));
        let (p, q) = (2.0 * dc / dd, 2.0 * dc * dc / (dd * dd));
        let by_ray = Vector2::new(
            p * x.dot(&self.centre) - q * x.dot(direction),
            p * y.dot(&self.centre) - q * y.dot(direction),
        );
        let slope = self.by_pixel.tr_mul(&by_ray).norm() / (2.0 * t);
        // Blurring a disc of radius ρ keeps its area, but a step blurred along the radius would add π σ²:
        // the outline is drawn in to √(ρ² − σ²).
        let blur = self.blur_px * slope;
        let sigmas = ((1.0 - blur * blur).max(0.0).sqrt() - t) / blur;
        if sigmas < -EDGE_SIGMAS {
            return None;
        }
        Some(if sigmas > EDGE_SIGMAS { 1.0 } else { step(sigmas) })
    }
}

/// The cumulative normal distribution from −3 to 3, to 3e-4: a polynomial of least greatest error.
pub fn step(x: f64) -> f64 {
    let s = x * x;
    0.5 + x * STEP.iter().rev().fold(0.0, |sum, c| sum * s + f64::from(*c))
}

/// Coefficients of [`step`]: of x, x³, x⁵, x⁷ and x⁹.
pub const STEP: [f32; 5] = [0.397_945_97, -0.063_984_974, 8.158_289e-3, -6.095_865e-4, 1.947_715_5e-5];

#[cfg(test)]
mod tests {
    use netcord_common::camera::Distortion;

    use super::*;
    use crate::synthetic::scene::Paint;

    fn camera() -> CameraModel {
        let lens = Distortion::from_array([-0.097_151, 0.067_889, -0.000_716, 0.000_305, -0.003_636]);
        CameraModel::new((1920, 1200), (672.282, 672.689), (984.047, 602.967), lens).expect("valid")
    }

    /// Share of a pixel's blurred light that comes from the body: rays through many places about the
    /// pixel, each undistorted exactly, met with the ellipsoid by solving the quadratic, weighted by the
    /// pixel's square and the lens's bell.
    fn brute(model: &CameraModel, body: &Body, lens: f64, x: f64, y: f64) -> f64 {
        let inverse = body.axes.try_inverse().expect("not flat");
        let (mut hit, mut all) = (0.0, 0.0);
        let steps = 5;
        let offsets: Vec<(f64, f64)> = (-7..=7)
            .map(|i| f64::from(i) * 0.37 * lens)
            .map(|o| (o, (-0.5 * (o / lens).powi(2)).exp()))
            .collect();
        for (du, wu) in &offsets {
            for (dv, wv) in &offsets {
                for i in 0..steps {
                    for j in 0..steps {
                        let inside = |k: i32| (f64::from(k) + 0.5) / f64::from(steps) - 0.5;
                        let pixel = Vector2::new(x + du + inside(i), y + dv + inside(j));
                        let n = model.undistort(&pixel).expect("in view");
                        let d = inverse * Vector3::new(n.x, n.y, 1.0);
                        let c = inverse * body.centre;
                        let b = d.dot(&c);
                        let met = b * b - d.norm_squared() * (c.norm_squared() - 1.0) >= 0.0;
                        hit += wu * wv * f64::from(u8::from(met));
                        all += wu * wv;
                    }
                }
            }
        }
        hit / all
    }

    #[test]
    fn coverage_is_that_of_rays_by_the_hundred_through_the_distorted_camera() {
        let model = camera();
        let paint = Paint::plain([1.0; 3]);
        let bodies = [
            Body::sphere(Vector3::new(0.1, -0.05, 1.9), 0.02, paint),
            // Near a corner of the image, where the outline is stretched and the lens bends most.
            Body::sphere(Vector3::new(-1.75, -0.95, 1.5), 0.02, paint),
            Body::sphere(Vector3::new(1.1, 0.6, 3.5), 0.02, paint),
            Body::limb(Vector3::new(0.3, 0.2, 2.0), Vector3::new(0.4, 0.1, 2.2), 0.02, paint),
        ];
        let here = Transform::<Camera, World>::identity();
        for (index, body) in bodies.iter().enumerate() {
            let lens = 0.5;
            let outline = Outline::new(&model, &here, body, lens).expect("in view");
            let (mut worst, mut area, mut true_area) = (0.0_f64, 0.0, 0.0);
            let (mut moment, mut true_moment) = (Vector2::zeros(), Vector2::zeros());
            for y in outline.rect.y0..outline.rect.y1 {
                for x in outline.rect.x0..outline.rect.x1 {
                    let (x, y) = (x as f64, y as f64);
                    let n = model.undistort(&Vector2::new(x, y)).expect("in view");
                    let fast = outline.seen([n.x as f32, n.y as f32]).map_or(0.0, |s| s.coverage);
                    let exact = brute(&model, body, lens, x, y);
                    worst = worst.max((fast - exact).abs());
                    (area, true_area) = (area + fast, true_area + exact);
                    moment += Vector2::new(x, y) * fast;
                    true_moment += Vector2::new(x, y) * exact;
                }
            }
            let off = (moment / area - true_moment / true_area).norm();
            assert!(off < 0.005, "body {index}: the centre of the image is off by {off} px");
            // The tip of a limb is bent more sharply than the blur is wide.
            let bound = if index == 3 { 0.08 } else { 0.03 };
            assert!(worst < bound, "body {index}: a pixel's coverage is off by {worst}");
            assert!((area / true_area - 1.0).abs() < 0.01, "body {index}: {area} against {true_area} px²");
        }
    }

    #[test]
    fn depth_and_normal_are_those_of_the_surface() {
        let model = camera();
        let body = Body::sphere(Vector3::new(0.3, 0.2, 2.0), 0.02, Paint::plain([1.0; 3]));
        let here = Transform::<Camera, World>::identity();
        let outline = Outline::new(&model, &here, &body, 0.5).expect("in view");
        let n = model.undistort(&(outline.image + Vector2::new(2.0, -1.0))).expect("in view");
        let seen = outline.seen([n.x as f32, n.y as f32]).expect("inside");
        let point = Vector3::new(n.x, n.y, 1.0) * seen.depth_m;
        assert!(((point - body.centre).norm() - 0.02).abs() < 1e-6);
        assert!((seen.normal - (point - body.centre) / 0.02).norm() < 1e-4);
        assert!(seen.normal.dot(&point) < 0.0, "faces the camera");
    }

    #[test]
    fn the_rectangle_of_a_large_body_holds_all_of_it_and_little_else() {
        let model = camera();
        let paint = Paint::plain([1.0; 3]);
        let here = Transform::<Camera, World>::identity();
        for body in [
            Body::upright(Vector3::new(0.2, -0.3, 2.0), [0.24, 0.16, 0.34], paint),
            // Far out, where the frame cuts it.
            Body::upright(Vector3::new(-1.1, 0.3, 0.9), [0.24, 0.16, 0.34], paint),
            Body::limb(Vector3::new(0.9, 0.2, 1.0), Vector3::new(0.7, 0.5, 1.3), 0.05, paint),
        ] {
            let mut outline = Outline::new(&model, &here, &body, 0.5).expect("in view");
            outline.enclose(&model, &here, &body);
            let Rect { x0, y0, x1, y1 } = outline.rect;
            let (mut inside, mut found) =
                (Rect { x0: i64::MAX, y0: i64::MAX, x1: i64::MIN, y1: i64::MIN }, 0);
            for (x, y) in (0..1200).flat_map(|y| (0..1920).map(move |x| (x, y))) {
                let n = model.undistort(&Vector2::new(x as f64, y as f64)).expect("in view");
                if outline.covered([n.x as f32, n.y as f32]).is_some() {
                    found += 1;
                    inside = inside.hull(&Rect { x0: x, y0: y, x1: x + 1, y1: y + 1 });
                }
            }
            assert!(found > 2000, "{found}");
            assert!(x0 <= inside.x0 && y0 <= inside.y0 && x1 >= inside.x1 && y1 >= inside.y1);
            let (columns, rows) = outline.rect.within(1920, 1200);
            let needed = (inside.x1 - inside.x0) * (inside.y1 - inside.y0);
            let given = (columns.len() * rows.len()) as i64;
            assert!(given < needed * 5 / 4, "{given} px for {needed}");
        }
    }

    #[test]
    fn what_a_lens_model_sends_far_outside_is_not_in_view() {
        let here = Transform::<Camera, World>::identity();
        // 80° off the axis, where the polynomial of the distortion has left all lenses behind.
        let body = Body::sphere(Vector3::new(1.0, 0.2, 0.18), 0.02, Paint::plain([1.0; 3]));
        let lens = Distortion::from_array([0.0, 0.1, 0.0, 0.0, 0.05]);
        let model = CameraModel::new((1920, 1200), (672.0, 672.0), (960.0, 600.0), lens).expect("valid");
        assert!(model.project(&Point::from(body.centre)).is_some_and(|pixel| pixel.amax() > 1e6));
        assert!(Outline::new(&model, &here, &body, 0.5).is_none());
    }

    #[test]
    fn what_is_behind_the_camera_is_not_seen() {
        let here = Transform::<Camera, World>::identity();
        let body = Body::sphere(Vector3::new(0.0, 0.0, -2.0), 0.02, Paint::plain([1.0; 3]));
        assert!(Outline::new(&camera(), &here, &body, 0.5).is_none());
    }
}
