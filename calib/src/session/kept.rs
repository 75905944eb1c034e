use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::solve::View;

/// A camera's view in a shot that was kept.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptView {
    /// Corners.
    pub view: View,
    /// The picture's size, px.
    pub size: (u32, u32),
    /// Outline of the corners, px.
    pub outline: Vec<Vector2<f64>>,
}

/// A shot of which something was kept.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptShot {
    /// Its name.
    pub name: String,
    /// Per camera.
    pub views: Vec<Option<KeptView>>,
}

/// A mark of the table that somebody pointed at in a camera's picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// The camera's name.
    pub camera: String,
    /// The mark's, as [`crate::table::mark`] takes it.
    pub mark: String,
    /// Its raw pixel.
    pub at: [f64; 2],
}
