use std::ops::Range;

use nalgebra::{Vector2, Vector3};
use netcord_common::{
    FrameView, PixelFormat,
    camera::CameraModel,
    rig::Rig,
    wire::{
        Detection, DetectionFlags, Detections, FrameHeader, MAX_DETECTIONS, Scope, SearchWindow, WorldFrame,
    },
};

use super::{
    background::{Background, PixelBox},
    blobs::{Blob, BlobFinder},
    blur::BlurLimit,
    candidate::{MOST_CELLS, Start, centre_px, is_of_size, start},
    colour::{ColourModel, MAX_MODELS, SceneLight, cell_colour},
    demosaic::Demosaic,
    describe::describe,
    fit::Prior,
    foreground::Foreground,
    grid::Grid,
    kernel::Kernel,
    measure::{Behind, Measured, Scene},
    options::{InputMode, SegmentError, SegmentOptions},
    outline::Outline,
    patch::Patch,
    rest::RestWatch,
    score::{LEAST_SCORE, SCORE_THRESHOLD, is_gone, score, single_score},
    singles::SingleFinder,
    sphere,
    sweep::{MIN_LENGTH_PX, Sweep},
};

/// Fits per frame, at most: the likeliest blobs come first.
const MAX_FITS: usize = 5;
/// Rank of a start up to which it is looked at only where nothing better is found, and how many such.
const UNLIKELY: f32 = 0.03;
const MAX_UNLIKELY: usize = 3;
/// Frames in one place after which a candidate no longer makes others unlikely.
const FEW_FRAMES: u32 = 3;
/// Fits per frame where nothing is known of the background.
const MAX_FITS_ALONE: usize = 16;
/// Fits in a frame that stands for itself: pictures in no order leave time.
const MAX_FITS_SINGLE: usize = 100;
/// Fits of each colour among what moves, and the least rank that is worth one there.
const MAX_FITS_IN_CROWD: usize = 3;
const LIKELY_IN_CROWD: f32 = 0.15;
/// Fits beside a ball that is where it was expected, of what ranks so high.
const MAX_FITS_BESIDE: usize = 2;
const LIKELY_BESIDE: f32 = 0.3;
/// Score from which on a better measurement is worth its time.
const WORTH_REFINING: f64 = 0.3;

/// Score of what surely is a ball; it may teach what balls look like here.
const SURE: f64 = 0.6;

/// While a ball flies, what lies or rolls elsewhere is measured in one frame of so many.
const SLOW_EVERY: u64 = 4;

/// Frames between two looks at the colour of the scene's light.
const LIGHT_EVERY: u64 = 64;

/// Share of marked cells from which on a frame shows another scene.
const OTHER_SCENE: f64 = 0.35;

/// A blob of more cells than this that is no ball may have a ball in front of it.
const CROWD_CELLS: u32 = 60;

/// What is left of the score of something that stays where it is.
const AT_REST_SHARE: f64 = 0.4;

/// What a candidate is held against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Backdrop {
    /// The learnt background.
    Learnt,
    /// What is seen around it: the learnt background is hidden by what moves, or not known.
    Around,
}

/// A candidate with what the message will say of it.
#[derive(Debug, Clone, Copy)]
struct Found {
    item: Detection,
    measured: Measured,
    likeness: f32,
}

/// Finds the ball in one camera's frames.
///
/// Pure: it reads no clock and does no input or output; the same frames give the same bytes. After the
/// first frame it allocates nothing, unless each frame stands for itself.
#[derive(Debug)]
pub struct Segmenter {
    name: String,
    index: u32,
    camera: CameraModel,
    /// Direction of the main light, in the camera's frame: at first the vertical, then as balls show it.
    towards_light: Vector3<f64>,
    format: PixelFormat,
    options: SegmentOptions,
    grid: Grid,
    demosaic: Option<Demosaic>,
    background: Background,
    started: bool,
    light: SceneLight,
    colour: ColourModel,
    foreground: Foreground,
    coloured: Vec<u16>,
    finder: BlobFinder,
    singles: Option<SingleFinder>,
    /// Of a frame that stands for itself: variance of its noise, DN² and DN² per DN.
    frame_noise: Option<[f32; 2]>,
    starts: Vec<Start>,
    patch: Patch,
    found: Vec<Found>,
    kept: Vec<PixelBox>,
    rest: RestWatch,
    blur: BlurLimit,
    message: Box<Detections>,
}

impl Segmenter {
    /// A segmenter for the rig's camera `index`.
    ///
    /// # Errors
    /// [`SegmentError::NoSuchCamera`], [`SegmentError::TooSmall`].
    pub fn new(rig: &Rig, index: usize, options: SegmentOptions) -> Result<Self, SegmentError> {
        let camera =
            rig.cameras.get(index).ok_or(SegmentError::NoSuchCamera { index, cameras: rig.cameras.len() })?;
        let (width, height) = (camera.model.width as usize, camera.model.height as usize);
        if width < 16 || height < 16 {
            return Err(SegmentError::TooSmall { camera: camera.name.to_string(), width, height });
        }
        let grid = Grid::of(options.input);
        // Grey frames have nothing to be interpolated.
        let grid = if camera.pixel_format == PixelFormat::Mono8 { Grid::of(InputMode::Raw) } else { grid };
        let demosaic = (grid.scale == 2).then(|| Demosaic::new(options.input, (width, height)));
        let size = (width * grid.scale, height * grid.scale);
        let kernel = Kernel::detect();
        let background = Background::new(kernel, size, rig.rate_hz);
        let foreground = Foreground::new(kernel, size);
        let up = match rig.world {
            WorldFrame::Table => Vector3::z(),
            // A camera is seldom on its head.
            WorldFrame::FirstCamera => -Vector3::y(),
        };
        let told = options.colour.unwrap_or(rig.ball.colour);
        // What an option tells goes before what was learnt.
        let marked = camera.ball.as_ref().filter(|_| options.colour.is_none());
        let format = if demosaic.is_some() { PixelFormat::BayerRG8 } else { camera.pixel_format };
        let singles = options.single_frames.then(|| {
            let shape = (foreground.words().len(), foreground.words_per_row());
            SingleFinder::new(kernel, format, shape)
        });
        Ok(Self {
            name: camera.name.to_string(),
            index: camera.index.code(),
            camera: camera.model,
            towards_light: camera.camera_from_world.rotation * up,
            format: camera.pixel_format,
            options,
            grid,
            demosaic,
            background,
            started: false,
            light: SceneLight::default(),
            colour: ColourModel::new(format, told, marked),
            coloured: vec![0; foreground.words().len()],
            foreground,
            finder: BlobFinder::new(MOST_CELLS),
            singles,
            frame_noise: None,
            starts: Vec::with_capacity(super::blobs::MAX_BLOBS),
            patch: Patch::new(),
            found: Vec::with_capacity(MAX_FITS + MAX_FITS_ALONE),
            kept: Vec::with_capacity(MAX_DETECTIONS),
            rest: RestWatch::new(rig.rate_hz),
            blur: BlurLimit::new(rig.ball.diameter_m),
            message: Box::default(),
        })
    }

    /// Searches one frame. Where `window` expects a ball and one is there, `emit` is called with it first
    /// (scope `window`); then, always, with all candidates of the frame (scope `full`). The stamps of the
    /// stage are left for the caller to set.
    ///
    /// # Errors
    /// [`SegmentError::WrongFrame`]: the frame is not this camera's.
    pub fn process(
        &mut self,
        header: &FrameHeader,
        view: &FrameView<'_>,
        window: Option<&SearchWindow>,
        emit: &mut dyn FnMut(&Detections),
    ) -> Result<(), SegmentError> {
        self.check(view)?;
        // Moved out for the time of the call, so that the searched image may be borrowed beside the rest.
        let mut demosaic = self.demosaic.take();
        match &mut demosaic {
            None => self.search(header, view, window, emit),
            Some(demosaic) => {
                let cells = demosaic.run(view);
                self.search(header, &cells, window, emit);
            }
        }
        self.demosaic = demosaic;
        Ok(())
    }

    /// Forgets all that was learnt, as before the first frame; `process --warm-up` keeps it instead.
    pub fn forget(&mut self) {
        self.started = false;
        self.rest.clear();
    }

    fn check(&self, view: &FrameView<'_>) -> Result<(), SegmentError> {
        let size = (self.camera.width as usize, self.camera.height as usize);
        if (view.width(), view.height()) == size && view.format() == self.format {
            return Ok(());
        }
        Err(SegmentError::WrongFrame {
            camera: self.name.clone(),
            found_width: view.width(),
            found_height: view.height(),
            found_format: view.format(),
            width: size.0,
            height: size.1,
            format: self.format,
        })
    }

    fn search(
        &mut self,
        header: &FrameHeader,
        view: &FrameView<'_>,
        window: Option<&SearchWindow>,
        emit: &mut dyn FnMut(&Detections),
    ) {
        let alone = !self.started || self.options.single_frames;
        if alone {
            self.background.start_over(view);
            self.light = SceneLight::of(view);
            self.started = true;
        }
        self.rest.next_frame();
        self.blur.expose(header.exposure_ns);
        self.found.clear();
        let window = window.filter(|w| w.present == 1 && self.background.is_known());
        if let Some(window) = window {
            self.search_window(view, window);
            if self.found.iter().any(|f| f.item.score >= SCORE_THRESHOLD) {
                self.send(header, Scope::Window, emit);
            }
        }
        if !alone {
            self.background.look_at_light(view);
            if self.background.frames().is_multiple_of(LIGHT_EVERY) {
                self.light = SceneLight::of(view);
            }
        }
        let expected = self.has_ball_in_play();
        self.search_frame(view, expected);
        self.send(header, Scope::Full, emit);
        self.after(view, window);
    }

    /// Measures inside a window: first where the ball should be, then what moves.
    fn search_window(&mut self, view: &FrameView<'_>, window: &SearchWindow) {
        let prior = self.prior(window);
        let columns = self.grid.range(window.x0_px, window.x1_px, view.width());
        let rows = self.grid.range(window.y0_px, window.y1_px, view.height() & !1);
        self.background.look_at_light_within(view, &columns, &rows);
        if let Some(expected) = self.expected(window) {
            for backdrop in [Backdrop::Learnt, Backdrop::Around] {
                // Whatever happens to be there is near the prediction: only what surely is a ball counts.
                let Some(found) = self.measure(view, &expected, backdrop, &prior) else { continue };
                if found.item.score >= SCORE_THRESHOLD {
                    self.blur.learn(&found.item, window);
                    self.add(found);
                    return;
                }
            }
        }
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        self.foreground.mark_within(view, &self.background, &columns, &rows);
        self.finder.find(
            self.foreground.words(),
            self.foreground.words_per_row(),
            rows.start / 2..rows.end / 2,
        );
        self.starts.clear();
        self.collect_starts(view);
        self.measure_starts(view, Backdrop::Learnt, &prior, 3, 0.0);
        if !self.has_ball_in_play() && self.crowded() {
            let place = Some((columns, rows));
            self.search_by_colour(view, place, &prior);
        }
    }

    /// The ball as it was predicted; none where its place is known to no more than its size.
    fn expected(&self, window: &SearchWindow) -> Option<Start> {
        let radius = 0.5 * window.diameter_px as f32;
        let [uu, _, vv] = window.covariance_px2;
        let known = uu.max(vv).sqrt() < 0.5 * window.diameter_px;
        if radius < 1.0 || !known || !self.camera.contains(&Vector2::new(window.u_px, window.v_px)) {
            return None;
        }
        let place = sphere::place(&self.camera, [window.u_px, window.v_px]);
        let path = place.rectifier.rectify_offset(window.velocity_px_s.map(|v| v * self.blur.exposure_s()));
        let sweep = Sweep {
            centre: [0.0; 2],
            radius,
            length: (path[0].hypot(path[1]) as f32).max(MIN_LENGTH_PX),
            angle: path[1].atan2(path[0]) as f32,
        };
        Some(Start { place, sweep, likeness: 1.0, colour: 1.0, slow: false })
    }

    /// What a window says of the ball's size.
    fn prior(&self, window: &SearchWindow) -> Prior {
        let diameter = window.diameter_px as f32;
        if diameter > 1.0 {
            // Prediction knows the depth to a few per cent.
            Prior { radius: Some((0.5 * diameter, 0.015 * diameter + 0.08)) }
        } else {
            Prior::default()
        }
    }

    /// Looks for what moves, in the whole frame; `expected`: the ball has been found where it was expected.
    fn search_frame(&mut self, view: &FrameView<'_>, expected: bool) {
        if let Some(mut singles) = self.singles.take() {
            self.search_single(view, &mut singles);
            self.singles = Some(singles);
            return;
        }
        let height = view.height() & !1;
        let known = self.background.is_known();
        self.foreground.mark(view, &self.background);
        self.finder.find(self.foreground.words(), self.foreground.words_per_row(), 0..height / 2);
        let cells = (view.width() / 2 * (height / 2)) as f64;
        if known && (self.finder.overflowed() || self.finder.cells() as f64 > OTHER_SCENE * cells) {
            self.background.start_over(view);
            self.light = SceneLight::of(view);
            self.rest.clear();
            self.search_by_colour(view, None, &Prior::default());
            return;
        }
        self.starts.clear();
        self.collect_starts(view);
        if expected {
            let prior = Prior::default();
            self.measure_starts(view, Backdrop::Learnt, &prior, MAX_FITS_BESIDE, LIKELY_BESIDE);
            return;
        }
        self.measure_starts(view, Backdrop::Learnt, &Prior::default(), MAX_FITS, 0.0);
        if !known {
            self.search_by_colour(view, None, &Prior::default());
        } else if !self.has_ball_in_flight() && self.crowded() {
            self.search_by_colour(view, Some((0..view.width(), 0..height)), &Prior::default());
        }
    }

    /// Looks for the ball in a frame that stands for itself.
    fn search_single(&mut self, view: &FrameView<'_>, singles: &mut SingleFinder) {
        singles.clear();
        self.frame_noise = Some(SingleFinder::noise(view));
        let (gates, count) = self.gates(false);
        for gate in &gates[..count] {
            let mut finder = std::mem::replace(&mut self.finder, BlobFinder::empty());
            let mut words = std::mem::take(&mut self.coloured);
            singles.search(view, gate, (&mut words, &mut finder), |blob| {
                self.start_of(view, blob, centre_px(blob).map(|c| self.grid.frame_px(c)))
            });
            (self.finder, self.coloured) = (finder, words);
        }
        self.starts.clear();
        self.starts.extend(singles.sorted().iter().map(|single| single.start).take(MAX_FITS_SINGLE));
        for i in 0..self.starts.len() {
            let start = self.starts[i];
            let certain = |f: &Found| f.item.score > SCORE_THRESHOLD;
            if self.found.iter().any(|f| certain(f) && covers(&f.item, start.place.rectifier.anchor)) {
                continue;
            }
            let found = self.measure(view, &start, Backdrop::Around, &Prior::default());
            if let Some(found) = found.filter(|f| f.item.score >= LEAST_SCORE) {
                self.add(found);
            }
        }
    }

    /// Gates for the ball's colours, and how many of them count.
    fn gates(&self, in_a_crowd: bool) -> ([super::kernel::ColourGate; MAX_MODELS], usize) {
        let mut gates = [super::kernel::ColourGate::OPEN; MAX_MODELS];
        let mut count = 0;
        for gate in self.colour.gates(&self.light, in_a_crowd).take(MAX_MODELS) {
            gates[count] = gate;
            count += 1;
        }
        (gates, count)
    }

    /// Whether something large, or something that was no ball, moves.
    fn crowded(&self) -> bool {
        self.finder.saw_larger()
            || self.finder.blobs().iter().any(|blob| {
                blob.cells > CROWD_CELLS
                    && !self.found.iter().any(|f| f.item.score > 0.3 && covers(&f.item, centre_px(blob)))
            })
    }

    /// Looks for the ball's colours: among the marked cells of some columns and rows, or everywhere where no
    /// background is known.
    fn search_by_colour(
        &mut self,
        view: &FrameView<'_>,
        among: Option<(Range<usize>, Range<usize>)>,
        prior: &Prior,
    ) {
        let everywhere = among.is_none();
        let (columns, rows) = among.unwrap_or((0..view.width(), 0..view.height() & !1));
        let (gates, count) = self.gates(!everywhere);
        for gate in &gates[..count] {
            self.foreground.pass(view, gate, (&columns, &rows), everywhere, &mut self.coloured);
            self.finder.find(&self.coloured, self.foreground.words_per_row(), rows.start / 2..rows.end / 2);
            self.starts.clear();
            self.collect_starts(view);
            let (most, least) = if everywhere {
                (MAX_FITS_ALONE / count.max(1), 0.0)
            } else {
                (MAX_FITS_IN_CROWD, LIKELY_IN_CROWD)
            };
            self.measure_starts(view, Backdrop::Around, prior, most, least);
        }
    }

    /// Turns the finder's blobs into starts, the likeliest first.
    fn collect_starts(&mut self, view: &FrameView<'_>) {
        for blob in self.finder.blobs() {
            if !is_of_size(blob) {
                continue;
            }
            let centre = centre_px(blob).map(|c| self.grid.frame_px(c));
            if self.found.iter().any(|f| covers(&f.item, centre)) {
                continue;
            }
            if let Some(start) = self.start_of(view, blob, centre) {
                self.starts.push(start);
            }
        }
        self.starts.sort_unstable_by(|a, b| {
            b.rank()
                .total_cmp(&a.rank())
                .then(a.place.rectifier.anchor[0].total_cmp(&b.place.rectifier.anchor[0]))
        });
    }

    fn start_of(&self, view: &FrameView<'_>, blob: &Blob, centre: [f64; 2]) -> Option<Start> {
        let start = start(blob, self.grid.scale, &sphere::place(&self.camera, centre))?;
        if !self.blur.allows(&start.sweep, BlurLimit::OF_A_START) {
            return None;
        }
        let colour = if self.background.is_known() { self.glimpse(view, &start) } else { 1.0 };
        let slow = self.is_slow(&start);
        Some(Start { colour, slow, ..start })
    }

    /// How well a few cells of a start agree with the ball's colour, 0–1.
    fn glimpse(&self, view: &FrameView<'_>, start: &Start) -> f32 {
        // The share of the exposure for which the ball covers its path's middle.
        let cover = (2.0 * start.sweep.radius / start.sweep.length.max(0.1)).min(1.0);
        let (mut mean, mut count) = ([0.0; 3], 0.0);
        for place in start.inside() {
            let [x, y] = place.map(|p| self.grid.searched(p));
            let (Some(x), Some(y)) = (x, y) else { continue };
            if x + 1 >= view.width() || y + 1 >= view.height() {
                continue;
            }
            let seen = cell_colour(view, x, y);
            let behind = self.background.expected_colour(view.format(), x, y);
            for i in 0..3 {
                mean[i] += behind[i] + (seen[i] - behind[i]) / cover;
            }
            count += 1.0;
        }
        if count > 0.0 { self.colour.likeness(&self.light, mean.map(|m| m / count)) } else { 0.0 }
    }

    /// Measures the likeliest starts, `most` at most.
    fn measure_starts(
        &mut self,
        view: &FrameView<'_>,
        backdrop: Backdrop,
        prior: &Prior,
        most: usize,
        least_rank: f32,
    ) {
        let looks_at_slow = self.background.frames().is_multiple_of(SLOW_EVERY);
        let mut fits = 0;
        for i in 0..self.starts.len() {
            let start = self.starts[i];
            if start.rank() < least_rank {
                break;
            }
            if start.slow && !looks_at_slow && self.has_ball_in_flight() {
                self.rest.see(start.place.rectifier.anchor, 2.0 * f64::from(start.sweep.radius));
                continue;
            }
            let unlikely = start.rank() <= UNLIKELY;
            if unlikely && self.has_ball_in_play() {
                break;
            }
            let enough = if unlikely { MAX_UNLIKELY } else { most };
            if fits >= enough {
                break;
            }
            if self.found.iter().any(|f| covers(&f.item, start.place.rectifier.anchor)) {
                continue;
            }
            fits += 1;
            if let Some(found) = self.measure(view, &start, backdrop, prior) {
                self.add(found);
            }
        }
    }

    /// Measures one start; none where it does not look at all like a ball.
    fn measure(
        &mut self,
        view: &FrameView<'_>,
        start: &Start,
        backdrop: Backdrop,
        prior: &Prior,
    ) -> Option<Found> {
        let behind = match backdrop {
            Backdrop::Learnt => Behind::Learnt(&self.background),
            Backdrop::Around => Behind::Around(self.background.noise()),
        };
        let scene = Scene { view, grid: self.grid, behind };
        let glanced = scene.glance(&mut self.patch, start, prior, &self.towards_light)?;
        let likeness = self.colour.likeness(&self.light, glanced.verdict.levels);
        let glanced_score = score(&glanced, likeness);
        if glanced_score < LEAST_SCORE {
            return None;
        }
        let refined = glanced_score > WORTH_REFINING;
        let measured = if refined { scene.refine(&mut self.patch, glanced, prior) } else { glanced };
        if !self.blur.allows(&measured.fit.sweep, BlurLimit::OF_A_FIT) {
            return None;
        }
        let likeness = self.colour.likeness(&self.light, measured.verdict.levels);
        let score = match self.frame_noise {
            Some(noise) => {
                let light = measured.place.light(&measured.light);
                let rectifier = &measured.place.rectifier;
                let outline = Outline::look(view, self.grid, rectifier, &measured.fit, &light, noise)?;
                single_score(&measured, &outline, likeness, self.colour.diameter_px())
            }
            None => score(&measured, likeness),
        };
        let mut item = describe(&self.camera, &measured, score);
        if self.rest.is_at_rest([item.u_px, item.v_px], item.diameter_px) {
            item.flags |= DetectionFlags::AT_REST;
            item.score *= AT_REST_SHARE;
        }
        Some(Found { item, measured, likeness })
    }

    /// Whether one of the candidates is likely the ball in play.
    fn has_ball_in_play(&self) -> bool {
        self.found.iter().any(|f| self.is_in_play(&f.item))
    }

    /// Whether one of the candidates surely is a ball and has come from elsewhere faster than things roll.
    fn has_ball_in_flight(&self) -> bool {
        self.found.iter().any(|f| {
            f.item.score >= SURE && !self.rest.is_slow([f.item.u_px, f.item.v_px], f.item.diameter_px)
        })
    }

    /// Whether something was here in the last frame, or so near that no ball in flight takes so long.
    fn is_slow(&self, start: &Start) -> bool {
        self.rest.is_slow(start.place.rectifier.anchor, 2.0 * f64::from(start.sweep.radius))
    }

    /// Whether a candidate is likely the ball, and has not stayed where it is.
    fn is_in_play(&self, item: &Detection) -> bool {
        item.score >= SCORE_THRESHOLD
            && self.rest.frames_at([item.u_px, item.v_px], item.diameter_px) < FEW_FRAMES
    }

    /// Keeps a candidate unless a better one stands in its place.
    fn add(&mut self, new: Found) {
        if let Some(same) = self.found.iter_mut().find(|f| same_place(&f.item, &new.item)) {
            if new.item.score > same.item.score {
                *same = new;
            }
        } else if self.found.len() < self.found.capacity() {
            self.found.push(new);
        }
    }

    fn send(&mut self, header: &FrameHeader, scope: Scope, emit: &mut dyn FnMut(&Detections)) {
        let message = &mut *self.message;
        *message = Detections {
            trigger_id: header.trigger_id,
            sequence: header.sequence,
            session: header.session,
            stamps: header.stamps,
            exposure_ns: header.exposure_ns,
            camera: self.index,
            scope: scope.code(),
            ..Detections::default()
        };
        for found in &self.found {
            message.insert(found.item);
        }
        emit(message);
    }

    /// What the frame teaches for the next one.
    fn after(&mut self, view: &FrameView<'_>, window: Option<&SearchWindow>) {
        if self.options.single_frames {
            return;
        }
        self.kept.clear();
        for found in &self.found {
            let item = &found.item;
            let place = [item.u_px, item.v_px];
            let frames = self.rest.frames_at(place, item.diameter_px);
            self.rest.see(place, item.diameter_px);
            let area = self.pixel_box(item, view);
            if is_gone(&found.measured) {
                if frames >= 4 {
                    self.background.replace(view, &area);
                }
                continue;
            }
            if self.kept.len() < self.kept.capacity() && item.score > 0.15 {
                self.kept.push(area);
            }
        }
        if let Some(ball) = window.and_then(|window| self.surely_followed(window)) {
            self.colour.learn(ball.measured.verdict.levels);
            // Lamps hang here and there: a running mean over about ten balls.
            self.towards_light = (self.towards_light * 0.9 + ball.measured.light * 0.1).normalize();
        }
        self.background.learn(view, &self.kept);
    }

    /// The ball whose flight other cameras have seen, too, where it shows by itself what balls look like here. One
    /// camera alone takes a sleeve for a ball now and then, and would look for sleeves ever after.
    fn surely_followed(&self, window: &SearchWindow) -> Option<Found> {
        let best = self.found.iter().max_by(|a, b| a.item.score.total_cmp(&b.item.score))?;
        let Detection { u_px, v_px, diameter_px, score, .. } = best.item;
        let off_px = (u_px - window.u_px).hypot(v_px - window.v_px);
        let verdict = &best.measured.verdict;
        let expected = off_px < 0.5 * window.diameter_px && diameter_px < 1.5 * window.diameter_px;
        let clear = score > SURE && best.likeness > 0.25 && verdict.misfit < 0.15 && verdict.clutter < 0.2;
        let moves = self.rest.frames_at([u_px, v_px], diameter_px) <= 1;
        (expected && clear && moves).then_some(*best)
    }

    fn pixel_box(&self, item: &Detection, view: &FrameView<'_>) -> PixelBox {
        let x = self.grid.range(item.x0_px - 1.0, item.x1_px + 1.0, view.width());
        let y = self.grid.range(item.y0_px - 1.0, item.y1_px + 1.0, view.height());
        PixelBox { x0: x.start, y0: y.start, x1: x.end, y1: y.end }
    }
}

/// Whether a place lies in a candidate's box.
fn covers(item: &Detection, place: [f64; 2]) -> bool {
    (item.x0_px..=item.x1_px).contains(&place[0]) && (item.y0_px..=item.y1_px).contains(&place[1])
}

/// Whether two candidates are one thing.
fn same_place(a: &Detection, b: &Detection) -> bool {
    let reach = 0.35 * (a.diameter_px + b.diameter_px);
    (a.u_px - b.u_px).hypot(a.v_px - b.v_px) < reach
        || covers(a, [b.u_px, b.v_px])
        || covers(b, [a.u_px, a.v_px])
}
