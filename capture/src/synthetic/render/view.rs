use std::ops::Range;

use nalgebra::{Vector2, Vector3};
use netcord_common::{
    PixelFormat,
    camera::CameraModel,
    geometry::{Camera, Transform, World},
    rig::RigCamera,
};

use super::{Backdrop, Outline, RayTable, Rect, TileGrid};
use crate::synthetic::scene::{Body, Scene};

/// A camera, and what stands still before it.
#[derive(Debug)]
pub struct View {
    pub model: CameraModel,
    pub camera_from_world: Transform<Camera, World>,
    pub rays: RayTable,
    pub backdrop: Backdrop,
    pub grid: TileGrid,
    /// Channel (0 red, 1 green, 2 blue, 3 none) at (x & 1, y & 1), as `channels[y & 1][x & 1]`.
    channels: [[usize; 2]; 2],
}

/// Pixels outside the frame that are looked at, at most.
const MOST_LOOKS: f64 = 40_000.0;

impl View {
    /// Renders the backdrop, on all cores.
    pub fn new(scene: &Scene, camera: &RigCamera) -> Self {
        Self {
            model: camera.model,
            camera_from_world: camera.camera_from_world,
            rays: RayTable::new(&camera.model),
            backdrop: Backdrop::new(scene, camera),
            grid: TileGrid { width: camera.model.width as usize, height: camera.model.height as usize },
            channels: channels(camera.pixel_format),
        }
    }

    /// How it sees a body.
    pub fn outline(&self, body: &Body, blur_px: f64) -> Option<Outline> {
        Outline::new(&self.model, &self.camera_from_world, body, blur_px)
    }

    /// How it sees a body of which only what is inside the frame matters.
    pub fn outline_inside(&self, body: &Body, blur_px: f64) -> Option<Outline> {
        let mut outline = self.outline(body, blur_px)?;
        outline.enclose(&self.model, &self.camera_from_world, body);
        Some(outline)
    }

    /// A direction of the camera's frame, in the world.
    pub fn to_world(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.camera_from_world.rotation.inverse_transform_vector(v)
    }

    /// The channel of a pixel, as an index into colours (red, green, blue, luma).
    pub fn channel(&self, x: usize, y: usize) -> usize {
        self.channels[y & 1][x & 1]
    }

    /// Whether any pixel of `rect` lies in the frame.
    pub fn contains_some_of(&self, rect: &Rect) -> bool {
        let (columns, rows) = rect.within(self.grid.width, self.grid.height);
        !columns.is_empty() && !rows.is_empty()
    }

    /// The net before a point at this depth: its opacity, and its light in full light, DN.
    pub fn net(&self, scene: &Scene, ray: [f32; 2], depth_m: f64, channel: usize) -> Option<(f32, f32)> {
        let direction = self.to_world(&Vector3::new(f64::from(ray[0]), f64::from(ray[1]), 1.0));
        let origin = self.camera_from_world.origin().coords;
        let net = scene.room.net(&origin, &direction).filter(|net| net.distance < depth_m)?;
        Some((net.opacity, scene.level(&net.radiance, channel)))
    }

    /// Whether the net may be in pixels of `rect`.
    pub fn may_be_netted(&self, rect: &Rect) -> bool {
        self.backdrop
            .net
            .is_some_and(|net| net.x0 < rect.x1 && rect.x0 < net.x1 && net.y0 < rect.y1 && rect.y0 < net.y1)
    }

    /// Area of the part of a body's image that lies outside the frame, px.
    pub fn area_outside(&self, outlines: &[Outline]) -> f64 {
        let mut area = 0.0;
        for outline in outlines {
            let (columns, rows) = outline.rect.within(self.grid.width, self.grid.height);
            let Rect { x0, y0, x1, y1 } = outline.rect;
            if columns.len() as i64 == x1 - x0 && rows.len() as i64 == y1 - y0 {
                continue;
            }
            // Where a lens bends most, a ball's rectangle may be wider than any frame: then every so many pixels.
            let step = ((((x1 - x0) as f64 * (y1 - y0) as f64) * outlines.len() as f64 / MOST_LOOKS)
                .sqrt()
                .ceil() as i64)
                .max(1);
            let places = |from: i64, to: i64| (from..to).step_by(step as usize);
            for (x, y) in places(y0, y1).flat_map(|y| places(x0, x1).map(move |x| (x, y))) {
                let in_range =
                    |v: i64, range: &Range<usize>| usize::try_from(v).is_ok_and(|v| range.contains(&v));
                if in_range(x, &columns) && in_range(y, &rows) {
                    continue;
                }
                if let Some(n) = self.model.undistort(&Vector2::new(x as f64, y as f64)) {
                    let covered = outline.covered([n.x as f32, n.y as f32]).unwrap_or(0.0);
                    area += covered * (step * step) as f64;
                }
            }
        }
        area / outlines.len().max(1) as f64
    }
}

/// Channel of each place in the 2 × 2 cell, as an index into (red, green, blue, luma).
pub fn channels(format: PixelFormat) -> [[usize; 2]; 2] {
    use netcord_common::Channel;
    let at = |x, y| match format.channel_at(x, y) {
        Channel::Red => 0,
        Channel::Green => 1,
        Channel::Blue => 2,
        Channel::Luma => 3,
    };
    [[at(0, 0), at(1, 0)], [at(0, 1), at(1, 1)]]
}
