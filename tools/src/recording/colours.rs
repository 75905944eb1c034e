//! The colours of viewers, annotations and scenes, so that one thing looks the same everywhere.

use foxglove::messages::Color;

pub const BALL: Color = Color { r: 1.0, g: 0.55, b: 0.1, a: 1.0 };
pub const TRAIL: Color = Color { r: 1.0, g: 0.75, b: 0.4, a: 0.8 };
pub const PATH: Color = Color { r: 0.2, g: 0.75, b: 1.0, a: 1.0 };
pub const LANDING: Color = Color { r: 1.0, g: 0.2, b: 0.4, a: 0.9 };
pub const BEST: Color = Color { r: 0.1, g: 1.0, b: 0.3, a: 1.0 };
pub const OTHER: Color = Color { r: 1.0, g: 0.9, b: 0.2, a: 0.8 };
pub const WINDOW: Color = Color { r: 0.3, g: 0.6, b: 1.0, a: 0.9 };
pub const TABLE: Color = Color { r: 0.05, g: 0.25, b: 0.45, a: 1.0 };
pub const LINES: Color = Color { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };
pub const NET: Color = Color { r: 0.9, g: 0.9, b: 0.9, a: 0.5 };
