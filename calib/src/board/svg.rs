use std::fmt::Write as _;

use super::Sheet;

/// The sheet as SVG; one user unit is one millimetre.
pub fn to_svg(sheet: &Sheet) -> String {
    let (w, h) = (sheet.width_mm, sheet.height_mm);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\">\n\
         <rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>\n"
    );
    // Neighbours of one colour are one path: painted one by one, they would show hairlines between them.
    for run in sheet.rectangles.chunk_by(|a, b| a.white == b.white) {
        svg.push_str("<path d=\"");
        for r in run {
            // A String never refuses to be written to.
            let _ = write!(svg, "M{:.4} {:.4}h{:.4}v{:.4}h-{2:.4}z", r.x, r.y, r.width, r.height);
        }
        let _ = writeln!(svg, "\" fill=\"{}\"/>", if run[0].white { "white" } else { "black" });
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
