use nalgebra::{Vector2, Vector3};
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point, Transform, World},
    rig::RigCamera,
    wire::CameraTruth,
};
use std::{ops::Range, sync::Arc};

use super::{
    backdrop::Backdrop,
    board::BoardImage,
    canvas::{Canvas, Rect},
    layer::{Layer, Share},
    noise::{Developer, hash},
    outline::{Outline, Seen},
    rays::{RayTable, TILE},
};
use crate::synthetic::{
    flight::{BallTrack, TABLE_HALF_LENGTH_M, TABLE_HALF_WIDTH_M, TrackPoint},
    scene::{Body, CarriedBoard, Paint, Scene, Texture},
};

/// One exposure of one camera, in scene time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Counts frames: settles the noise.
    pub frame: u64,
    /// Its middle, s.
    pub mid_s: f64,
    /// Its length, s.
    pub length_s: f64,
}

/// Renders what one camera of a rig sees of a scene. Allocates nothing for a frame after the first few.
#[derive(Debug)]
pub struct FrameRenderer {
    scene: Arc<Scene>,
    track: Box<dyn BallTrack>,
    view: View,
    developer: Developer,
    canvas: Canvas,
    actors: Vec<Actor>,
    /// Places of the actors in the picture, the farthest first.
    order: Vec<usize>,
    ball: Vec<Outline>,
    ball_layer: Layer,
}

/// The camera, and what stands still before it.
#[derive(Debug)]
struct View {
    model: CameraModel,
    camera_from_world: Transform<Camera, World>,
    rays: RayTable,
    backdrop: Backdrop,
}

/// A body that is not the ball. What it adds to the picture is kept and only renewed 5 to 50 times a
/// second, each body's at its own instants: players are large, and slow beside the ball.
#[derive(Debug, Default)]
struct Actor {
    /// Which of its instants the layer is of.
    step: Option<i64>,
    outline: Option<Outline>,
    layer: Layer,
}

/// The ball's path over an exposure is sampled every pixel: with the pixel's and the lens's blur, which
/// together are never narrower than half a pixel, no ripple of the sampling is left.
const SAMPLE_PX: f64 = 1.0;
const MAX_SAMPLES: usize = 200;

/// Full light, as a gain in 1/256.
const FULL: u16 = 256;

/// Room for a ball of 60 px blurred over 200 px.
const LAYER_PIXELS: usize = 260 * 260;

impl FrameRenderer {
    /// For `camera` in `scene`. Renders the backdrop, on all cores.
    pub fn new(scene: &Arc<Scene>, camera: &RigCamera) -> Self {
        let (width, height) = (camera.model.width as usize, camera.model.height as usize);
        let seed = hash(scene.seed ^ hash(camera.index.code().into()));
        Self {
            track: scene.track(),
            view: View {
                model: camera.model,
                camera_from_world: camera.camera_from_world,
                rays: RayTable::new(&camera.model),
                backdrop: Backdrop::new(scene, camera),
            },
            developer: Developer::new(&scene.noise, seed),
            canvas: Canvas::new(width, height, camera.pixel_format),
            actors: (0..scene.cast.size()).map(|_| Actor::default()).collect(),
            order: Vec::with_capacity(scene.cast.size()),
            ball: Vec::with_capacity(MAX_SAMPLES),
            ball_layer: Layer::with_room(LAYER_PIXELS),
            scene: Arc::clone(scene),
        }
    }

    /// Renders an exposure into `out`, whose rows are as long as the image is wide: the whole frame.
    ///
    /// # Panics
    /// When `out` is shorter than the frame.
    pub fn render(&mut self, exposure: &Exposure, out: &mut [u8]) -> CameraTruth {
        let gain = self.gain(exposure);
        self.develop_backdrop(exposure.frame, gain, out);
        let truth = self.compose(exposure, gain);
        self.develop_tiles(exposure.frame, out);
        truth
    }

    /// Renders only what stands still, in full light; `frame` settles the noise.
    pub fn render_backdrop(&self, frame: u64, out: &mut [u8]) {
        self.develop_backdrop(frame, FULL, out);
    }

    /// Renders, in full light, only the tiles in which something moves; [`Self::tiles`] tells which.
    pub fn render_changes(&mut self, exposure: &Exposure, out: &mut [u8]) -> CameraTruth {
        let truth = self.compose(exposure, FULL);
        self.develop_tiles(exposure.frame, out);
        truth
    }

    /// The tiles, of [`super::TILE`] px, row by row, that the last frame changed against the backdrop.
    pub fn tiles(&self) -> &[u32] {
        self.canvas.tiles()
    }

    /// Width and height, px.
    pub const fn size(&self) -> (usize, usize) {
        (self.canvas.width, self.canvas.height)
    }

    fn develop_backdrop(&self, frame: u64, gain: u16, out: &mut [u8]) {
        let width = self.canvas.width;
        let rows = out.chunks_exact_mut(width).zip(self.view.backdrop.means.chunks_exact(width));
        for (y, (out, means)) in rows.enumerate() {
            let noise = self.developer.row_noise(frame, y, width);
            self.developer.row(means, gain, noise, out);
        }
    }

    fn develop_tiles(&self, frame: u64, out: &mut [u8]) {
        let width = self.canvas.width;
        for tile in self.canvas.tiles() {
            let (xs, ys) = self.canvas.pixels(*tile);
            for y in ys {
                let noise = &self.developer.row_noise(frame, y, width)[xs.clone()];
                let means = &self.canvas.row(y)[xs.clone()];
                self.developer.fine_row(means, noise, &mut out[y * width + xs.start..y * width + xs.end]);
            }
        }
    }

    /// What [`Self::render`] would say of the ball, without a picture.
    pub fn truth(&mut self, exposure: &Exposure) -> CameraTruth {
        let gain = self.gain(exposure);
        self.compose(exposure, gain)
    }

    /// The ball at an instant of scene time.
    pub fn ball_at(&mut self, t_s: f64) -> Option<TrackPoint> {
        self.track.at(t_s)
    }

    /// Brightness in 1/256.
    fn gain(&self, exposure: &Exposure) -> u16 {
        let gain = self.scene.room.light().gain(exposure.mid_s, exposure.length_s);
        (gain * 256.0).round().clamp(0.0, 256.0) as u16
    }

    /// Paints all that moves onto the canvas, the farthest first.
    fn compose(&mut self, exposure: &Exposure, gain: u16) -> CameraTruth {
        let gain = f32::from(gain) / 256.0;
        self.canvas.clear();
        self.renew_actors(exposure.mid_s);
        let seen = self.find_ball(exposure);
        let Self { scene, view, canvas, actors, order, ball, ball_layer, .. } = self;
        let mut painter = Painter { scene, view, canvas, gain };
        if let Some(carried) = &scene.board {
            painter.board(carried, exposure);
        }
        if let Some(centre) = seen.centre {
            painter.shadow(&centre);
        }
        let mut whole = 0.0;
        let ball_depth = ball.first().map_or(f64::NEG_INFINITY, |o| o.depth_m);
        let depth = |actor: &Actor| actor.outline.as_ref().map_or(0.0, |o| o.depth_m);
        let behind = order.partition_point(|i| depth(&actors[*i]) > ball_depth);
        for actor in &order[..behind] {
            painter.paint(&actors[*actor].layer);
        }
        if !ball.is_empty() {
            whole = painter.lay(ball, &scene.ball, ball_layer) + painter.outside(ball);
            painter.paint(ball_layer);
        }
        for actor in &order[behind..] {
            painter.paint(&actors[*actor].layer);
            ball_layer.hide_behind(&actors[*actor].layer);
        }
        let visible = if whole > 0.0 { (ball_layer.shown() / whole).clamp(0.0, 1.0) } else { 0.0 };
        CameraTruth { u_px: seen.image.x, v_px: seen.image.y, visible }
    }

    /// Lays the bodies whose time has come anew, and orders those in the picture.
    fn renew_actors(&mut self, t_s: f64) {
        let Self { scene, view, canvas, actors, order, .. } = self;
        order.clear();
        let count = actors.len();
        for (index, actor) in actors.iter_mut().enumerate() {
            let renewal_s = scene.cast.renewal_s(index);
            let offset = renewal_s * index as f64 / count as f64;
            let step = ((t_s + offset) / renewal_s).floor();
            if actor.step != Some(step as i64) {
                actor.step = Some(step as i64);
                let body = scene.cast.body(index, step * renewal_s - offset, scene.radius_m);
                actor.outline = body.and_then(|body| {
                    let outline = view.outline(&body, scene.blur_px)?;
                    in_frame(&outline.rect, canvas).then_some(outline)
                });
                if let (Some(outline), Some(body)) = (&actor.outline, body) {
                    Painter { scene, view, canvas, gain: 1.0 }.lay(
                        std::slice::from_ref(outline),
                        &body.paint,
                        &mut actor.layer,
                    );
                }
            }
            if actor.outline.is_some() {
                order.push(index);
            }
        }
        let depth = |i: &usize| actors[*i].outline.as_ref().map_or(0.0, |o| o.depth_m);
        order.sort_unstable_by(|a, b| depth(b).total_cmp(&depth(a)));
    }

    /// Outlines of the ball along its way, as many as its image's way needs.
    fn find_ball(&mut self, exposure: &Exposure) -> BallSeen {
        let Self { scene, track, view, ball, canvas, .. } = self;
        ball.clear();
        let Some(middle) = track.at(exposure.mid_s) else { return BallSeen::default() };
        let centre = middle.state.position;
        let at = |p: Vector3<f64>| view.model.project(&(&view.camera_from_world * Point::from(p)));
        let Some(image) = at(centre) else { return BallSeen::default() };
        let mut from = |share: f64| {
            let t = exposure.mid_s + (share - 0.5) * exposure.length_s;
            // The ball comes into being at a serve, and is gone at the end of a rally: inside an exposure
            // it then stands where it began or ended.
            track.at(t).map_or(centre, |p| p.state.position)
        };
        let way = |a: Option<Vector2<f64>>, b: Option<Vector2<f64>>| match (a, b) {
            (Some(a), Some(b)) => (a - b).norm(),
            _ => 0.0,
        };
        // Two legs: a bounce bends the way.
        let length = way(at(from(0.0)), Some(image)) + way(Some(image), at(from(1.0)));
        let count = ((length / SAMPLE_PX).ceil() as usize).clamp(1, MAX_SAMPLES);
        for k in 0..count {
            let position = from((k as f64 + 0.5) / count as f64);
            let body = Body::sphere(position, scene.radius_m, scene.ball);
            if let Some(outline) = view.outline(&body, scene.blur_px) {
                ball.push(outline);
            }
        }
        if !ball.iter().any(|outline| in_frame(&outline.rect, canvas)) {
            ball.clear();
        }
        BallSeen { image, centre: Some(centre) }
    }
}

#[derive(Debug, Clone, Copy, Default)]
struct BallSeen {
    image: Vector2<f64>,
    centre: Option<Vector3<f64>>,
}

fn in_frame(rect: &Rect, canvas: &Canvas) -> bool {
    let (columns, rows) = rect.within(canvas.width, canvas.height);
    !columns.is_empty() && !rows.is_empty()
}

impl View {
    fn outline(&self, body: &Body, blur_px: f64) -> Option<Outline> {
        Outline::new(&self.model, &self.camera_from_world, body, blur_px)
    }

    /// A direction of the camera's frame, in the world.
    fn to_world(&self, v: &Vector3<f64>) -> Vector3<f64> {
        self.camera_from_world.rotation.inverse_transform_vector(v)
    }
}

/// Paints bodies onto the canvas.
struct Painter<'a> {
    scene: &'a Scene,
    view: &'a mut View,
    canvas: &'a mut Canvas,
    gain: f32,
}

impl Painter<'_> {
    /// Opens the tiles under `rect`.
    fn open(&mut self, rect: &Rect) {
        self.canvas.open(rect, &self.view.backdrop.means, self.gain);
    }

    /// Gathers what a body that was at `outlines`, each for an equal share of the exposure, gives to the
    /// picture. Returns the area of its image inside the frame, hidden parts too, in px.
    fn lay(&mut self, outlines: &[Outline], paint: &Paint, layer: &mut Layer) -> f64 {
        let Some(hull) = outlines.iter().map(|o| o.rect).reduce(|a, b| a.hull(&b)) else { return 0.0 };
        let (width, height) = (self.canvas.width, self.canvas.height);
        layer.reset(hull.within(width, height));
        let share = 1.0 / outlines.len() as f64;
        let mut whole = 0.0;
        for outline in outlines {
            self.view.rays.make_known(&outline.rect, width, height);
            whole += share * self.add(outline, paint, share as f32, layer);
        }
        whole
    }

    /// Paints a layer over what is on the canvas.
    fn paint(&mut self, layer: &Layer) {
        let rows = layer.rows();
        let mut y0 = rows.start;
        while y0 < rows.end {
            // The rows of one row of tiles: what is covered of them is opened together.
            let y1 = ((y0 / TILE + 1) * TILE).min(rows.end);
            let covered = (y0..y1).map(|y| layer.covered(y)).filter(|(_, row)| !row.is_empty());
            let hull = covered.fold(None, |hull: Option<(usize, usize)>, (x, row)| {
                let (low, high) = hull.unwrap_or((x, x));
                Some((low.min(x), high.max(x + row.len())))
            });
            if let Some((x0, x1)) = hull {
                self.open(&Rect { x0: x0 as i64, y0: y0 as i64, x1: x1 as i64, y1: y1 as i64 });
            }
            for y in y0..y1 {
                let (x, row) = layer.covered(y);
                for (mean, s) in self.canvas.row_mut(y)[x..].iter_mut().zip(row) {
                    *mean = *mean * (1.0 - s.coverage) + s.light * self.gain;
                }
            }
            y0 = y1;
        }
    }

    /// Paints a board over what is on the canvas.
    fn board(&mut self, carried: &CarriedBoard, exposure: &Exposure) {
        let View { model, camera_from_world, .. } = &*self.view;
        let times = (exposure.mid_s, exposure.length_s);
        let Some(image) = BoardImage::new(self.scene, carried, model, camera_from_world, times) else {
            return;
        };
        self.open(&image.rect);
        let (width, height) = (self.canvas.width, self.canvas.height);
        let Rect { x0, y0, x1, y1 } = image.rect;
        let with_neighbours = Rect { x0: x0 - 1, y0: y0 - 1, x1: x1 + 1, y1: y1 + 1 };
        self.view.rays.make_known(&with_neighbours, width, height);
        let (columns, rows) = image.rect.within(width, height);
        for y in rows {
            for x in columns.clone() {
                let channel = self.canvas.channel(x, y);
                let Some(share) = image.pixel(x, y, &self.view.rays.field(x, y), channel) else { continue };
                if !self.view.backdrop.hides(x, y, share.depth_m) {
                    let mean = self.canvas.mean_mut(x, y);
                    *mean = *mean * (1.0 - share.coverage) + share.light * share.coverage * self.gain;
                }
            }
        }
    }

    /// Adds one outline to the layer; returns its area inside the frame.
    fn add(&self, outline: &Outline, paint: &Paint, share: f32, layer: &mut Layer) -> f64 {
        let (columns, rows) = outline.rect.within(self.canvas.width, self.canvas.height);
        let by_net = self.view.backdrop.net.is_some_and(|net| {
            net.x0 < outline.rect.x1
                && outline.rect.x0 < net.x1
                && net.y0 < outline.rect.y1
                && outline.rect.y0 < net.y1
        });
        let mut area = 0.0;
        for y in rows {
            let rays = self.view.rays.row(y);
            let (x0, row) = layer.row_mut(y);
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
                let channel = self.canvas.channel(x, y);
                let mut light = self.light(&seen, rays[x], paint, channel);
                let mut clear = 1.0;
                if by_net && let Some((opacity, of_net)) = self.net(rays[x], seen.depth_m, channel) {
                    light += opacity * (of_net - light);
                    clear = 1.0 - opacity;
                }
                let coverage = seen.coverage as f32 * share;
                let Share { coverage: c, light: l, shown } = &mut row[x - x0];
                *c += coverage;
                *l += coverage * light;
                *shown += coverage * clear;
            }
            if !span.is_empty() {
                layer.widen(y, span);
            }
        }
        area
    }

    /// Area of the part of a body's image that lies outside the frame, px.
    fn outside(&self, outlines: &[Outline]) -> f64 {
        let mut area = 0.0;
        for outline in outlines {
            let (columns, rows) = outline.rect.within(self.canvas.width, self.canvas.height);
            let Rect { x0, y0, x1, y1 } = outline.rect;
            if columns.len() as i64 == x1 - x0 && rows.len() as i64 == y1 - y0 {
                continue;
            }
            for (x, y) in (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y))) {
                let in_range =
                    |v: i64, range: &Range<usize>| usize::try_from(v).is_ok_and(|v| range.contains(&v));
                if in_range(x, &columns) && in_range(y, &rows) {
                    continue;
                }
                if let Some(n) = self.view.model.undistort(&Vector2::new(x as f64, y as f64)) {
                    area += outline.seen([n.x as f32, n.y as f32]).map_or(0.0, |s| s.coverage);
                }
            }
        }
        area / outlines.len().max(1) as f64
    }

    /// What a point of a body sends to a pixel of this channel in full light, DN.
    fn light(&self, seen: &Seen, ray: [f32; 2], paint: &Paint, channel: usize) -> f32 {
        let light = self.scene.room.light();
        let normal = seen.normal;
        let irradiance = light.on(&normal) as f32;
        let colour = match paint.texture {
            Texture::Plain => paint.colour,
            _ => paint.at(seen.on_body.x, seen.on_body.z),
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

    /// The net before a point at this depth: its opacity, and its light in full light, DN.
    fn net(&self, ray: [f32; 2], depth_m: f64, channel: usize) -> Option<(f32, f32)> {
        let direction = self.view.to_world(&Vector3::new(f64::from(ray[0]), f64::from(ray[1]), 1.0));
        let origin = self.view.camera_from_world.origin().coords;
        let net = self.scene.room.net(&origin, &direction).filter(|net| net.distance < depth_m)?;
        Some((net.opacity, self.scene.level(&net.radiance, channel)))
    }

    /// The ball's shadows on the table: one for each lamp, the softer the higher the ball.
    fn shadow(&mut self, ball: &Vector3<f64>) {
        /// Higher balls throw no shadow that could be seen.
        const HIGHEST_M: f64 = 0.5;
        /// Width of the lamps as an angle: what a shadow's rim grows by with height.
        const LAMP_RAD: f64 = 0.12;
        let on_table = |p: &Vector3<f64>| p.x.abs() < TABLE_HALF_WIDTH_M && p.y.abs() < TABLE_HALF_LENGTH_M;
        if !(0.0..HIGHEST_M).contains(&ball.z) {
            return;
        }
        let light = *self.scene.room.light();
        let all = light.on(&Vector3::z());
        let origin = self.view.camera_from_world.origin().coords;
        let radius = self.scene.radius_m;
        for (to, strength) in light.lamps {
            let centre = ball - to * (ball.z / to.z);
            if !on_table(&centre) {
                continue;
            }
            let soft = LAMP_RAD * ball.z;
            let reach = radius + soft;
            let dark = strength * to.z / all * (radius / reach).powi(2);
            let disc = Body::upright(centre, [reach, reach, 1e-3], self.scene.ball);
            let Some(outline) = self.view.outline(&disc, 0.5) else { continue };
            self.open(&outline.rect);
            let (width, height) = (self.canvas.width, self.canvas.height);
            self.view.rays.make_known(&outline.rect, width, height);
            let (columns, rows) = outline.rect.within(width, height);
            for y in rows {
                for x in columns.clone() {
                    let ray = self.view.rays.row(y)[x];
                    let direction =
                        self.view.to_world(&Vector3::new(f64::from(ray[0]), f64::from(ray[1]), 1.0));
                    let depth = -origin.z / direction.z;
                    let at = origin + direction * depth;
                    // Only where the table is what the pixel sees.
                    if !on_table(&at) || (self.view.backdrop.depth_m(x, y) - depth).abs() > 0.01 {
                        continue;
                    }
                    let share = ((reach - (at - centre).norm()) / (2.0 * soft + 2e-3)).clamp(0.0, 1.0);
                    let kept = 1.0 - dark * share * share * (3.0 - 2.0 * share);
                    *self.canvas.mean_mut(x, y) *= kept as f32;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Unit};

    use super::*;
    use crate::synthetic::{
        FramePool,
        scene::{Preset, SceneOptions},
        test_rig,
    };

    fn renderer(preset: Preset, seed: u64) -> (Arc<Scene>, FrameRenderer) {
        let rig = test_rig();
        let options = SceneOptions { preset, seed, ..SceneOptions::default() };
        let scene = Arc::new(Scene::new(&rig, &options).expect("valid"));
        let renderer = FrameRenderer::new(&scene, &rig.cameras[0]);
        (scene, renderer)
    }

    fn exposure(frame: u64, length_s: f64) -> Exposure {
        Exposure { frame, mid_s: frame as f64 * 0.01, length_s }
    }

    #[test]
    fn a_frame_does_not_depend_on_what_was_rendered_before() {
        let (_, mut one) = renderer(Preset::Hard, 3);
        let (_, mut other) = renderer(Preset::Hard, 3);
        let (width, height) = one.size();
        let (mut a, mut b) = (vec![0; width * height], vec![1; width * height]);
        let mut truth = CameraTruth::default();
        for frame in 0..60 {
            truth = one.render(&exposure(frame, 0.006), &mut a);
        }
        other.render(&exposure(200, 0.006), &mut b);
        assert_ne!(a, b);
        assert_eq!(other.render(&exposure(59, 0.006), &mut b), truth);
        assert_eq!(a, b);
        let (_, mut another) = renderer(Preset::Hard, 4);
        another.render(&exposure(59, 0.006), &mut b);
        assert_ne!(a, b, "another seed, another scene");
    }

    #[test]
    fn the_ball_is_painted_where_the_truth_says() {
        let (scene, mut renderer) = renderer(Preset::Clean, 5);
        let mut checked = 0;
        for frame in 0..300 {
            // No blur: the swept image of a bent way has another centre than its middle.
            let truth = renderer.truth(&exposure(frame, 1e-6));
            assert!((0.0..=1.0).contains(&truth.visible));
            let model = renderer.view.model;
            let pixel = Vector2::new(truth.u_px, truth.v_px);
            if truth.visible == 0.0 || !model.contains(&pixel) {
                continue;
            }
            let (mut area, mut moment) = (0.0, Vector2::zeros());
            for y in renderer.ball_layer.rows() {
                let (x0, row) = renderer.ball_layer.row(y);
                for (i, share) in row.iter().enumerate() {
                    area += f64::from(share.shown);
                    moment += Vector2::new((x0 + i) as f64, y as f64) * f64::from(share.shown);
                }
            }
            if truth.visible > 0.999 {
                checked += 1;
                let ball = renderer.ball_at(frame as f64 * 0.01).expect("visible").state.position;
                let ball = (&renderer.view.camera_from_world * Point::<World>::from(ball)).coords;
                // The outline's centre lies outward of the image of the sphere's centre: midway between the
                // images of the nearest and the farthest tangent.
                let half = (scene.radius_m / ball.norm()).asin();
                let axis = Rotation3::from_axis_angle(&Unit::new_normalize(Vector3::z().cross(&ball)), half);
                let rim = |v: Vector3<f64>| model.project(&Point::from(v)).expect("in view");
                let centre = (rim(axis * ball) + rim(axis.inverse() * ball)) * 0.5;
                let off = (moment / area - centre).norm();
                assert!(off < 0.02, "frame {frame}: off by {off} px");
                assert!((centre - pixel).norm() < 0.3);
                let other = Unit::new_normalize(Vector3::z().cross(&ball).cross(&ball));
                let across = Rotation3::from_axis_angle(&other, half);
                let long = (rim(axis * ball) - rim(axis.inverse() * ball)).norm();
                let short = (rim(across * ball) - rim(across.inverse() * ball)).norm();
                let ellipse = std::f64::consts::FRAC_PI_4 * long * short;
                assert!((area / ellipse - 1.0).abs() < 0.02, "frame {frame}: {area} px², not {ellipse}");
            }
        }
        assert!(checked > 80, "{checked} frames with the whole ball");
    }

    #[test]
    fn blur_is_the_sum_of_instants() {
        let (_, mut renderer) = renderer(Preset::Clean, 5);
        let length_s = 0.006;
        let frame = (20..300)
            .find(|n| renderer.truth(&exposure(*n, length_s)).visible > 0.999)
            .expect("a ball in view");
        let mid_s = exposure(frame, length_s).mid_s;
        renderer.truth(&exposure(frame, length_s));
        let mut blurred = std::collections::HashMap::new();
        for y in renderer.ball_layer.rows() {
            let (x0, row) = renderer.ball_layer.row(y);
            blurred.extend(row.iter().enumerate().map(|(i, s)| ((x0 + i, y), f64::from(s.coverage))));
        }
        let count = 300;
        for k in 0..count {
            let t = mid_s + length_s * ((f64::from(k) + 0.5) / f64::from(count) - 0.5);
            renderer.truth(&Exposure { frame, mid_s: t, length_s: 0.0 });
            for y in renderer.ball_layer.rows() {
                let (x0, row) = renderer.ball_layer.row(y);
                for (i, s) in row.iter().enumerate() {
                    *blurred.entry((x0 + i, y)).or_default() -= f64::from(s.coverage) / f64::from(count);
                }
            }
        }
        let worst = blurred.values().fold(0.0_f64, |w, d| w.max(d.abs()));
        assert!(worst < 0.02, "a pixel's coverage is off by {worst}");
    }

    #[test]
    fn a_slot_of_the_pool_holds_one_frame_and_nothing_of_its_last() {
        let (_, mut renderer) = renderer(Preset::Normal, 2);
        let (width, height) = renderer.size();
        let mut pool = FramePool::new(&mut renderer, 40, 0.01, 0.001);
        let mut used = vec![0; width * height];
        for n in [3, 17, 39, 45, 12] {
            pool.write(n, &mut used);
        }
        let mut pool = FramePool::new(&mut renderer, 40, 0.01, 0.001);
        let mut fresh = vec![0; width * height];
        let truth = pool.write(12 + 40, &mut fresh);
        assert_eq!(used, fresh);
        assert_eq!(truth, pool.truth(12));
    }
}
