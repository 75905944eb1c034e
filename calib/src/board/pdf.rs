use std::fmt::Write as _;

use super::Sheet;

/// PDF's unit: 1/72 inch.
const POINTS_PER_MM: f64 = 72.0 / 25.4;

/// The sheet as a PDF of one page at true scale (PDF 1.4; the text in Helvetica, which every reader
/// has, so that no font is embedded). Only characters of Latin-1 are written; others become `?`.
pub fn to_pdf(sheet: &Sheet) -> Vec<u8> {
    let height = sheet.height_mm * POINTS_PER_MM;
    let mut page = String::new();
    // A String never refuses to be written to.
    for r in &sheet.rectangles {
        let (x, y) = (r.x * POINTS_PER_MM, height - (r.y + r.height) * POINTS_PER_MM);
        let (w, h) = (r.width * POINTS_PER_MM, r.height * POINTS_PER_MM);
        let _ = writeln!(page, "{} g {x:.4} {y:.4} {w:.4} {h:.4} re f", u8::from(r.white));
    }
    for t in &sheet.texts {
        let text = t.text.replace('\\', "\\\\").replace('(', "\\(").replace(')', "\\)");
        let (x, y) = (t.x * POINTS_PER_MM, height - t.y * POINTS_PER_MM);
        let _ = writeln!(page, "0 g BT /F1 {:.2} Tf {x:.3} {y:.3} Td ({text}) Tj ET", t.size * POINTS_PER_MM);
    }
    let page: Vec<u8> = page.chars().map(|c| u8::try_from(u32::from(c)).unwrap_or(b'?')).collect();

    let media = format!("[0 0 {:.4} {height:.4}]", sheet.width_mm * POINTS_PER_MM);
    let objects: [Vec<u8>; 5] = [
        b"<< /Type /Catalog /Pages 2 0 R >>".to_vec(),
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_vec(),
        format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox {media} /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>"
        )
        .into_bytes(),
        [format!("<< /Length {} >>\nstream\n", page.len()).as_bytes(), &page, b"endstream"].concat(),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>".to_vec(),
    ];
    let mut pdf = b"%PDF-1.4\n".to_vec();
    let mut places = Vec::new();
    for (i, object) in objects.iter().enumerate() {
        places.push(pdf.len());
        pdf.extend(format!("{} 0 obj\n", i + 1).bytes());
        pdf.extend(object);
        pdf.extend(b"\nendobj\n");
    }
    let xref = pdf.len();
    pdf.extend(format!("xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1).bytes());
    for place in places {
        pdf.extend(format!("{place:010} 00000 n \n").bytes());
    }
    pdf.extend(
        format!("trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{xref}\n%%EOF\n", objects.len() + 1).bytes(),
    );
    pdf
}
