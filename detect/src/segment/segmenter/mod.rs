mod found;
mod frame;
mod lessons;
mod starts;
mod window;

use nalgebra::Vector3;
use netcord_common::{
    FrameView, PixelFormat,
    camera::CameraModel,
    rig::Rig,
    wire::{Detections, FrameHeader, MAX_DETECTIONS, Scope, SearchWindow, WorldFrame},
};

use self::{
    found::Found,
    frame::{MAX_FITS, MAX_FITS_ALONE},
};
use super::{
    appearance::Appearance,
    background::{Background, PixelBox},
    blobs::{BlobFinder, MAX_BLOBS},
    blur::BlurLimit,
    candidate::{Start, most_cells},
    colour::{ColourModel, SceneLight},
    demosaic::Demosaic,
    foreground::Foreground,
    grid::Grid,
    kernel::Kernel,
    options::{InputMode, SegmentError, SegmentOptions},
    patch::Patch,
    rest::RestWatch,
    score::SCORE_THRESHOLD,
    singles::SingleFinder,
    size::BallSize,
};

/// Frames between two looks at the colour of the scene's light.
const LIGHT_EVERY: u64 = 64;

/// Finds the ball in one camera's frames.
///
/// Pure: it reads no clock and does no input or output; the same frames give the same bytes. After the
/// first frame it allocates nothing, unless each frame stands for itself.
#[derive(Debug)]
pub struct Segmenter {
    name: String,
    index: u32,
    camera: CameraModel,
    ball: BallSize,
    /// The vertical, in the camera's frame.
    up: Vector3<f64>,
    /// What balls have in common: at first the main light comes from above.
    appearance: Appearance,
    /// Whether a ball has been found where its flight was expected.
    has_followed: bool,
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
        let ball = BallSize::of(rig, camera);
        let kernel = Kernel::detect();
        let background = Background::new(kernel, size, rig.rate_hz);
        let foreground = Foreground::new(kernel, size);
        let up = match rig.world {
            WorldFrame::Table => Vector3::z(),
            // A camera is seldom on its head.
            WorldFrame::FirstCamera => -Vector3::y(),
        };
        let up = camera.camera_from_world.rotation * up;
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
            up,
            appearance: Appearance::new(up),
            has_followed: false,
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
            finder: BlobFinder::new(most_cells(&ball)),
            ball,
            singles,
            frame_noise: None,
            starts: Vec::with_capacity(MAX_BLOBS),
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
        let expected = window.is_some_and(|window| self.has_expected(window));
        self.search_frame(view, expected, window.is_some());
        self.send(header, Scope::Full, emit);
        self.after(view, window);
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
}
