use nalgebra::Vector3;

use super::{Layer, Outline, Seen, View};
use crate::synthetic::scene::{Paint, Scene, Texture};

/// Works out what bodies add to the picture pixel by pixel in double precision, in the plainest way: what
/// [`super::Painter`] is held against.
pub struct ExactPainter<'a> {
    pub scene: &'a Scene,
    pub view: &'a mut View,
}

impl ExactPainter<'_> {
    /// Gathers what a body that was at `outlines`, each for an equal share of the exposure, gives to the
    /// picture. Returns the area of its image inside the frame, hidden parts too, in px.
    pub fn lay(&mut self, outlines: &[Outline], paint: &Paint, layer: &mut Layer) -> f64 {
        let Some(hull) = outlines.iter().map(|o| o.rect).reduce(|a, b| a.hull(&b)) else { return 0.0 };
        let (width, height) = (self.view.grid.width, self.view.grid.height);
        layer.reset(hull.within(width, height));
        let share = 1.0 / outlines.len() as f64;
        let mut whole = 0.0;
        for outline in outlines {
            self.view.rays.make_known(&outline.rect);
            whole += share * self.add(outline, paint, share as f32, layer);
        }
        whole
    }

    /// Adds one outline to the layer; returns its area inside the frame.
    fn add(&self, outline: &Outline, paint: &Paint, share: f32, layer: &mut Layer) -> f64 {
        let (columns, rows) = outline.rect.within(self.view.grid.width, self.view.grid.height);
        let by_net = self.view.may_be_netted(&outline.rect);
        let mut area = 0.0;
        for y in rows {
            let rays = self.view.rays.row(y);
            let row = layer.row_mut(y);
            let mut span = 0..0;
            for x in columns.clone() {
                let Some(seen) = outline.seen(rays[x]) else {
                    // An ellipsoid's image is convex: behind its far rim nothing follows.
                    if !span.is_empty() {
                        break;
                    }
                    continue;
                };
                span = if span.is_empty() { x..x + 1 } else { span.start..x + 1 };
                area += seen.coverage;
                if self.view.backdrop.hides(x, y, seen.depth_m) {
                    continue;
                }
                let channel = self.view.channel(x, y);
                let mut light = self.light(&seen, rays[x], paint, channel);
                let mut clear = 1.0;
                if by_net
                    && let Some((opacity, of_net)) = self.view.net(self.scene, rays[x], seen.depth_m, channel)
                {
                    light += opacity * (of_net - light);
                    clear = 1.0 - opacity;
                }
                let coverage = seen.coverage as f32 * share;
                let i = x - row.x0;
                row.coverage[i] += coverage;
                row.light[i] += coverage * light;
                row.shown[i] += coverage * clear;
            }
            if !span.is_empty() {
                layer.widen(y, span);
            }
        }
        area
    }

    /// What a point of a body sends to a pixel of this channel in full light, DN.
    fn light(&self, seen: &Seen, ray: [f32; 2], paint: &Paint, channel: usize) -> f32 {
        let light = self.scene.room.light();
        let normal = seen.normal;
        let irradiance = light.on(&normal) as f32;
        let colour = match paint.texture {
            Texture::Plain => paint.colour,
            _ => paint.at(seen.on_body.x as f32, seen.on_body.z as f32),
        };
        let mut radiance = colour.map(|c| c * irradiance);
        if paint.gloss > 0.0 {
            let view = -Vector3::new(f64::from(ray[0]), f64::from(ray[1]), 1.0);
            let view = self.view.to_world(&view).normalize();
            let shine: f64 = light
                .lamps
                .iter()
                .map(|(to, strength)| strength * (to + view).normalize().dot(&normal).max(0.0).powi(32))
                .sum();
            radiance = radiance.map(|r| r + paint.gloss * shine as f32);
        }
        self.scene.level(&radiance, channel)
    }
}
