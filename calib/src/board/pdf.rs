use std::fmt::Write as _;

use super::Sheet;

/// PDF's unit: 1/72 inch.
const POINTS_PER_MM: f64 = 72.0 / 25.4;

/// The sheets as a PDF of one page each, at true scale (PDF 1.4; the text in Helvetica, which every reader
/// has, so that no font is embedded). Only characters of Latin-1 are written; others become `?`.
pub fn to_pdf(sheets: &[Sheet]) -> Vec<u8> {
    // Catalogue, list of pages and font come first; of each sheet there are two objects more, the page and what is
    // on it.
    let page_number = |i: usize| 4 + 2 * i;
    let kids: Vec<String> = (0..sheets.len()).map(|i| format!("{} 0 R", page_number(i))).collect();
    let mut objects: Vec<Vec<u8>> = vec![
        b"<< /Type /Catalog /Pages 2 0 R >>".to_vec(),
        format!("<< /Type /Pages /Kids [{}] /Count {} >>", kids.join(" "), sheets.len()).into_bytes(),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>".to_vec(),
    ];
    for (i, sheet) in sheets.iter().enumerate() {
        let content = content(sheet);
        let media =
            format!("[0 0 {:.4} {:.4}]", sheet.width_mm * POINTS_PER_MM, sheet.height_mm * POINTS_PER_MM);
        let font = "<< /Font << /F1 3 0 R >> >>";
        objects.push(
            format!(
                "<< /Type /Page /Parent 2 0 R /MediaBox {media} /Contents {} 0 R /Resources {font} >>",
                page_number(i) + 1
            )
            .into_bytes(),
        );
        objects.push(
            [format!("<< /Length {} >>\nstream\n", content.len()).as_bytes(), &content, b"endstream"]
                .concat(),
        );
    }
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

/// What is on a sheet's page, in PDF's operators.
fn content(sheet: &Sheet) -> Vec<u8> {
    let height = sheet.height_mm * POINTS_PER_MM;
    let mut page = String::new();
    // Neighbours of one colour are one path: painted one by one, they would show hairlines between them.
    for run in sheet.rectangles.chunk_by(|a, b| a.white == b.white) {
        // A String never refuses to be written to.
        let _ = writeln!(page, "{} g", u8::from(run[0].white));
        for r in run {
            let (x, y) = (r.x * POINTS_PER_MM, height - (r.y + r.height) * POINTS_PER_MM);
            let (w, h) = (r.width * POINTS_PER_MM, r.height * POINTS_PER_MM);
            let _ = writeln!(page, "{x:.4} {y:.4} {w:.4} {h:.4} re");
        }
        page.push_str("f\n");
    }
    for t in &sheet.texts {
        let text = t.text.replace('\\', "\\\\").replace('(', "\\(").replace(')', "\\)");
        let (x, y) = (t.x * POINTS_PER_MM, height - t.y * POINTS_PER_MM);
        let _ = writeln!(page, "0 g BT /F1 {:.2} Tf {x:.3} {y:.3} Td ({text}) Tj ET", t.size * POINTS_PER_MM);
    }
    page.chars().map(|c| u8::try_from(u32::from(c)).unwrap_or(b'?')).collect()
}
