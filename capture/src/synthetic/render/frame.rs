use std::sync::Arc;

use nalgebra::{Vector2, Vector3};
use netcord_common::{geometry::Point, rig::RigCamera, wire::CameraTruth};

use super::{
    Canvas, Developer, Layer, Outline, Painter, Set, View, board::paint_board, cast_shadows, hash,
    noise::Brightness,
};
use crate::synthetic::{
    flight::{BallTrack, TrackPoint},
    scene::{Body, Scene},
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
    set: Set,
    developer: Developer,
    /// The tiles about the ball and its shadows.
    canvas: Canvas,
    painter: Painter,
    ball: Vec<Outline>,
    ball_layer: Layer,
    /// Brightness against what the scene's exposure and no amplification give, and the amplification.
    sensitivity: (f64, f64),
}

/// The ball's path over an exposure is sampled every pixel: with the pixel's and the lens's blur, which
/// together are never narrower than half a pixel, no ripple of the sampling is left.
const SAMPLE_PX: f64 = 1.0;
const MAX_SAMPLES: usize = 200;

/// Room for a ball of 60 px blurred over 200 px.
const LAYER_PIXELS: usize = 260 * 260;

impl FrameRenderer {
    /// For `camera` in `scene`. Renders the backdrop, on all cores.
    pub fn new(scene: &Arc<Scene>, camera: &RigCamera) -> Self {
        let seed = hash(scene.seed ^ hash(camera.index.code().into()));
        let view = View::new(scene, camera);
        Self {
            track: scene.track(),
            set: Set::new(scene, &view),
            developer: Developer::new(&scene.noise, seed),
            canvas: Canvas::new(view.grid),
            painter: Painter::new(view.grid.width),
            ball: Vec::with_capacity(MAX_SAMPLES),
            ball_layer: Layer::with_room(LAYER_PIXELS),
            sensitivity: (1.0, 1.0),
            scene: Arc::clone(scene),
            view,
        }
    }

    /// Renders an exposure into `out`, whose rows are as long as the image is wide: the whole frame.
    ///
    /// # Panics
    /// When `out` is shorter than the frame.
    pub fn render(&mut self, exposure: &Exposure, out: &mut [u8]) -> CameraTruth {
        let light = self.light(exposure);
        let truth = self.compose(exposure, &light);
        self.develop(exposure.frame, &light, self.set.means(), out);
        self.develop_canvas(exposure.frame, out);
        truth
    }

    /// Renders only what stands still, in full light; `frame` settles the noise.
    pub fn render_backdrop(&self, frame: u64, out: &mut [u8]) {
        self.develop(frame, &self.developer.full(), &self.view.backdrop.means, out);
    }

    /// Renders, in full light, only the tiles that differ from the backdrop, and lists them in `tiles`.
    pub fn render_changes(
        &mut self,
        exposure: &Exposure,
        out: &mut [u8],
        tiles: &mut Vec<u32>,
    ) -> CameraTruth {
        let light = self.developer.full();
        let truth = self.compose(exposure, &light);
        tiles.clear();
        tiles.extend(self.set.dressed().filter(|tile| !self.canvas.is_open(*tile)));
        let width = self.view.grid.width;
        for tile in tiles.iter() {
            let (xs, ys) = self.view.grid.pixels(*tile);
            for y in ys {
                let row = y * width + xs.start..y * width + xs.end;
                let noise = &self.developer.row_noise(exposure.frame, y, width)[xs.clone()];
                self.developer.row(&light, &self.set.means()[row.clone()], noise, &mut out[row]);
            }
        }
        tiles.extend_from_slice(self.canvas.tiles());
        self.develop_canvas(exposure.frame, out);
        truth
    }

    /// From now on exposures are `exposure` times as long as the scene's light is made for, and are amplified. What
    /// would be more than twice as bright as before is as bright as that.
    pub const fn set_sensitivity(&mut self, exposure: f64, amplification: f64) {
        self.sensitivity = (exposure * amplification, amplification);
    }

    /// Width and height, px.
    pub const fn size(&self) -> (usize, usize) {
        (self.view.grid.width, self.view.grid.height)
    }

    fn develop(&self, frame: u64, light: &Brightness, means: &[u8], out: &mut [u8]) {
        let width = self.view.grid.width;
        let rows = out.chunks_exact_mut(width).zip(means.chunks_exact(width));
        for (y, (out, means)) in rows.enumerate() {
            let noise = self.developer.row_noise(frame, y, width);
            self.developer.row(light, means, noise, out);
        }
    }

    fn develop_canvas(&self, frame: u64, out: &mut [u8]) {
        let width = self.view.grid.width;
        for tile in self.canvas.tiles() {
            let (xs, ys) = self.view.grid.pixels(*tile);
            for y in ys {
                let noise = &self.developer.row_noise(frame, y, width)[xs.clone()];
                let means = &self.canvas.row(y)[xs.clone()];
                self.developer.fine_row(means, noise, &mut out[y * width + xs.start..y * width + xs.end]);
            }
        }
    }

    /// What [`Self::render`] would say of the ball, without a picture.
    pub fn truth(&mut self, exposure: &Exposure) -> CameraTruth {
        let light = self.light(exposure);
        self.compose(exposure, &light)
    }

    /// As [`Self::truth`], but with players where they were last painted: for a frame that is left out because time
    /// is short, and would be left out in vain if this took as long as the frame.
    pub fn glance(&mut self, exposure: &Exposure) -> CameraTruth {
        let light = self.light(exposure);
        self.paint_ball(exposure, &light)
    }

    /// The ball at an instant of scene time.
    pub fn ball_at(&mut self, t_s: f64) -> Option<TrackPoint> {
        self.track.at(t_s)
    }

    fn light(&self, exposure: &Exposure) -> Brightness {
        let (brightness, amplification) = self.sensitivity;
        let gain = self.scene.room.light().gain(exposure.mid_s, exposure.length_s);
        self.developer.at(gain * brightness, amplification)
    }

    /// Brings the set up to date, and paints the ball and its shadows onto tiles of the backdrop, with the actors
    /// behind and before it.
    fn compose(&mut self, exposure: &Exposure, light: &Brightness) -> CameraTruth {
        self.set.renew(&mut self.view, exposure.mid_s);
        self.paint_ball(exposure, light)
    }

    fn paint_ball(&mut self, exposure: &Exposure, light: &Brightness) -> CameraTruth {
        let gain = light.gain();
        self.canvas.clear();
        let seen = self.find_ball(exposure);
        let Self { scene, view, set, canvas, painter, ball, ball_layer, .. } = self;
        if let Some(carried) = &scene.board {
            paint_board((scene, carried), view, exposure, canvas, gain);
        }
        if let Some(centre) = seen.centre {
            cast_shadows(scene, view, &centre, canvas, gain);
        }
        let mut whole = 0.0;
        if !ball.is_empty() {
            whole = painter.lay(scene, view, ball, &scene.ball, ball_layer) + view.area_outside(ball);
        }
        for outline in ball.iter() {
            canvas.open(&outline.rect, &view.backdrop.means, gain);
        }
        let depth_m = ball.first().map_or(f64::NEG_INFINITY, |o| o.depth_m);
        for actor in set.behind(depth_m) {
            canvas.paint(actor, gain);
        }
        if !ball.is_empty() {
            canvas.paint(ball_layer, gain);
        }
        for actor in set.before(depth_m) {
            canvas.paint(actor, gain);
            ball_layer.hide_behind(actor);
        }
        let visible = if whole > 0.0 { (ball_layer.shown() / whole).clamp(0.0, 1.0) } else { 0.0 };
        CameraTruth { u_px: seen.image.x, v_px: seen.image.y, visible }
    }

    /// Outlines of the ball along its way, as many as its image's way needs.
    fn find_ball(&mut self, exposure: &Exposure) -> BallSeen {
        let Self { scene, track, view, ball, .. } = self;
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
        if !ball.iter().any(|outline| view.contains_some_of(&outline.rect)) {
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

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Unit};
    use netcord_common::geometry::World;

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
    fn longer_exposures_and_amplification_are_brighter_and_saturate() {
        let (_, mut renderer) = renderer(Preset::Clean, 5);
        let (width, height) = renderer.size();
        let mut frame = vec![0; width * height];
        let mut mean = |exposure_factor: f64, amplification: f64| {
            renderer.set_sensitivity(exposure_factor, amplification);
            renderer.render(&exposure(3, 0.001), &mut frame);
            frame.iter().map(|v| f64::from(*v)).sum::<f64>() / frame.len() as f64
        };
        let (full, half, amplified) = (mean(1.0, 1.0), mean(0.5, 1.0), mean(0.5, 2.0));
        assert!((half / full - 0.5).abs() < 0.01 && (amplified / full - 1.0).abs() < 0.01);
        let most = mean(1.0, 8.0);
        assert!(most > 1.4 * full && most < 2.0 * full, "{most} of {full}");
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
            for ((x, y), _, shown) in renderer.ball_layer.pixels() {
                area += shown;
                moment += Vector2::new(x as f64, y as f64) * shown;
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
        blurred.extend(renderer.ball_layer.pixels().map(|(at, coverage, _)| (at, coverage)));
        let count = 300;
        for k in 0..count {
            let t = mid_s + length_s * ((f64::from(k) + 0.5) / f64::from(count) - 0.5);
            renderer.truth(&Exposure { frame, mid_s: t, length_s: 0.0 });
            for (at, coverage, _) in renderer.ball_layer.pixels() {
                *blurred.entry(at).or_default() -= coverage / f64::from(count);
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
