use std::str::FromStr;

use super::{Paint, Rgb};
use crate::synthetic::{flight::RallyStyle, render::SensorNoise};

/// How hard a scene is to read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// Bright and steady light, an amateur's rally, nothing that moves but the ball.
    Clean,
    /// A match in an ordinary hall: players, balls that lie about, mains flicker.
    #[default]
    Normal,
    /// Dim light that changes, a white ball among white things, 30 m/s, 6 ms of exposure.
    Hard,
}

impl Preset {
    /// All, the easiest first.
    pub const ALL: [Self; 3] = [Self::Clean, Self::Normal, Self::Hard];

    /// The name that options and reports use.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Normal => "normal",
            Self::Hard => "hard",
        }
    }
}

impl FromStr for Preset {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|preset| preset.name() == name)
            .ok_or_else(|| format!("scene {name:?} is not known; valid are clean, normal and hard"))
    }
}

/// What a preset means.
#[derive(Debug, Clone, Copy)]
pub struct Difficulty {
    /// Green grey value of a white wall in full light, DN.
    pub white_dn: f64,
    /// The sensor's noise.
    pub noise: SensorNoise,
    /// Balls that are not in play.
    pub decoys: usize,
    /// Players.
    pub players: usize,
    /// Share of shirts and things in the ball's colour.
    pub alike: f64,
    /// Things that stand about.
    pub clutter: usize,
    /// Half the swing of the lamps.
    pub flicker: f64,
    /// Loss of light at the darkest.
    pub dimming: f64,
    /// The exposure where nothing else is asked for, ns; `None`: the rig's.
    pub exposure_ns: Option<u64>,
    /// How the rally is played.
    pub style: RallyStyle,
}

impl Preset {
    /// What the preset means.
    pub const fn difficulty(self) -> Difficulty {
        let style = RallyStyle {
            speed_m_s: 5.5,
            fastest_m_s: 14.0,
            spin_rad_s: 60.0,
            strongest_rad_s: 360.0,
            misses: 0.08,
            pause_s: (0.4, 1.0),
        };
        match self {
            Self::Clean => Difficulty {
                white_dn: 205.0,
                noise: SensorNoise { dn_per_electron: 0.012, read_dn: 0.3 },
                decoys: 0,
                players: 0,
                alike: 0.0,
                clutter: 8,
                flicker: 0.0,
                dimming: 0.0,
                exposure_ns: None,
                style,
            },
            Self::Normal => Difficulty {
                white_dn: 185.0,
                noise: SensorNoise { dn_per_electron: 0.03, read_dn: 0.4 },
                decoys: 3,
                players: 2,
                alike: 0.4,
                clutter: 20,
                flicker: 0.03,
                dimming: 0.05,
                exposure_ns: None,
                style: RallyStyle {
                    speed_m_s: 8.0,
                    fastest_m_s: 25.0,
                    spin_rad_s: 200.0,
                    strongest_rad_s: 800.0,
                    ..style
                },
            },
            Self::Hard => Difficulty {
                white_dn: 80.0,
                noise: SensorNoise { dn_per_electron: 0.10, read_dn: 0.9 },
                decoys: 7,
                players: 2,
                alike: 0.9,
                clutter: 30,
                flicker: 0.10,
                dimming: 0.30,
                exposure_ns: Some(6_000_000),
                style: RallyStyle {
                    speed_m_s: 10.0,
                    fastest_m_s: 30.0,
                    spin_rad_s: 265.0,
                    strongest_rad_s: 800.0,
                    ..style
                },
            },
        }
    }
}

/// An orange ball.
pub const ORANGE: Paint = Paint { gloss: 0.08, ..Paint::plain([0.92, 0.40, 0.07]) };
/// A white ball.
pub const WHITE: Paint = Paint { gloss: 0.08, ..Paint::plain([0.86, 0.86, 0.82]) };

/// Colours that tables have.
pub const TABLES: [Rgb; 4] = [[0.03, 0.11, 0.34], [0.03, 0.20, 0.11], [0.05, 0.07, 0.13], [0.02, 0.22, 0.40]];
/// Colours that floors have.
pub const FLOORS: [Rgb; 5] =
    [[0.42, 0.28, 0.16], [0.45, 0.10, 0.09], [0.09, 0.18, 0.36], [0.30, 0.30, 0.31], [0.16, 0.24, 0.15]];
/// Colours that walls have.
pub const WALLS: [Rgb; 4] = [[0.55, 0.56, 0.55], [0.80, 0.79, 0.74], [0.30, 0.33, 0.38], [0.62, 0.52, 0.40]];
