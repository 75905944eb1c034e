use netcord_common::{
    camera::CameraModel,
    wire::{Detection, DetectionFlags},
};

use super::{
    fit::{Fit, OUTLINE},
    measure::Measured,
    patch::Rectifier,
    sweep::Sweep,
};

/// Errors of the centre that no covariance of pixels knows of, standard deviations: of the lens's blur and the
/// pixels' fill, px; of a shading by several lamps, which moves a ball's outline by a share of its diameter; and of
/// light that changes along its path.
const FLOOR_PX: f64 = 0.02;
const FLOOR_DIAMETERS: f64 = 0.0035;
const FLOOR_PATHS: f64 = 0.005;

/// Share of the swept area that must differ from the fit for the ball to count as occluded.
const OCCLUDED: f32 = 0.12;

/// A measured candidate as a message says it: in pixels of the frame, the centre that of the sphere's image.
pub fn describe(camera: &CameraModel, measured: &Measured, score: f64) -> Detection {
    let fit = &measured.fit;
    let rectifier = &measured.place.rectifier;
    let outline = rectifier.pixel(fit.sweep.centre.map(f64::from));
    let radius = f64::from(fit.sweep.radius);
    let path = rectifier.offset_px(fit.sweep.path().map(f64::from));
    let moved = f64::from(fit.sweep.length) > 2.0 * fit.covariance[3][3].sqrt();

    let mut flags = 0;
    let mut centre = outline;
    if let Some(sphere) = measured.place.sphere_centre_px(camera, fit.sweep.centre.map(f64::from), radius) {
        centre = sphere;
        flags |= DetectionFlags::SPHERE_CORRECTED;
    }
    let (least, most) = extent_px(&fit.sweep, rectifier);
    let covariance = covariance_px(fit, rectifier);
    let spread = [covariance[0].sqrt(), covariance[2].sqrt()];
    let (mut low, mut high) = ([0.0; 2], [0.0; 2]);
    let edge = [camera.width, camera.height].map(|n| f64::from(n) - 0.5);
    let mut cut = false;
    for axis in 0..2 {
        cut |= least[axis] < -0.5 || most[axis] > edge[axis];
        let margin = 0.5 + 2.0 * spread[axis].min(2.0);
        low[axis] = (least[axis] - margin).max(-0.5);
        high[axis] = (most[axis] + margin).min(edge[axis]);
    }
    if cut {
        flags |= DetectionFlags::CUT_BY_FRAME;
    }
    if measured.verdict.hidden > OCCLUDED {
        flags |= DetectionFlags::OCCLUDED;
    }
    if measured.verdict.saturated {
        flags |= DetectionFlags::SATURATED;
    }
    if moved {
        flags |= DetectionFlags::BLUR_MEASURED;
    }
    let blur = if moved { positive(path) } else { [0.0; 2] };
    let diameter = if moved { across(rectifier, path, radius) } else { 2.0 * radius };
    Detection {
        u_px: centre[0],
        v_px: centre[1],
        covariance_px2: covariance,
        x0_px: low[0],
        y0_px: low[1],
        x1_px: high[0],
        y1_px: high[1],
        diameter_px: diameter,
        area_px2: f64::from(fit.sweep.area()),
        blur_u_px: blur[0],
        blur_v_px: blur[1],
        score: score.clamp(0.0, 1.0),
        flags,
        _reserved: 0,
    }
}

/// The least and the greatest pixel coordinates of an outline.
fn extent_px(sweep: &Sweep, rectifier: &Rectifier) -> ([f64; 2], [f64; 2]) {
    /// Places on the outline of the disc at either end of its path, on a circle around that outline.
    const PLACES: u32 = 12;
    let step = std::f64::consts::TAU / f64::from(PLACES);
    let radius = f64::from(sweep.radius) / (0.5 * step).cos();
    let ([x, y], [along, down]) = (sweep.centre.map(f64::from), sweep.path().map(f64::from));
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for place in 0..PLACES {
        let (sin, cos) = (f64::from(place) * step).sin_cos();
        for end in [-0.5, 0.5] {
            let pixel = rectifier.pixel([x + end * along + radius * cos, y + end * down + radius * sin]);
            for axis in 0..2 {
                low[axis] = low[axis].min(pixel[axis]);
                high[axis] = high[axis].max(pixel[axis]);
            }
        }
    }
    (low, high)
}

/// The vector or its opposite, whichever begins with a positive number.
fn positive([u, v]: [f64; 2]) -> [f64; 2] {
    if u < 0.0 || (u == 0.0 && v < 0.0) { [-u, -v] } else { [u, v] }
}

/// The width across `path` of the image of a circle of `radius`.
fn across(rectifier: &Rectifier, path: [f64; 2], radius: f64) -> f64 {
    let norm = path[0].hypot(path[1]).max(1e-9);
    let normal = [-path[1] / norm, path[0] / norm];
    let [[a, b], [c, d]] = rectifier.backward();
    2.0 * radius * (a * normal[0] + c * normal[1]).hypot(b * normal[0] + d * normal[1])
}

/// Covariance of the centre in pixels, from that along and across the path: uu, uv, vv.
fn covariance_px(fit: &Fit, rectifier: &Rectifier) -> [f64; 3] {
    let (sin, cos) = f64::from(fit.sweep.angle).sin_cos();
    let inflate = f64::from(fit.chi2.max(1.0));
    let c: &[[f64; OUTLINE]; OUTLINE] = &fit.covariance;
    let [[a, b], [d, e]] = rectifier.backward();
    // Columns: the image of a unit step along, and across.
    let along = [a * cos + b * sin, d * cos + e * sin];
    let across = [-a * sin + b * cos, -d * sin + e * cos];
    let element = |i: usize, j: usize| {
        inflate
            * (c[0][0] * along[i] * along[j]
                + c[0][1] * (along[i] * across[j] + across[i] * along[j])
                + c[1][1] * across[i] * across[j])
    };
    let floors = [
        FLOOR_PX,
        FLOOR_DIAMETERS * 2.0 * f64::from(fit.sweep.radius),
        FLOOR_PATHS * f64::from(fit.sweep.length),
    ];
    let floor = floors.iter().map(|f| f * f).sum::<f64>();
    [element(0, 0) + floor, element(0, 1), element(1, 1) + floor]
}
