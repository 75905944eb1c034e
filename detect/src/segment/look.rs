//! How the balls of one camera look, whatever their outline.

use super::patch::CHANNELS;

/// Width of the box that stands for the pixel together with the blur of an ordinary lens in focus (σ of about
/// 0.3 px), px.
pub const BOX_PX: f32 = 1.4;

/// The direction of the main light and two directions across it, all of unit length: on x and y of the
/// patch, and towards the camera.
pub type Light = [[f32; 3]; 3];

/// Terms of a [`Diffuse`] light: x, y, z, x², x y, x z, y², y z, z² of the surface's normal.
pub const TERMS: usize = 9;

/// What light from elsewhere than from the main lamp adds to a surface, as a share of the ball's level: a polynomial
/// of second order in the surface's normal, which tells any light from afar on a matt surface to a few per cent
/// (Ramamoorthi & Hanrahan 2001).
pub type Diffuse = [f32; TERMS];

/// How balls look on the axes of a patch.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    /// Width of the box that stands for pixel and blur, px.
    pub box_px: f32,
    /// The main lamp.
    pub light: Light,
    /// The light from elsewhere, by colour.
    pub diffuse: [Diffuse; CHANNELS],
    /// How much a ball's light may differ from that from place to place: standard deviation of its slopes, as a
    /// share of the ball's contrast.
    pub slope_spread: f64,
}

/// Spread of the slopes where the light has not been learnt.
pub const UNKNOWN_SLOPES: f64 = 0.15;

impl Look {
    /// In the light of one lamp.
    pub const fn lit_by(light: Light, box_px: f32) -> Self {
        Self { box_px, light, diffuse: [[0.0; TERMS]; CHANNELS], slope_spread: UNKNOWN_SLOPES }
    }
}

/// The polynomial on other axes, which are given on those of `diffuse`.
pub fn turned(diffuse: &Diffuse, axes: &[[f32; 3]; 3]) -> Diffuse {
    let [x, y, z, xx, xy, xz, yy, yz, zz] = *diffuse;
    let matrix = [[xx, 0.5 * xy, 0.5 * xz], [0.5 * xy, yy, 0.5 * yz], [0.5 * xz, 0.5 * yz, zz]];
    let dot = |a: &[f32; 3], b: &[f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let linear = |i: usize| dot(&axes[i], &[x, y, z]);
    let square = |i: usize, j: usize| {
        let row = matrix.each_ref().map(|row| dot(row, &axes[j]));
        dot(&axes[i], &row) * if i == j { 1.0 } else { 2.0 }
    };
    [
        linear(0),
        linear(1),
        linear(2),
        square(0, 0),
        square(0, 1),
        square(0, 2),
        square(1, 1),
        square(1, 2),
        square(2, 2),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_polynomial_has_the_same_values() {
        let diffuse = [0.3, -0.2, 0.5, 0.1, 0.4, -0.3, 0.2, 0.25, -0.15];
        let value = |d: &Diffuse, [x, y, z]: [f32; 3]| {
            let terms = [x, y, z, x * x, x * y, x * z, y * y, y * z, z * z];
            d.iter().zip(terms).map(|(d, t)| d * t).sum::<f32>()
        };
        let (sin, cos) = 0.7_f32.sin_cos();
        let (s, c) = 0.4_f32.sin_cos();
        let axes = [[cos, sin, 0.0], [-sin * c, cos * c, s], [sin * s, -cos * s, c]];
        let other = turned(&diffuse, &axes);
        for normal in [[1.0, 0.0, 0.0], [0.6, -0.64, 0.48], [-0.36, 0.48, 0.8]] {
            let here = axes.map(|axis| axis[0] * normal[0] + axis[1] * normal[1] + axis[2] * normal[2]);
            assert!((value(&diffuse, normal) - value(&other, here)).abs() < 1e-6);
        }
    }
}
