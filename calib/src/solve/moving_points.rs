//! Points in motion, as one camera saw them.

use nalgebra::Vector2;
use netcord_common::camera::CameraModel;

/// Markers nearer than this to the picture's edge, px, are left out: they are ten pixels and more across.
const CUT_PX: f64 = 8.0;

/// One camera's sightings: its intrinsics, and the pixel of each point where it saw it. The place in the
/// list is the point: one marker at one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct MovingPoints {
    /// The camera's name.
    pub name: String,
    /// Its intrinsics.
    pub model: CameraModel,
    /// Raw pixels.
    pub pixels: Vec<Option<Vector2<f64>>>,
    /// How fast each moves in the picture, px/s, where that is known: it shows a clock that is off. May be empty.
    pub velocities: Vec<Option<Vector2<f64>>>,
}

impl MovingPoints {
    /// Without the points that the picture's edge may cut: the middle of what is left of a blob is not its centre.
    pub(super) fn whole(&self) -> Self {
        let (w, h) = (f64::from(self.model.width), f64::from(self.model.height));
        let inside = |p: &Vector2<f64>| {
            (CUT_PX..w - CUT_PX).contains(&(p.x + 0.5)) && (CUT_PX..h - CUT_PX).contains(&(p.y + 0.5))
        };
        Self { pixels: self.pixels.iter().map(|p| p.filter(inside)).collect(), ..self.clone() }
    }

    /// As the points were `later_s` before the camera saw them: at the instants of its stamps, where its frames are
    /// exposed so much later than stamped. Points of which no velocity is known are left out then.
    #[must_use]
    pub fn on_time(mut self, later_s: f64) -> Self {
        if later_s != 0.0 {
            let velocities = self.velocities.iter().copied().chain(std::iter::repeat(None));
            for (pixel, velocity) in self.pixels.iter_mut().zip(velocities) {
                *pixel = pixel.zip(velocity).map(|(p, v)| p - v * later_s);
            }
        }
        self
    }

    /// With velocities from the instants before and after, s; at each there are `markers` points. Beside a gap
    /// none is known.
    #[must_use]
    pub fn with_velocities(mut self, markers: usize, times_s: &[f64]) -> Self {
        let mut steps: Vec<f64> = times_s.windows(2).map(|t| t[1] - t[0]).collect();
        steps.sort_by(f64::total_cmp);
        let longest = 2.5 * steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        let seen =
            |instant: usize, marker: usize| self.pixels.get(instant * markers + marker).copied().flatten();
        let velocity = |instant: usize, marker: usize| -> Option<Vector2<f64>> {
            seen(instant, marker)?;
            let (before, after) = (instant.checked_sub(1)?, instant + 1);
            let apart = times_s.get(after)? - times_s[before];
            (apart > 0.0 && apart <= longest).then_some(())?;
            Some((seen(after, marker)? - seen(before, marker)?) / apart)
        };
        let places = (0..times_s.len()).flat_map(|i| (0..markers).map(move |m| (i, m)));
        self.velocities = places.map(|(i, m)| velocity(i, m)).collect();
        self
    }
}
