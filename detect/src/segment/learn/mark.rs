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
}
