//! The crossing of two edges, fitted as a whole: for noisy pictures.

use nalgebra::{SMatrix, SVector, Vector2};

use super::luma::Luma;

/// Steps of the iteration.
const STEPS: usize = 12;
/// Steps below this, in px, end it.
const STILL_PX: f64 = 2e-3;
/// Narrowest and widest edge, as the standard deviation of its blur, px.
const BLUR_PX: std::ops::RangeInclusive<f64> = 0.3..=5.0;

/// Where two blurred edges cross: the least squares of I = a + b tanh(k n₁·(q − p)) tanh(k n₂·(q − p)) over the
/// pixels q of a disc, by p, both edges' directions, a, b and k. What two edges say of their crossing grows with
/// their length, where a parabola only hears what happens within the blur around it. `start` and the edges'
/// `directions` come from a first fit; `None` when it leads more than a pixel away.
pub(super) fn fit_crossing(
    image: &Luma,
    start: Vector2<f64>,
    directions: [Vector2<f64>; 2],
    radius: f64,
) -> Option<Vector2<f64>> {
    let reach = radius.floor() as i64;
    let (cx, cy) = (start.x.round() as i64, start.y.round() as i64);
    if cx < reach || cy < reach || cx + reach >= image.width() as i64 || cy + reach >= image.height() as i64 {
        return None;
    }
    let mut pixels = Vec::new();
    for (x, y) in (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (x, y))) {
        if ((x * x + y * y) as f64) <= radius * radius {
            let (x, y) = (cx + x, cy + y);
            let value = f64::from(image.pixels()[y as usize * image.width() + x as usize]);
            pixels.push((Vector2::new(x as f64, y as f64), value));
        }
    }
    let angle = |d: Vector2<f64>| d.y.atan2(d.x);
    // Place, the two angles, the slope of the edges; level and contrast are linear.
    let mut state = SVector::<f64, 7>::zeros();
    (state[0], state[1]) = (start.x, start.y);
    (state[2], state[3]) = (angle(directions[0]), angle(directions[1]));
    state[4] = 0.6;
    let edges = |state: &SVector<f64, 7>, q: &Vector2<f64>| {
        let off = q - Vector2::new(state[0], state[1]);
        [state[2], state[3]].map(|angle| {
            let (sin, cos) = angle.sin_cos();
            let (across, along) = (cos * off.y - sin * off.x, cos * off.x + sin * off.y);
            ((state[4] * across).tanh(), across, along, sin, cos)
        })
    };
    let mean = pixels.iter().map(|p| p.1).sum::<f64>() / pixels.len() as f64;
    let (mut over, mut under) = (0.0, 1e-12);
    for (q, value) in &pixels {
        let [e, f] = edges(&state, q);
        over += (value - mean) * e.0 * f.0;
        under += (e.0 * f.0).powi(2);
    }
    (state[5], state[6]) = (mean, over / under);
    for _ in 0..STEPS {
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        let mut rhs = SVector::<f64, 7>::zeros();
        for (q, value) in &pixels {
            let [e, f] = edges(&state, q);
            let (k, contrast) = (state[4], state[6]);
            // ∂/∂(k × across) of each factor, times the other.
            let slope = [(1.0 - e.0 * e.0) * f.0, (1.0 - f.0 * f.0) * e.0].map(|s| contrast * s);
            let mut row = SVector::<f64, 7>::zeros();
            for (i, (edge, s)) in [e, f].iter().zip(slope).enumerate() {
                let (_, across, along, sin, cos) = *edge;
                row[0] += s * k * sin;
                row[1] -= s * k * cos;
                row[2 + i] = -s * k * along;
                row[4] += s * across;
            }
            row[5] = 1.0;
            row[6] = e.0 * f.0;
            let off = value - (state[5] + contrast * e.0 * f.0);
            normal += row * row.transpose();
            rhs += row * off;
        }
        for i in 0..7 {
            normal[(i, i)] *= 1.0 + 1e-4;
        }
        let step = normal.cholesky()?.solve(&rhs);
        state += step;
        let moved = Vector2::new(state[0], state[1]) - start;
        // tanh(k x) is nearest to a Gaussian's distribution function of σ = 0.85 / k.
        if moved.norm() > 1.0 || !BLUR_PX.contains(&(0.85 / state[4])) {
            return None;
        }
        if step[0].hypot(step[1]) < STILL_PX {
            return Some(Vector2::new(state[0], state[1]));
        }
    }
    None
}
