//! What a ball at some place looks like in a camera, against what a detection says.

use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};
use netcord_common::wire::{Detection, DetectionFlags, MAX_CAMERAS};

use super::{Observation, PosedCamera};

/// Scatter of the logarithm of a measured diameter, blurred or not: measured 0.06 where the ball was expected and
/// 0.13 elsewhere, with longer tails than a normal distribution has.
const SIZE_SIGMA: f64 = 0.15;
/// The most that a size costs, in squared standard deviations: shadows and nets do what they like.
const MOST_SIZE: f64 = 9.0;

/// What a measured path is off by beside the covariance of its middle: px, and share of its length.
const BLUR_SIGMA_PX: f64 = 1.5;
const BLUR_SHARE: f64 = 0.15;
/// Speed of a ball in play, one standard deviation in each direction, m/s: the fastest that are known, 45 m/s, are three.
const SPEED_SIGMA_M_S: f64 = 15.0;
/// The most that paths cost which do not belong together: a ball that is hit or bounces during the exposure has two.
pub(super) const MOST_MOTION: f64 = 16.0;

/// The image of the neighbourhood of a point in one camera, to first order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Appearance {
    /// ∂pixel/∂point of the world, px/m.
    by_world: Matrix2x3<f64>,
}

impl Appearance {
    /// Of `point` in the camera that has `seen` it; none behind it.
    pub fn of(camera: &PosedCamera, seen: &Observation, point: &Vector3<f64>) -> Self {
        let p = camera.in_camera(point);
        let (n, r) = (p.xy() / p.z, &camera.rotation);
        let by_world = |i: usize| (r.row(i) - r.row(2) * n[i]) / p.z;
        let normalised_by_world = Matrix2x3::from_rows(&[by_world(0), by_world(1)]);
        Self { by_world: seen.pixel_by_normalised * normalised_by_world }
    }

    /// ∂pixel/∂point of the world, px/m.
    pub const fn by_world(&self) -> &Matrix2x3<f64> {
        &self.by_world
    }

    /// The diameter, px, that a segmenter states of a ball of `radius_m` here: off the axis its image is an ellipse.
    /// Where the ball has left a path, that of the ellipse across it; else that of the circle with its area.
    fn diameter_px(&self, detection: &Detection, radius_m: f64) -> f64 {
        let path = path_of(detection).filter(|path| *path != Vector2::zeros());
        let px_m = match path {
            Some(path) => {
                let across = Vector2::new(-path.y, path.x).normalize();
                self.by_world.tr_mul(&across).norm()
            }
            None => self.by_world.row(0).cross(&self.by_world.row(1)).norm().sqrt(),
        };
        2.0 * radius_m * px_m
    }

    /// Squared distance of the measured diameter from that of a ball of `radius_m` here, in standard deviations, and
    /// bounded; zero where no diameter was measured. A part of a ball tells less.
    pub fn size_distance(&self, detection: &Detection, radius_m: f64, is_partial: bool) -> f64 {
        if detection.diameter_px <= 0.0 {
            return 0.0;
        }
        let sigma = if is_partial { 2.0 * SIZE_SIGMA } else { SIZE_SIGMA };
        let ratio = detection.diameter_px / self.diameter_px(detection, radius_m);
        (ratio.ln() / sigma).powi(2).min(MOST_SIZE)
    }
}

/// The path of a ball's image during the exposure, px, but for its sense; none where it was not measured.
fn path_of(detection: &Detection) -> Option<Vector2<f64>> {
    let measured = detection.flags & DetectionFlags::BLUR_MEASURED != 0;
    measured.then(|| Vector2::new(detection.blur_u_px, detection.blur_v_px))
}

/// Variance of a measured path, px².
fn path_variance(detection: &Detection, path: &Vector2<f64>) -> f64 {
    let [uu, _, vv] = detection.covariance_px2;
    BLUR_SIGMA_PX * BLUR_SIGMA_PX + BLUR_SHARE * BLUR_SHARE * path.norm_squared() + uu.max(vv).max(0.0)
}

/// Views of whose paths every sense is tried: three show a velocity well enough to tell those of the others.
const TRIED: usize = 3;

/// Finds the one velocity that the paths in several views show.
#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    information: Matrix3<f64>,
    /// That of the first [`TRIED`] views.
    begun: Matrix3<f64>,
    /// Of each view, what it adds to the normal equations; its sign is not known.
    pulls: [Vector3<f64>; MAX_CAMERAS],
    count: usize,
    squares: f64,
}

impl Default for Motion {
    fn default() -> Self {
        let information = Matrix3::identity() / (SPEED_SIGMA_M_S * SPEED_SIGMA_M_S);
        Self {
            information,
            begun: information,
            pulls: [Vector3::zeros(); MAX_CAMERAS],
            count: 0,
            squares: 0.0,
        }
    }
}

impl Motion {
    /// Adds what one view shows, if it shows a path, and its exposure is known.
    pub fn see(&mut self, appearance: &Appearance, detection: &Detection, exposure_s: f64) {
        let Some(path) = path_of(detection).filter(|_| exposure_s > 0.0) else { return };
        let weight = 1.0 / path_variance(detection, &path);
        let by_velocity = appearance.by_world * exposure_s;
        self.information += by_velocity.tr_mul(&by_velocity) * weight;
        self.pulls[self.count] = by_velocity.tr_mul(&path) * weight;
        self.count += 1;
        if self.count <= TRIED {
            self.begun = self.information;
        }
        self.squares += path.norm_squared() * weight;
    }

    /// Squared distance of the paths from those of the velocity that fits best, and of that from what balls have, in
    /// standard deviations, and bounded.
    pub fn distance(&self) -> f64 {
        if self.count == 0 {
            return 0.0;
        }
        let inverse = |information: &Matrix3<f64>| information.cholesky().map(|c| c.inverse());
        let (Some(spread), Some(begun)) = (inverse(&self.information), inverse(&self.begun)) else {
            return 0.0;
        };
        let pulls = &self.pulls[..self.count];
        let (first, rest) = pulls.split_at(self.count.min(TRIED));
        let mut most: f64 = 0.0;
        // A path does not tell its sense: for the first views each sense is tried, the others agree with these.
        for senses in 0..1_u32 << (first.len() - 1) {
            let turned = |sum: Vector3<f64>, (i, pull): (usize, &Vector3<f64>)| {
                if senses & (1 << i) == 0 { sum + pull } else { sum - pull }
            };
            let mut sum = first.iter().enumerate().fold(Vector3::zeros(), turned);
            let velocity = begun * sum;
            for pull in rest {
                sum += if velocity.dot(pull) < 0.0 { -pull } else { *pull };
            }
            most = most.max(sum.dot(&(spread * sum)));
        }
        (self.squares - most).clamp(0.0, MOST_MOTION)
    }
}

/// Squared distance of a detection's path from that of a ball of `velocity`, m/s, in standard deviations; zero where
/// none was measured, or the exposure is not known.
pub(super) fn path_distance(
    appearance: &Appearance,
    detection: &Detection,
    velocity: &Vector3<f64>,
    exposure_s: f64,
) -> f64 {
    let Some(path) = path_of(detection).filter(|_| exposure_s > 0.0) else { return 0.0 };
    let expected = appearance.by_world * velocity * exposure_s;
    let apart = (path - expected).norm_squared().min((path + expected).norm_squared());
    apart / path_variance(detection, &path)
}

/// Squared distance of a detection's path from the longest that a thing leaves that is no faster than `speed`, m/s, in
/// standard deviations; zero where none was measured, or the exposure is not known.
pub(super) fn excess_distance(
    appearance: &Appearance,
    detection: &Detection,
    speed: f64,
    exposure_s: f64,
) -> f64 {
    let Some(path) = path_of(detection).filter(|_| exposure_s > 0.0) else { return 0.0 };
    // No direction is stretched more than this.
    let longest = appearance.by_world.norm() * speed * exposure_s;
    (path.norm() - longest).max(0.0).powi(2) / path_variance(detection, &path)
}

#[cfg(test)]
mod tests {
    use netcord_common::wire::DetectionFlags;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::{
        super::testing::{Plain, ring},
        *,
    };

    const RADIUS_M: f64 = 0.02;

    /// The outline of a ball as the images of the circle in which the cone of sight touches it.
    fn outline(plain: &Plain, ball: &Vector3<f64>) -> Vec<Vector2<f64>> {
        let sight = plain.r * ball + plain.t;
        let (range, along) = (sight.norm(), sight.normalize());
        let across = along.cross(&Vector3::x()).normalize();
        let third = along.cross(&across);
        let middle = sight - along * (RADIUS_M * RADIUS_M / range);
        let r = RADIUS_M * (1.0 - (RADIUS_M / range).powi(2)).sqrt();
        (0..720)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 720.0).sin_cos();
                let point = middle + across * (r * cos) + third * (r * sin);
                plain.pixel(&(plain.r.transpose() * (point - plain.t)))
            })
            .collect()
    }

    /// Of a place somewhere in view, with what camera 0 sees there.
    fn places() -> impl Iterator<Item = (Plain, Vector3<f64>, Appearance, Pcg64)> {
        let (plain, posed) = ring(2);
        let mut random = Pcg64::seed_from_u64(1);
        std::iter::repeat_with(move || {
            let ball = Vector3::new(
                random.random_range(-2.5..2.5),
                random.random_range(-3.0..3.0),
                random.random_range(0.0..2.0),
            );
            if posed[0].in_camera(&ball).z < 0.5 {
                return None;
            }
            let pixel = plain[0].pixel(&ball);
            let seen = posed[0].observe(0, pixel, nalgebra::Matrix2::identity())?;
            let in_view = posed[0].model.contains(&pixel);
            in_view.then(|| (plain[0].clone(), ball, Appearance::of(&posed[0], &seen, &ball), random.clone()))
        })
        .flatten()
    }

    #[test]
    fn the_stated_diameter_is_that_of_the_outline_in_the_corners_too() {
        let mut most_oblong: f64 = 0.0;
        for (plain, ball, appearance, mut random) in places().take(200) {
            let outline = outline(&plain, &ball);
            let next = |i: usize| outline[(i + 1) % outline.len()];
            let area = 0.5 * (0..outline.len()).map(|i| outline[i].perp(&next(i))).sum::<f64>().abs();
            let round = Detection { diameter_px: 1.0, ..Detection::default() };
            let of_area = (4.0 * area / std::f64::consts::PI).sqrt();
            let found = appearance.diameter_px(&round, RADIUS_M);
            assert!((found / of_area - 1.0).abs() < 0.01, "{found} px, {of_area} px");

            let angle = random.random_range(0.0..std::f64::consts::PI);
            let normal = Vector2::new(-angle.sin(), angle.cos());
            let ends = outline.iter().map(|p| p.dot(&normal));
            let width = ends.clone().fold(f64::MIN, f64::max) - ends.fold(f64::MAX, f64::min);
            let blurred = Detection {
                blur_u_px: 30.0 * angle.cos(),
                blur_v_px: 30.0 * angle.sin(),
                flags: DetectionFlags::BLUR_MEASURED,
                diameter_px: width,
                ..Detection::default()
            };
            let found = appearance.diameter_px(&blurred, RADIUS_M);
            assert!((found / width - 1.0).abs() < 0.01, "{found} px, {width} px");
            assert!(appearance.size_distance(&blurred, RADIUS_M, false) < 0.01);
            most_oblong = most_oblong.max((width / of_area).max(of_area / width));
        }
        assert!(most_oblong > 1.2, "the views were such that it matters: {most_oblong}");
    }

    /// What a camera states of a ball's path from where it was to where it is, and of the place between.
    fn path(plain: &Plain, from: &Vector3<f64>, to: &Vector3<f64>) -> Detection {
        let path = plain.pixel(to) - plain.pixel(from);
        Detection {
            blur_u_px: path.x,
            blur_v_px: path.y,
            covariance_px2: [0.04, 0.0, 0.04],
            flags: DetectionFlags::BLUR_MEASURED,
            ..Detection::default()
        }
    }

    #[test]
    fn paths_of_one_ball_agree_and_those_of_two_things_do_not() {
        const EXPOSURE_S: f64 = 0.004;
        let mut random = Pcg64::seed_from_u64(2);
        for n in [2, 3, 8] {
            let (plain, posed) = ring(n);
            let mut apart = 0;
            for _ in 0..200 {
                let ball = Vector3::new(
                    random.random_range(-0.7..0.7),
                    random.random_range(-1.2..1.2),
                    random.random_range(0.0..0.4),
                );
                let mut velocity = || Vector3::from_fn(|_, _| random.random_range(-12.0..12.0));
                let (own, another) = (velocity(), velocity());
                let distance = |velocities: &mut dyn FnMut(usize) -> Vector3<f64>| {
                    let mut motion = Motion::default();
                    for i in 0..n {
                        let half = velocities(i) * (0.5 * EXPOSURE_S);
                        let mut seen = path(&plain[i], &(ball - half), &(ball + half));
                        if i % 2 == 1 {
                            // The segmenter states the path with either sense.
                            (seen.blur_u_px, seen.blur_v_px) = (-seen.blur_u_px, -seen.blur_v_px);
                        }
                        let pixel = plain[i].pixel(&ball);
                        let o = posed[i].observe(i, pixel, nalgebra::Matrix2::identity()).expect("in view");
                        let appearance = Appearance::of(&posed[i], &o, &ball);
                        motion.see(&appearance, &seen, EXPOSURE_S);
                        assert!(path_distance(&appearance, &seen, &velocities(i), EXPOSURE_S) < 0.1);
                        motion.see(&appearance, &seen, 0.0);
                    }
                    motion.distance()
                };
                let one = distance(&mut |_| own);
                assert!(one < 3.5, "{n} views, {own}: {one}");
                let two = distance(&mut |i| if i == 0 { own } else { another });
                apart += u32::from(two > one + 4.0);
            }
            println!("{n} views: {apart} of 200 pairs of paths tell that they are of two things");
            // Two views show four numbers of a velocity's three.
            assert!(apart > if n == 2 { 40 } else { 100 }, "{n} views: {apart}");
        }
    }

    #[test]
    fn a_thing_that_hovers_does_not_leave_the_path_of_a_fast_ball() {
        let (plain, posed) = ring(2);
        let ball = Vector3::new(0.0, -1.0, 0.3);
        let half = Vector3::new(0.05, -0.02, 0.0);
        let seen = path(&plain[0], &(ball - half), &(ball + half));
        let o = posed[0].observe(0, plain[0].pixel(&ball), nalgebra::Matrix2::identity()).expect("in view");
        let appearance = Appearance::of(&posed[0], &o, &ball);
        let still = path_distance(&appearance, &seen, &Vector3::zeros(), 0.004);
        let flying = path_distance(&appearance, &seen, &(half / 0.002), 0.004);
        assert!(still > 15.0 && flying < 0.1, "{still}, {flying}");
        assert_eq!(path_distance(&appearance, &seen, &Vector3::zeros(), 0.0), 0.0, "exposure unknown");
        let excess = |speed: f64| excess_distance(&appearance, &seen, speed, 0.004);
        assert!(excess(3.0) > 8.0 && excess(27.0) == 0.0, "{}, {}", excess(3.0), excess(27.0));
    }
}
