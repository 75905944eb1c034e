use serde::Deserialize;

/// The ball's colour, as far as it is told beforehand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum BallColour {
    /// An orange ball.
    Orange,
    /// A white ball.
    White,
    /// Not told: both are tried.
    #[default]
    Auto,
}

impl std::str::FromStr for BallColour {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "orange" => Ok(Self::Orange),
            "white" => Ok(Self::White),
            "auto" => Ok(Self::Auto),
            other => Err(format!("ball colour {other:?} is not known; valid are orange, white and auto")),
        }
    }
}

/// The ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Diameter in metres; 0.040 by the rules.
    pub diameter_m: f64,
    /// Colour.
    pub colour: BallColour,
}

impl Default for Ball {
    fn default() -> Self {
        Self { diameter_m: 0.040, colour: BallColour::Auto }
    }
}

impl Ball {
    /// Radius in metres.
    pub fn radius_m(&self) -> f64 {
        0.5 * self.diameter_m
    }
}
