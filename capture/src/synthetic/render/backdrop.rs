use nalgebra::{Matrix3, Vector2, Vector3};
use netcord_common::{
    geometry::{Point, World},
    rig::RigCamera,
};
use rayon::prelude::*;

use super::{Rect, TILE, channels};
use crate::synthetic::{
    flight::{NET_HALF_WIDTH_M, NET_HEIGHT_M},
    scene::{Face, Rgb, Scene},
};

/// What one camera sees of all that stands still: mean levels in full light, and depths.
#[derive(Debug)]
pub struct Backdrop {
    /// Mean level of each pixel of the mosaic in full light, DN.
    pub means: Vec<u8>,
    /// Depth (camera z) of each pixel, in [`DEPTH_UNIT_M`].
    pub depths: Vec<u16>,
    /// Pixels in which the net may be.
    pub net: Option<Rect>,
    width: usize,
}

/// A ball on the table touches it: what is less behind than this is not behind.
pub const SLACK_M: f64 = 0.004;

/// 16 metres fit.
pub const DEPTH_UNIT_M: f64 = 0.25e-3;

/// Spacing of the places whose rays are computed; those between are interpolated, which is off by
/// 0.01 px at the corners: still scenery needs no more.
const GRID: usize = 8;

/// Side of the squares in which one face is taken to be seen everywhere when it is seen at their corners, px: what is
/// lost of a thing's corner is three pixels at most.
const CELL: usize = 4;

impl Backdrop {
    /// Renders the scene's room for `camera`.
    pub fn new(scene: &Scene, camera: &RigCamera) -> Self {
        let (width, height) = (camera.model.width as usize, camera.model.height as usize);
        let shot = Shot::new(scene, camera);
        let mut means = vec![0; width * height];
        let mut depths = vec![0; width * height];
        means
            .par_chunks_mut(width * TILE)
            .zip(depths.par_chunks_mut(width * TILE))
            .enumerate()
            .for_each(|(band, (means, depths))| shot.band(band * TILE, means, depths));
        Self { means, depths, net: net_rect(camera), width }
    }

    /// Whether something that stands still hides what lies at this depth in this pixel.
    pub fn hides(&self, x: usize, y: usize, depth_m: f64) -> bool {
        depth_m > f64::from(self.depths[y * self.width + x]) * DEPTH_UNIT_M + SLACK_M
    }

    /// Depth of the still scenery, m.
    pub fn depth_m(&self, x: usize, y: usize) -> f64 {
        f64::from(self.depths[y * self.width + x]) * DEPTH_UNIT_M
    }
}

/// One camera's view, ready to be rendered.
struct Shot<'a> {
    scene: &'a Scene,
    camera: &'a RigCamera,
    world_from_camera: Matrix3<f64>,
    origin: Vector3<f64>,
    /// Normalised coordinates every [`GRID`] pixels; not a number where the lens has none.
    grid: Vec<Vector2<f64>>,
    columns: usize,
    channels: [[usize; 2]; 2],
    /// For each block of the room the pixels it may touch; `None` where that is not known.
    extents: Vec<Option<Rect>>,
}

impl<'a> Shot<'a> {
    fn new(scene: &'a Scene, camera: &'a RigCamera) -> Self {
        let model = &camera.model;
        let (width, height) = (model.width as usize, model.height as usize);
        let (columns, rows) = (width.div_ceil(GRID) + 1, height.div_ceil(GRID) + 1);
        let none = Vector2::repeat(f64::NAN);
        let grid = (0..rows * columns)
            .into_par_iter()
            .map(|i| {
                let pixel = Vector2::new((i % columns * GRID) as f64, (i / columns * GRID) as f64);
                model.undistort(&pixel).unwrap_or(none)
            })
            .collect();
        let world_from_camera = camera.camera_from_world.rotation.matrix().transpose();
        let corners = |low: &Vector3<f64>, high: &Vector3<f64>| {
            let (low, high) = (*low, *high);
            (0..8_usize).map(move |i| {
                let pick = |bit: usize, axis: usize| if i >> bit & 1 == 0 { low[axis] } else { high[axis] };
                Vector3::new(pick(0, 0), pick(1, 1), pick(2, 2))
            })
        };
        let blocks = scene.room.blocks();
        let extents = blocks.iter().map(|b| extent(camera, corners(&b.low, &b.high))).collect();
        Self {
            scene,
            camera,
            world_from_camera,
            origin: camera.camera_from_world.origin().coords,
            grid,
            columns,
            channels: channels(camera.pixel_format),
            extents,
        }
    }

    /// The direction of the ray of a place in the image, in the world, with a camera z of one.
    fn direction(&self, x: f64, y: f64) -> Option<Vector3<f64>> {
        let (gx, gy) = (x.max(0.0) / GRID as f64, y.max(0.0) / GRID as f64);
        let (i, j) = (gx as usize, gy as usize);
        let (fx, fy) = (gx - i as f64, gy - j as f64);
        let at = |i: usize, j: usize| self.grid[(j * self.columns + i).min(self.grid.len() - 1)];
        let top = at(i, j).lerp(&at(i + 1, j), fx);
        let bottom = at(i, j + 1).lerp(&at(i + 1, j + 1), fx);
        let n = top.lerp(&bottom, fy);
        n.x.is_finite().then(|| self.world_from_camera * Vector3::new(n.x, n.y, 1.0))
    }

    /// The face that is seen at a place in the image; `None` where the lens has no inverse.
    fn face(&self, x: f64, y: f64, among: &[u16]) -> Option<Face> {
        let direction = self.direction(x, y)?;
        Some(self.scene.room.meet(&self.origin, &direction.map(|d| 1.0 / d), among))
    }

    /// Radiance, depth and surface at a place in the image where this face is seen.
    fn look(&self, x: f64, y: f64, face: Option<Face>) -> (Rgb, f64, u16) {
        let (Some(direction), Some(face)) = (self.direction(x, y), face) else {
            return ([0.0; 3], 0.0, u16::MAX);
        };
        let room = &self.scene.room;
        let hit = room.see(&face, &self.origin, &direction, 1.0 / self.camera.model.fx);
        let Some(net) = room.net(&self.origin, &direction).filter(|net| net.distance < hit.distance) else {
            return (hit.radiance, hit.distance, face.surface());
        };
        let mixed =
            std::array::from_fn(|c| hit.radiance[c] + net.opacity * (net.radiance[c] - hit.radiance[c]));
        let band = u16::from(net.opacity == 1.0);
        (mixed, hit.distance, face.surface() ^ 0x8000 ^ (band << 14))
    }

    /// Renders the rows from `y0` on that `means` holds.
    fn band(&self, y0: usize, means: &mut [u8], depths: &mut [u16]) {
        let width = self.camera.model.width as usize;
        let rows = means.len() / width;
        let mut surfaces = vec![0_u16; means.len()];
        let mut among = Vec::with_capacity(self.extents.len());
        for x0 in (0..width).step_by(TILE) {
            let x1 = (x0 + TILE).min(width);
            let touches = |r: &Rect| {
                r.x0 <= x1 as i64 && r.x1 >= x0 as i64 && r.y0 <= (y0 + rows) as i64 && r.y1 >= y0 as i64
            };
            among.clear();
            among.extend(
                self.extents
                    .iter()
                    .enumerate()
                    .filter(|(_, extent)| extent.as_ref().is_none_or(touches))
                    .map(|(i, _)| i as u16),
            );
            for (y, x) in (0..rows).step_by(CELL).flat_map(|y| (x0..x1).step_by(CELL).map(move |x| (y, x))) {
                let (xs, ys) = (x..(x + CELL).min(x1), y..(y + CELL).min(rows));
                let face = |x: usize, y: usize| self.face(x as f64, (y0 + y) as f64, &among);
                let common = face(xs.start, ys.start);
                let alike = [(xs.end - 1, ys.start), (xs.start, ys.end - 1), (xs.end - 1, ys.end - 1)]
                    .iter()
                    .all(|(x, y)| face(*x, *y) == common);
                for y in ys {
                    for x in xs.clone() {
                        let face = if alike { common } else { face(x, y) };
                        let (radiance, depth, surface) = self.look(x as f64, (y0 + y) as f64, face);
                        let i = y * width + x;
                        surfaces[i] = surface;
                        depths[i] = (depth / DEPTH_UNIT_M) as u16;
                        means[i] = self.level(&radiance, x, y0 + y);
                    }
                }
            }
            // Where two surfaces meet, four rays in place of one soften the step.
            for y in 0..rows {
                for x in x0.max(1)..x1 {
                    let i = y * width + x;
                    let other = |j: usize| surfaces[j] != surfaces[i];
                    if other(i - 1) || (y > 0 && other(i - width)) {
                        let mut sum = [0.0; 3];
                        for (dx, dy) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
                            let (x, y) = (x as f64 + dx, (y0 + y) as f64 + dy);
                            let (radiance, ..) = self.look(x, y, self.face(x, y, &among));
                            sum = std::array::from_fn(|c| sum[c] + 0.25 * radiance[c]);
                        }
                        means[i] = self.level(&sum, x, y0 + y);
                    }
                }
            }
        }
    }

    fn level(&self, radiance: &Rgb, x: usize, y: usize) -> u8 {
        let level = self.scene.level(radiance, self.channels[y & 1][x & 1]);
        (level + 0.5).clamp(0.0, 255.0) as u8
    }
}

/// The pixels between the images of `corners`; `None` where one of them has no image.
fn extent(camera: &RigCamera, corners: impl Iterator<Item = Vector3<f64>>) -> Option<Rect> {
    let mut all: Option<Rect> = None;
    for corner in corners {
        let pixel = camera.model.project(&(&camera.camera_from_world * Point::<World>::from(corner)))?;
        // Straight edges bulge between their ends in a distorted image.
        let around = Rect::around((pixel.x, pixel.y), (24.0, 24.0));
        all = Some(all.map_or(around, |a| a.hull(&around)));
    }
    all
}

fn net_rect(camera: &RigCamera) -> Option<Rect> {
    let (width, height) = (i64::from(camera.model.width), i64::from(camera.model.height));
    let w = NET_HALF_WIDTH_M;
    let corners =
        [(-w, 0.0), (w, 0.0), (-w, NET_HEIGHT_M), (w, NET_HEIGHT_M), (0.0, 0.0), (0.0, NET_HEIGHT_M)];
    let everywhere = Rect { x0: 0, y0: 0, x1: width, y1: height };
    let rect =
        extent(camera, corners.into_iter().map(|(x, z)| Vector3::new(x, 0.0, z))).unwrap_or(everywhere);
    (rect.x0 < width && rect.x1 > 0 && rect.y0 < height && rect.y1 > 0).then_some(rect)
}
