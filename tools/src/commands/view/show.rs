use std::time::{Duration, Instant};

use foxglove::{
    Channel, ChannelBuilder, RawChannel, Schema,
    messages::{CameraCalibration, FrameTransform, ImageAnnotations, RawImage, SceneUpdate},
};
use netcord_capture::recording::{camera_topic, transform_message};
use netcord_common::{
    FrameView,
    bus::{BusError, FrameSubscriber, Subscriber, Topic},
    rig::{Rig, RigCamera},
    wire::{Detections, Scope, SearchWindow, WorldFrame},
};
use serde::Serialize;

use super::preview::{Preview, PreviewOptions};
use crate::{
    observer::{FrameReport, LatencyReport, Observed, Observer, Tally},
    recording::{BALL_TOPIC, PATH_TOPIC, Scene, TABLE_TOPIC, annotations, world_frame_id},
    stage::Stage,
};

/// What does not change, and statistics, are sent this often: a viewer that comes late waits no longer.
const EVERY: Duration = Duration::from_secs(1);

/// Sends what a rig does to viewers.
pub(super) struct Show {
    rig: Rig,
    cameras: Vec<CameraShow>,
    observer: Observer,
    scene: Scene,
    table: Channel<SceneUpdate>,
    ball: Channel<SceneUpdate>,
    path: Channel<SceneUpdate>,
    transforms: Channel<FrameTransform>,
    statistics: std::sync::Arc<RawChannel>,
    preview_every: Duration,
}

struct CameraShow {
    frames: FrameSubscriber,
    windows: Subscriber<SearchWindow>,
    window: Option<SearchWindow>,
    /// The newest detections; sent with the picture that they belong to, or the next.
    detections: Option<Detections>,
    preview: Preview,
    image: Channel<RawImage>,
    calibration: Channel<CameraCalibration>,
    annotations: Channel<ImageAnnotations>,
    shown: Option<Instant>,
}

/// Latencies, rates and losses of the last second, for plots.
#[derive(Debug, Serialize)]
struct Statistics {
    rate_hz: Option<f64>,
    latency_ms: LatencyReport,
    frames: FrameReport,
}

impl Show {
    pub(super) fn attach(stage: &Stage, options: PreviewOptions) -> Result<Self, BusError> {
        let (bus, rig) = (&stage.bus, &stage.rig);
        let camera = |camera: &RigCamera| {
            let topic = |kind| camera_topic(&camera.name, kind);
            Ok(CameraShow {
                // One frame waits, the newest: pictures are rare.
                frames: FrameSubscriber::open(bus, &Topic::frames(&camera.name), 1)?,
                windows: bus.subscriber(&Topic::window(&camera.name))?,
                window: None,
                detections: None,
                preview: Preview::new(camera, options.width),
                image: ChannelBuilder::new(topic("image")).build(),
                calibration: ChannelBuilder::new(topic("calibration")).build(),
                annotations: ChannelBuilder::new(topic("annotations")).build(),
                shown: None,
            })
        };
        let statistics = ChannelBuilder::new("/statistics")
            .message_encoding("json")
            .schema(Schema::new("netcord.Statistics", "jsonschema", br#"{"type": "object"}"#.as_slice()))
            .build_raw()
            .expect("it has an encoding");
        Ok(Self {
            rig: rig.clone(),
            cameras: rig.cameras.iter().map(camera).collect::<Result<_, BusError>>()?,
            observer: Observer::attach(bus, rig)?,
            scene: Scene::new(rig),
            table: ChannelBuilder::new(TABLE_TOPIC).build(),
            ball: ChannelBuilder::new(BALL_TOPIC).build(),
            path: ChannelBuilder::new(PATH_TOPIC).build(),
            transforms: ChannelBuilder::new("/tf").build(),
            statistics,
            preview_every: Duration::from_secs_f64(1.0 / options.rate_hz),
        })
    }

    /// Until the end is asked for.
    pub(super) fn run(&mut self, stage: &Stage) -> Result<(), BusError> {
        stage.counters.set_state(netcord_common::wire::ProcessState::Running);
        let mut tally = Tally::default();
        let mut newest_ns = 0;
        let mut stood: Option<Instant> = None;
        while !stage.stop.is_requested() {
            std::thread::sleep(self.observer.interval());
            self.observe(&mut tally, &mut newest_ns)?;
            for (camera, rig_camera) in self.cameras.iter_mut().zip(&self.rig.cameras) {
                camera.show(rig_camera, self.preview_every)?;
            }
            if newest_ns > 0 && stood.is_none_or(|at| at.elapsed() >= EVERY) {
                self.stand(newest_ns);
                self.send_statistics(&std::mem::take(&mut tally), newest_ns);
                stood = Some(Instant::now());
            }
        }
        Ok(())
    }

    /// Ball and path go out as they come; boxes wait for their picture.
    fn observe(&mut self, tally: &mut Tally, newest_ns: &mut u64) -> Result<(), BusError> {
        let Self { observer, scene, ball: ball_channel, path: path_channel, cameras, .. } = self;
        observer.drain(&mut |seen| {
            tally.see(&seen);
            match seen {
                Observed::Position(position) => {
                    let stamp_ns = position.stamps.mid_exposure_ns;
                    *newest_ns = stamp_ns;
                    if let Some(ball) = scene.ball(position) {
                        ball_channel.log_with_time(&ball, stamp_ns);
                    }
                }
                Observed::Trajectory(trajectory) => {
                    if let Some(path) = scene.path(trajectory) {
                        path_channel.log_with_time(&path, trajectory.stamps.mid_exposure_ns);
                    }
                }
                Observed::Detections(detections) if detections.scope == Scope::Full.code() => {
                    if let Some(camera) = cameras.get_mut(detections.camera as usize) {
                        camera.detections = Some(*detections);
                    }
                }
                _ => {}
            }
        })
    }

    /// Table, poses and calibration.
    fn stand(&self, stamp_ns: u64) {
        if let Some(table) = self.scene.table(stamp_ns) {
            self.table.log_with_time(&table, stamp_ns);
        }
        let parent = world_frame_id(&self.rig);
        for (camera, rig_camera) in self.cameras.iter().zip(&self.rig.cameras) {
            let calibration = camera.preview.calibration(rig_camera, stamp_ns);
            camera.calibration.log_with_time(&calibration, stamp_ns);
            if self.rig.world == WorldFrame::Table || rig_camera.index.get() != 0 {
                let name = rig_camera.name.as_str();
                let transform = transform_message(stamp_ns, &parent, name, &rig_camera.camera_from_world);
                self.transforms.log_with_time(&transform, stamp_ns);
            }
        }
    }

    fn send_statistics(&self, tally: &Tally, stamp_ns: u64) {
        let statistics =
            Statistics { rate_hz: tally.rate_hz(), latency_ms: tally.latencies(), frames: tally.frames() };
        let json = serde_json::to_vec(&statistics).expect("numbers and names are always JSON");
        let metadata = foxglove::PartialMetadata { log_time: Some(stamp_ns) };
        self.statistics.log_with_meta(&json, metadata);
    }
}

impl CameraShow {
    fn show(&mut self, camera: &RigCamera, every: Duration) -> Result<(), BusError> {
        if let Some(window) = self.windows.receive_newest()? {
            self.window = Some(window);
        }
        let is_due = self.shown.is_none_or(|at| at.elapsed() >= every);
        if !is_due || !(self.image.has_sinks() || self.annotations.has_sinks()) {
            return Ok(());
        }
        // The frame that waits may be an old one, kept since the last picture; the next is fresh.
        let Some(frame) = self.frames.receive()? else { return Ok(()) };
        let Ok(view) = FrameView::of(frame.header(), frame.bytes()) else { return Ok(()) };
        let stamp_ns = frame.header().stamps.mid_exposure_ns;
        let picture = self.preview.picture(frame.header(), &view, camera.name.as_str());
        self.image.log_with_time(&picture, stamp_ns);
        if let Some(detections) = &self.detections {
            let window = self.window.map(|window| self.preview.window(&window));
            let mut boxes = annotations(&self.preview.detections(detections), window.as_ref());
            boxes.timestamp = picture.timestamp;
            self.annotations.log_with_time(&boxes, stamp_ns);
        }
        self.shown = Some(Instant::now());
        Ok(())
    }
}
