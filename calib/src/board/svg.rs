use std::fmt::Write as _;

use super::Sheet;

/// The sheet as SVG; one user unit is one millimetre.
pub fn to_svg(sheet: &Sheet) -> String {
    let (w, h) = (sheet.width_mm, sheet.height_mm);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\">\n\
         <rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>\n"
    );
    for r in &sheet.rectangles {
        let fill = if r.white { "white" } else { "black" };
        // A String never refuses to be written to.
        let _ = writeln!(
            svg,
            "<rect x=\"{:.4}\" y=\"{:.4}\" width=\"{:.4}\" height=\"{:.4}\" fill=\"{fill}\"/>",
            r.x, r.y, r.width, r.height
        );
    }
    for t in &sheet.texts {
        let text = t.text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        let _ = writeln!(
            svg,
            "<text x=\"{:.3}\" y=\"{:.3}\" font-size=\"{}\" font-family=\"sans-serif\">{text}</text>",
            t.x, t.y, t.size
        );
    }
    svg.push_str("</svg>\n");
    svg
}
