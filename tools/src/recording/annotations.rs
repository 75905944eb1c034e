use foxglove::messages::{
    CircleAnnotation, Color, ImageAnnotations, Point2, PointsAnnotation, TextAnnotation, points_annotation,
};
use netcord_capture::recording::timestamp;
use netcord_common::wire::{Detections, SearchWindow};

use super::colours;

/// Foxglove's pixel coordinates begin at the corner of the first pixel, ours at its centre.
const CORNER: f64 = 0.5;

/// Boxes around candidates, with their centres and scores, and the search window, if there was one.
pub fn annotations(detections: &Detections, window: Option<&SearchWindow>) -> ImageAnnotations {
    let stamp = timestamp(detections.stamps.mid_exposure_ns);
    let mut out = ImageAnnotations { timestamp: stamp, ..ImageAnnotations::default() };
    for (place, item) in detections.items().iter().enumerate() {
        let colour = if place == 0 { colours::BEST } else { colours::OTHER };
        let corners = (item.x0_px, item.y0_px, item.x1_px, item.y1_px);
        out.points.push(rectangle(stamp, corners, colour, 2.0));
        out.circles.push(CircleAnnotation {
            timestamp: stamp,
            position: Some(Point2 { x: item.u_px + CORNER, y: item.v_px + CORNER }),
            diameter: 3.0,
            thickness: 1.0,
            fill_color: Some(colour),
            outline_color: Some(colour),
            ..CircleAnnotation::default()
        });
        out.texts.push(TextAnnotation {
            timestamp: stamp,
            position: Some(Point2 { x: item.x1_px + 4.0 + CORNER, y: item.y0_px + CORNER }),
            text: format!("{:.2}", item.score),
            font_size: 14.0,
            text_color: Some(colour),
            ..TextAnnotation::default()
        });
    }
    if let Some(w) = window.filter(|w| w.present != 0) {
        out.points.push(rectangle(stamp, (w.x0_px, w.y0_px, w.x1_px, w.y1_px), colours::WINDOW, 1.0));
    }
    out
}

fn rectangle(
    timestamp: Option<foxglove::messages::Timestamp>,
    (x0, y0, x1, y1): (f64, f64, f64, f64),
    colour: Color,
    thickness: f64,
) -> PointsAnnotation {
    let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)];
    PointsAnnotation {
        timestamp,
        r#type: points_annotation::Type::LineLoop.into(),
        points: corners.iter().map(|(x, y)| Point2 { x: x + CORNER, y: y + CORNER }).collect(),
        outline_color: Some(colour),
        thickness,
        ..PointsAnnotation::default()
    }
}

#[cfg(test)]
mod tests {
    use netcord_common::wire::Detection;

    use super::*;

    #[test]
    fn boxes_are_moved_by_half_a_pixel() {
        let mut detections = Detections::default();
        let edges = Detection { x0_px: 9.5, y0_px: 19.5, x1_px: 29.5, y1_px: 49.5, ..Detection::default() };
        detections.insert(Detection { u_px: 19.5, v_px: 34.5, ..edges });
        let out = annotations(&detections, None);
        // The box covers the pixels 10 … 29 and 20 … 49: in Foxglove's coordinates from 10 to 30, 20 to 50.
        let corners = out.points[0].points.iter().map(|p| (p.x, p.y)).collect::<Vec<_>>();
        assert_eq!(corners, [(10.0, 20.0), (30.0, 20.0), (30.0, 50.0), (10.0, 50.0)]);
        assert_eq!(out.circles[0].position, Some(Point2 { x: 20.0, y: 35.0 }));
    }
}
