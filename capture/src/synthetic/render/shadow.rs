use nalgebra::Vector3;

use super::{Canvas, View};
use crate::synthetic::{
    flight::{TABLE_HALF_LENGTH_M, TABLE_HALF_WIDTH_M},
    scene::{Body, Scene},
};

/// Darkens the ball's shadows on the table: one for each lamp, the softer the higher the ball.
pub fn cast_shadows(scene: &Scene, view: &mut View, ball: &Vector3<f64>, canvas: &mut Canvas, gain: f32) {
    /// Higher balls throw no shadow that could be seen.
    const HIGHEST_M: f64 = 0.5;
    /// Width of the lamps as an angle: what a shadow's rim grows by with height.
    const LAMP_RAD: f64 = 0.12;
    let on_table = |p: &Vector3<f64>| p.x.abs() < TABLE_HALF_WIDTH_M && p.y.abs() < TABLE_HALF_LENGTH_M;
    if !(0.0..HIGHEST_M).contains(&ball.z) {
        return;
    }
    let light = *scene.room.light();
    let all = light.on(&Vector3::z());
    let origin = view.camera_from_world.origin().coords;
    let radius = scene.radius_m;
    for (to, strength) in light.lamps {
        let centre = ball - to * (ball.z / to.z);
        if !on_table(&centre) {
            continue;
        }
        let soft = LAMP_RAD * ball.z;
        let reach = radius + soft;
        let dark = strength * to.z / all * (radius / reach).powi(2);
        let disc = Body::upright(centre, [reach, reach, 1e-3], scene.ball);
        let Some(outline) = view.outline(&disc, 0.5) else { continue };
        canvas.open(&outline.rect, &view.backdrop.means, gain);
        view.rays.make_known(&outline.rect);
        let (columns, rows) = outline.rect.within(view.grid.width, view.grid.height);
        for y in rows {
            for x in columns.clone() {
                let ray = view.rays.row(y)[x];
                let direction = view.to_world(&Vector3::new(f64::from(ray[0]), f64::from(ray[1]), 1.0));
                let depth = -origin.z / direction.z;
                let at = origin + direction * depth;
                // Only where the table is what the pixel sees.
                if !on_table(&at) || (view.backdrop.depth_m(x, y) - depth).abs() > 0.01 {
                    continue;
                }
                let share = ((reach - (at - centre).norm()) / (2.0 * soft + 2e-3)).clamp(0.0, 1.0);
                let kept = 1.0 - dark * share * share * (3.0 - 2.0 * share);
                *canvas.mean_mut(x, y) *= kept as f32;
            }
        }
    }
}
