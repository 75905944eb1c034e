use nalgebra::Vector2;

use super::CalibrationBoard;

/// A filled rectangle, in mm from the sheet's top-left corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Left.
    pub x: f64,
    /// Top.
    pub y: f64,
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
    /// Whether it is white.
    pub white: bool,
}

/// A line of text, in mm.
#[derive(Debug, Clone, PartialEq)]
pub struct Text {
    /// Left end of the base line.
    pub x: f64,
    /// Height of the base line.
    pub y: f64,
    /// Size of the font.
    pub size: f64,
    /// The text.
    pub text: String,
}

/// A page with a board on it at true scale, a ruler to check the print by, and the command that made
/// it. Rectangles are painted in order; the ground is white.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// Width in mm.
    pub width_mm: f64,
    /// Height in mm.
    pub height_mm: f64,
    /// What to paint.
    pub rectangles: Vec<Rectangle>,
    /// What to write.
    pub texts: Vec<Text>,
}

/// White, or black when inverted, around the pattern: detection needs a quiet zone.
const MARGIN_MM: f64 = 10.0;
/// Room below the board for ruler and text.
const FOOT_MM: f64 = 22.0;

impl Sheet {
    /// The page for `board`, made by `command`.
    pub fn new(board: &CalibrationBoard, command: &str) -> Self {
        let (low, high) = board.extent();
        let size = (high - low) * 1e3;
        let place = |p: &Vector2<f64>| (p - low) * 1e3 + Vector2::repeat(MARGIN_MM);
        let (width_mm, height_mm) = (size.x + 2.0 * MARGIN_MM, size.y + 2.0 * MARGIN_MM + FOOT_MM);
        let mut rectangles = vec![Rectangle {
            x: 0.0,
            y: 0.0,
            width: width_mm,
            height: size.y + 2.0 * MARGIN_MM,
            white: !board.inverted,
        }];
        rectangles.extend(board.black().iter().map(|(a, b)| {
            let (a, b) = (place(a), place(b));
            Rectangle { x: a.x, y: a.y, width: b.x - a.x, height: b.y - a.y, white: board.inverted }
        }));
        let mut sheet = Self { width_mm, height_mm, rectangles, texts: Vec::new() };
        sheet.ruler(size.y + 2.0 * MARGIN_MM + 4.0);
        let line = |y: f64, text: String| Text { x: MARGIN_MM, y, size: 2.6, text };
        sheet.texts.push(line(height_mm - 5.5, command.to_owned()));
        sheet.texts.push(line(height_mm - 2.0, format!("{board} · print at 100 %, then measure the ruler")));
        sheet
    }

    /// Ticks each millimetre from `top` downwards, as long as whole centimetres fit.
    fn ruler(&mut self, top: f64) {
        /// Width of a tick's line.
        const LINE_MM: f64 = 0.15;
        let length = ((self.width_mm - 2.0 * MARGIN_MM) / 10.0).floor().max(1.0) as u32 * 10;
        for tick in 0..=length {
            let height = if tick % 10 == 0 {
                5.0
            } else if tick % 5 == 0 {
                3.5
            } else {
                2.0
            };
            let x = MARGIN_MM + f64::from(tick) - LINE_MM / 2.0;
            self.rectangles.push(Rectangle { x, y: top, width: LINE_MM, height, white: false });
        }
        self.rectangles.push(Rectangle {
            x: MARGIN_MM,
            y: top - LINE_MM,
            width: f64::from(length),
            height: LINE_MM,
            white: false,
        });
        let label = |x: f64, text: String| Text { x, y: top + 8.0, size: 2.6, text };
        self.texts.push(label(MARGIN_MM, "0".to_owned()));
        self.texts.push(label(MARGIN_MM + f64::from(length) - 6.0, format!("{length} mm")));
    }
}
