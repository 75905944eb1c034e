use super::MarkError;
use crate::segment::size::{BallSize, LEAST_DIAMETER_PX};

/// Boxes may be this much larger than the largest ball, with its blur, px.
const LARGEST_BOX_PX: f64 = 400.0;

/// A ball that is marked in a frame, raw px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mark {
    /// Its outline: all inside is the ball.
    Outline {
        /// Centre at mid-exposure.
        centre: [f64; 2],
        /// Diameter.
        diameter: f64,
        /// Path of the centre during the exposure; zero of a ball at rest.
        path: [f64; 2],
    },
    /// A box with one ball in it and some of what is around: the ball is told from that.
    Box {
        /// Left and top edge.
        low: [f64; 2],
        /// Right and bottom edge.
        high: [f64; 2],
    },
}

impl Mark {
    /// Its middle.
    #[must_use]
    pub fn centre(&self) -> [f64; 2] {
        match self {
            Self::Outline { centre, .. } => *centre,
            Self::Box { low, high } => [0, 1].map(|i| 0.5 * (low[i] + high[i])),
        }
    }

    /// The box around it: left and top, right and bottom edge.
    #[must_use]
    pub fn extent(&self) -> ([f64; 2], [f64; 2]) {
        match self {
            Self::Outline { centre, diameter, path } => {
                let reach = |i: usize| 0.5 * (diameter + path[i].abs());
                ([0, 1].map(|i| centre[i] - reach(i)), [0, 1].map(|i| centre[i] + reach(i)))
            }
            Self::Box { low, high } => (*low, *high),
        }
    }

    /// Whether it can be a ball's in an image of so many columns and rows.
    ///
    /// # Errors
    /// [`MarkError::Outside`], [`MarkError::Size`].
    pub fn check(&self, (width, height): (usize, usize)) -> Result<(), MarkError> {
        let [u, v] = self.centre();
        if !((-0.5..=width as f64 - 0.5).contains(&u) && (-0.5..=height as f64 - 0.5).contains(&v)) {
            return Err(MarkError::Outside { u, v, width, height });
        }
        let least = f64::from(LEAST_DIAMETER_PX);
        let (across, most) = match self {
            Self::Outline { diameter, .. } => (*diameter, 2.0 * f64::from(BallSize::default().most_px)),
            Self::Box { low, high } => ((high[0] - low[0]).min(high[1] - low[1]), LARGEST_BOX_PX),
        };
        if !(least..=most).contains(&across) {
            return Err(MarkError::Size { u, v, across, least, most });
        }
        Ok(())
    }
}
