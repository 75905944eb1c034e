use foxglove::messages::{
    CameraCalibration, FrameTransform, ImageAnnotations, RawImage as RawImageMessage, SceneUpdate,
};
use netcord_capture::recording::{
    ChannelId, RawImage, RecordedTruth, RecordingError, RecordingWriter, calibration_message, camera_topic,
    encode, transform_message,
};
use netcord_common::{
    PixelFormat,
    rig::{CameraIndex, Rig},
    wire::{BallPosition, BallTrajectory, Detections, FrameHeader, Scope, SearchWindow, WorldFrame},
};

use super::{
    Scene,
    annotations::annotations,
    scene::{BALL_TOPIC, PATH_TOPIC, TABLE_TOPIC, world_frame_id},
    schemas::{bytes_of, foxglove_schema, netcord_schema, truth_schema},
};

/// Writes a rig's messages to the topics on which viewers look for them. What `netcord record` and
/// `netcord process` write is therefore the same.
#[derive(Debug)]
pub struct RigTopics {
    cameras: Vec<CameraTopics>,
    position: ChannelId,
    trajectory: ChannelId,
    /// Table, ball and path have a topic each: who jumps to an instant gets the last message of every topic.
    table: ChannelId,
    ball: ChannelId,
    path: ChannelId,
    transforms: ChannelId,
    truth: Option<ChannelId>,
    scene: Scene,
    rig: Rig,
    /// The stamp at which what does not change was last written.
    stood_ns: Option<u64>,
}

/// What does not change is written this often, ns: who jumps into a recording, or lets it begin again, needs no message
/// from its beginning, and waits no longer.
const STAND_EVERY_NS: u64 = 1_000_000_000;

#[derive(Debug)]
struct CameraTopics {
    name: String,
    image: Option<ChannelId>,
    header: Option<ChannelId>,
    calibration: ChannelId,
    detections: ChannelId,
    annotations: ChannelId,
}

/// Which topics a recording has beside those that every one has.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// Images and headers.
    pub images: bool,
    /// The truth of a synthetic source.
    pub truth: bool,
}

impl RigTopics {
    /// Adds all channels to `writer`.
    pub fn new<P: AsRef<[u8]>>(writer: &mut RecordingWriter<P>, rig: &Rig, wanted: Wanted) -> Self {
        let cameras = rig
            .cameras
            .iter()
            .map(|camera| {
                let topic = |kind| camera_topic(&camera.name, kind);
                let image = |writer: &mut RecordingWriter<P>| {
                    writer.channel(&topic("image"), &foxglove_schema::<RawImageMessage>())
                };
                let image = wanted.images.then(|| image(writer));
                let header =
                    wanted.images.then(|| writer.channel(&topic("header"), &netcord_schema::<FrameHeader>()));
                CameraTopics {
                    name: camera.name.to_string(),
                    image,
                    header,
                    calibration: writer
                        .channel(&topic("calibration"), &foxglove_schema::<CameraCalibration>()),
                    detections: writer.channel(&topic("detections"), &netcord_schema::<Detections>()),
                    annotations: writer
                        .channel(&topic("annotations"), &foxglove_schema::<ImageAnnotations>()),
                }
            })
            .collect();
        Self {
            cameras,
            position: writer.channel("/ball/position", &netcord_schema::<BallPosition>()),
            trajectory: writer.channel("/ball/trajectory", &netcord_schema::<BallTrajectory>()),
            table: writer.channel(TABLE_TOPIC, &foxglove_schema::<SceneUpdate>()),
            ball: writer.channel(BALL_TOPIC, &foxglove_schema::<SceneUpdate>()),
            path: writer.channel(PATH_TOPIC, &foxglove_schema::<SceneUpdate>()),
            transforms: writer.channel("/tf", &foxglove_schema::<FrameTransform>()),
            truth: wanted.truth.then(|| writer.channel("/truth/ball", &truth_schema())),
            scene: Scene::new(rig),
            rig: rig.clone(),
            stood_ns: None,
        }
    }

    /// What does not change: calibration, poses, table. To be called before all that is of `stamp_ns`; it is written
    /// at first, and then once a second.
    ///
    /// # Errors
    /// As [`RecordingWriter::write`], here and below.
    pub fn stand<P: AsRef<[u8]>>(
        &mut self,
        writer: &mut RecordingWriter<P>,
        stamp_ns: u64,
    ) -> Result<(), RecordingError> {
        // Stamps of cameras and stages interleave, and those of a looped replay may start again.
        if self.stood_ns.is_some_and(|at| stamp_ns.abs_diff(at) < STAND_EVERY_NS) {
            return Ok(());
        }
        self.stood_ns = Some(stamp_ns);
        let parent = world_frame_id(&self.rig);
        for (topics, camera) in self.cameras.iter().zip(&self.rig.cameras) {
            let calibration = calibration_message(stamp_ns, &topics.name, &camera.model);
            writer.write(topics.calibration, stamp_ns, &bytes_of(&calibration), None)?;
            // Without a table the first camera is the world itself.
            if self.rig.world == WorldFrame::Table || camera.index.get() != 0 {
                let transform = transform_message(stamp_ns, &parent, &topics.name, &camera.camera_from_world);
                writer.write(self.transforms, stamp_ns, &bytes_of(&transform), None)?;
            }
        }
        match self.scene.table(stamp_ns) {
            Some(table) => writer.write(self.table, stamp_ns, &bytes_of(&table), None),
            None => Ok(()),
        }
    }

    /// A frame and its header. `pixels` are those of the whole frame, row by row.
    pub fn frame<P: AsRef<[u8]>>(
        &self,
        writer: &mut RecordingWriter<P>,
        header: &FrameHeader,
        format: PixelFormat,
        pixels: P,
    ) -> Result<(), RecordingError> {
        let topics = &self.cameras[header.camera as usize];
        let stamp_ns = header.stamps.mid_exposure_ns;
        if let (Some(image), Some(head)) = (topics.image, topics.header) {
            let description = RawImage {
                timestamp_ns: stamp_ns,
                frame_id: topics.name.clone(),
                width: header.width,
                height: header.height,
                step: header.stride,
                format,
                data: 0..pixels.as_ref().len(),
            };
            writer.write(head, stamp_ns, &encode(header), None)?;
            writer.write(image, stamp_ns, &description.head(), Some(pixels))?;
        }
        Ok(())
    }

    /// What was found in a frame; boxes are drawn once for each frame.
    pub fn detections<P: AsRef<[u8]>>(
        &self,
        writer: &mut RecordingWriter<P>,
        camera: CameraIndex,
        detections: &Detections,
        window: Option<&SearchWindow>,
    ) -> Result<(), RecordingError> {
        let topics = &self.cameras[camera.get()];
        let stamp_ns = detections.stamps.mid_exposure_ns;
        writer.write(topics.detections, stamp_ns, &encode(detections), None)?;
        if detections.scope != Scope::Full.code() {
            return Ok(());
        }
        writer.write(topics.annotations, stamp_ns, &bytes_of(&annotations(detections, window)), None)
    }

    /// A position, and the ball in the scene.
    pub fn position<P: AsRef<[u8]>>(
        &mut self,
        writer: &mut RecordingWriter<P>,
        position: &BallPosition,
    ) -> Result<(), RecordingError> {
        let stamp_ns = position.stamps.mid_exposure_ns;
        writer.write(self.position, stamp_ns, &encode(position), None)?;
        match self.scene.ball(position) {
            Some(ball) => writer.write(self.ball, stamp_ns, &bytes_of(&ball), None),
            None => Ok(()),
        }
    }

    /// A trajectory, and its path in the scene.
    pub fn trajectory<P: AsRef<[u8]>>(
        &self,
        writer: &mut RecordingWriter<P>,
        trajectory: &BallTrajectory,
    ) -> Result<(), RecordingError> {
        let stamp_ns = trajectory.stamps.mid_exposure_ns;
        writer.write(self.trajectory, stamp_ns, &encode(trajectory), None)?;
        match self.scene.path(trajectory) {
            Some(path) => writer.write(self.path, stamp_ns, &bytes_of(&path), None),
            None => Ok(()),
        }
    }

    /// What the synthetic source knows.
    pub fn truth<P: AsRef<[u8]>>(
        &self,
        writer: &mut RecordingWriter<P>,
        truth: &RecordedTruth,
    ) -> Result<(), RecordingError> {
        let Some(channel) = self.truth else { return Ok(()) };
        let json = serde_json::to_vec(truth).expect("a map of numbers is always JSON");
        writer.write(channel, truth.t_ns, &json, None)
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, path::Path};

    use netcord_capture::recording::WriterOptions;

    use super::*;

    /// Who jumps into the middle of a recording, or lets it begin again, has table, poses and lenses within a second.
    #[test]
    fn what_does_not_change_is_written_once_a_second() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-2cam.toml");
        let rig = Rig::load(&file).expect("the example is valid");
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("out.mcap");
        let mut writer =
            RecordingWriter::<Vec<u8>>::create(&path, WriterOptions::default()).expect("created");
        let mut topics = RigTopics::new(&mut writer, &rig, Wanted { images: false, truth: false });
        // 3.2 s at 50 Hz of two cameras, whose stamps differ a little; then from the start again.
        let lap = (0..160_u64).flat_map(|n| [n * 20_000_000 + 500, n * 20_000_000]);
        for t_ns in lap.clone().chain(lap) {
            topics.stand(&mut writer, 1_000_000_000 + t_ns).expect("written");
        }
        writer.finish().expect("written");

        let bytes = std::fs::read(&path).expect("written");
        let mut counts: BTreeMap<String, usize> = BTreeMap::new();
        for message in mcap::MessageStream::new(&bytes).expect("a recording") {
            *counts.entry(message.expect("whole").channel.topic.clone()).or_default() += 1;
        }
        let expected = [("/camera/left/calibration", 8), ("/camera/right/calibration", 8)];
        let expected = expected.into_iter().chain([("/scene/table", 8), ("/tf", 16)]);
        assert_eq!(counts, expected.map(|(topic, n)| (topic.to_owned(), n)).collect());
    }
}
