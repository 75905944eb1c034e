//! Points in motion that contradict the rest: markers that are half hidden, or something else.

use nalgebra::Vector2;

use super::motion::median;

/// A point that contradicts the rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Stray {
    /// Its place in the camera's list.
    pub place: usize,
    /// How far it is from where the rest puts it, px.
    pub off_px: f64,
    /// Whether it belongs to a run of instants, each with a stray of this camera, that ends where the camera does not
    /// see all markers: something comes before them, and of what is left of a marker the middle is elsewhere.
    pub half_hidden: bool,
}

/// Robust standard deviations from which a point is a stray, as in calibration by boards.
const STRAY_SIGMAS: f64 = 5.0;

/// Per camera its strays, by their places. `residuals` are lengths, px, of what is in `pixels`.
pub(super) fn name_strays(
    pixels: &[&[Option<Vector2<f64>>]],
    residuals: &[Vec<Option<f64>>],
    markers: usize,
) -> Vec<Vec<Stray>> {
    let of_camera = |(pixels, residuals): (&&[Option<Vector2<f64>>], &Vec<Option<f64>>)| {
        // The median length of a normal residual in two directions is √(2 ln 2) of its standard deviation.
        let all: Vec<f64> = residuals.iter().flatten().copied().collect();
        let limit = STRAY_SIGMAS * median(&all) / (2.0 * 2f64.ln()).sqrt();
        let far = |place: usize| residuals[place].filter(|r| *r >= limit);
        let instants = pixels.len() / markers;
        let at = |instant: usize| instant * markers..(instant + 1) * markers;
        let is_gap = |instant: usize| at(instant).any(|place| pixels[place].is_none());
        let has_stray = |instant: usize| at(instant).any(|place| far(place).is_some());
        // Whichever comes first, a gap or an instant at which all is well.
        let run_ends = |instant: &usize| is_gap(*instant) || !has_stray(*instant);
        (0..instants * markers)
            .filter_map(|place| {
                let instant = place / markers;
                let half_hidden = || {
                    let after = (instant + 1..instants).find(run_ends);
                    let before = (0..instant).rev().find(run_ends);
                    is_gap(instant) || after.is_some_and(is_gap) || before.is_some_and(is_gap)
                };
                let off_px = far(place)?;
                Some(Stray { place, off_px, half_hidden: half_hidden() })
            })
            .collect()
    };
    pixels.iter().zip(residuals).map(of_camera).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strays_are_named_and_those_beside_a_gap_are_half_hidden() {
        let seen = Some(Vector2::zeros());
        // Two markers at twelve instants; the camera loses them at the fifth.
        let mut pixels = vec![seen; 24];
        let mut residuals = vec![Some(0.1); 24];
        for place in [8, 9] {
            (pixels[place], residuals[place]) = (None, None);
        }
        // Instants 2 and 3 run into the gap, 7 does not, 10 neither.
        for place in [4, 7, 15, 20] {
            residuals[place] = Some(3.0);
        }
        let found = name_strays(&[&pixels], &[residuals], 2);
        let named: Vec<(usize, bool)> = found[0].iter().map(|s| (s.place, s.half_hidden)).collect();
        assert_eq!(named, [(4, true), (7, true), (15, false), (20, false)]);
    }
}
