use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
    sync::Arc,
};

use foxglove::{
    Decode as _,
    messages::{CameraCalibration, FrameTransform, FrameTransforms},
};
use netcord_common::{
    CameraName, PixelFormat,
    geometry::{Camera, Transform, World},
    wire::FrameHeader,
};

use super::{
    Channel, Ending, Item, MessageRef, Place, RawImage, RecordedCalibration, RecordedTruth, RecordingError,
    RecordingFile,
    calibration::{TABLE_FRAME, table_from_camera},
    fields,
};

/// The frames of a recording and what it says of its cameras, found in one pass over the file.
#[derive(Debug)]
pub struct Footage {
    file: RecordingFile,
    /// The cameras, in the order in which the file introduces their images.
    pub cameras: Vec<FilmedCamera>,
    /// What `/truth/ball` says, where there is one, in the order of time.
    pub truth: Vec<RecordedTruth>,
    /// The metadata record `netcord`; empty in recordings of others.
    pub metadata: BTreeMap<String, String>,
    /// How the file ends.
    pub ending: Ending,
}

/// One camera of a recording.
#[derive(Debug, Clone)]
pub struct FilmedCamera {
    /// Its name, from the topic `/camera/<name>/image`.
    pub name: CameraName,
    /// What `/camera/<name>/calibration` says; `None` without such a message.
    pub calibration: Option<RecordedCalibration>,
    /// What `/tf` says of its pose in the table frame.
    pub table_from_camera: Option<Transform<World, Camera>>,
    /// Its frames, by their stamps; no two have the same.
    pub frames: Vec<FilmedFrame>,
    /// Frames that were left out, because another had the same stamp.
    pub duplicates: u64,
}

/// One frame of a recording.
#[derive(Debug, Clone)]
pub struct FilmedFrame {
    /// Middle of the exposure, ns, as the image says.
    pub stamp_ns: u64,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from one row to the next.
    pub step: u32,
    /// The mosaic.
    pub format: PixelFormat,
    /// Where the pixels lie.
    pub pixels: Place,
    /// What `/camera/<name>/header` says, in our own recordings.
    pub header: Option<FrameHeader>,
}

/// The name of the metadata record that our own recordings have.
pub const METADATA: &str = "netcord";

/// The topic of a camera's `kind` of messages.
pub fn camera_topic(camera: &CameraName, kind: &str) -> String {
    format!("/camera/{camera}/{kind}")
}

impl Footage {
    /// Reads what the file says of its frames; the pixels stay where they are.
    ///
    /// # Errors
    /// [`RecordingError`] names the topic and message that is not as it should be.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = RecordingFile::open(path)?;
        let mut gathering = Gathering::new(path);
        let mut metadata = BTreeMap::new();
        let ending = file.visit(&mut |item| match item {
            Item::Message(message) => gathering.message(&message),
            Item::Metadata { name, entries } => {
                if name == METADATA {
                    metadata.clone_from(entries);
                }
                Ok(())
            }
        })?;
        let (cameras, truth) = gathering.finish()?;
        Ok(Self { file, cameras, truth, metadata, ending })
    }

    /// The file.
    pub const fn file(&self) -> &RecordingFile {
        &self.file
    }

    /// The middle of the intervals between frames of one camera, ns; `None` where no camera has two.
    pub fn interval_ns(&self) -> Option<u64> {
        let stamps = |camera: &FilmedCamera| camera.frames.iter().map(|f| f.stamp_ns).collect::<Vec<_>>();
        let mut intervals = self
            .cameras
            .iter()
            .map(stamps)
            .flat_map(|stamps| stamps.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<_>>())
            .collect::<Vec<_>>();
        intervals.sort_unstable();
        intervals.get(intervals.len() / 2).copied()
    }
}

struct Gathering<'a> {
    path: &'a Path,
    cameras: Vec<FilmedCamera>,
    /// Poses by the name of the child frame.
    transforms: HashMap<String, Transform<World, Camera>>,
    headers: HashMap<CameraName, HashMap<u64, FrameHeader>>,
    calibrations: HashMap<CameraName, RecordedCalibration>,
    frame_ids: HashMap<CameraName, String>,
    truth: BTreeMap<u64, RecordedTruth>,
    topics: HashMap<u16, Topic>,
}

#[derive(Debug, Clone)]
enum Topic {
    Image(CameraName),
    Header(CameraName),
    Calibration(CameraName),
    Transforms,
    Truth,
    Other,
}

impl<'a> Gathering<'a> {
    fn new(path: &'a Path) -> Self {
        Self {
            path,
            cameras: Vec::new(),
            transforms: HashMap::new(),
            headers: HashMap::new(),
            calibrations: HashMap::new(),
            frame_ids: HashMap::new(),
            truth: BTreeMap::new(),
            topics: HashMap::new(),
        }
    }

    fn message(&mut self, message: &MessageRef<'_>) -> Result<(), RecordingError> {
        let topic = match self.topics.get(&message.channel.id) {
            Some(topic) => topic.clone(),
            None => {
                let topic = self.topic(message.channel)?;
                self.topics.insert(message.channel.id, topic.clone());
                topic
            }
        };
        let wrong = |why: String| RecordingError::Message {
            path: self.path.to_owned(),
            topic: message.channel.topic.clone(),
            index: message.index,
            why,
        };
        match topic {
            Topic::Image(name) => {
                let image = RawImage::parse(message.data).map_err(wrong)?;
                self.image(&name, image, message)?;
            }
            Topic::Header(name) => {
                let header: FrameHeader = fields::decode(message.data)
                    .map_err(|e| wrong(format!("it is no netcord.FrameHeader: {e}")))?;
                self.headers.entry(name).or_default().insert(header.stamps.mid_exposure_ns, header);
            }
            // The first counts: results must not depend on what comes after them.
            Topic::Calibration(name) if self.calibrations.contains_key(&name) => {}
            Topic::Calibration(name) => {
                let calibration = CameraCalibration::decode(message.data)
                    .map_err(|e| format!("it is no foxglove.CameraCalibration: {e}"))
                    .and_then(|m| RecordedCalibration::parse(&m))
                    .map_err(wrong)?;
                self.calibrations.insert(name, calibration);
            }
            Topic::Transforms => self.transforms(message).map_err(wrong)?,
            Topic::Truth => {
                let truth: RecordedTruth = serde_json::from_slice(message.data)
                    .map_err(|e| wrong(format!("it is no truth of a ball in JSON: {e}")))?;
                self.truth.insert(truth.t_ns, truth);
            }
            Topic::Other => {}
        }
        Ok(())
    }

    fn topic(&self, channel: &Arc<Channel>) -> Result<Topic, RecordingError> {
        let needs = |schemas: &[&str], encoding: &str| {
            let (schema, written) = (channel.schema_name.as_str(), channel.message_encoding.as_str());
            if written != encoding {
                return Err(
                    self.channel(channel, format!("its messages are {written:?}; {encoding} is needed"))
                );
            }
            if !schema.is_empty() && !schemas.contains(&schema) {
                let valid = schemas.join(" or ");
                return Err(self.channel(channel, format!("its schema is {schema:?}; {valid} is needed")));
            }
            Ok(())
        };
        match channel.topic.as_str() {
            "/tf" => needs(&["foxglove.FrameTransform", "foxglove.FrameTransforms"], "protobuf")
                .map(|()| Topic::Transforms),
            "/truth/ball" if channel.message_encoding == "json" => Ok(Topic::Truth),
            topic => {
                let Some((name, kind)) =
                    topic.strip_prefix("/camera/").and_then(|rest| rest.rsplit_once('/'))
                else {
                    return Ok(Topic::Other);
                };
                let name = || CameraName::new(name).map_err(|e| self.channel(channel, e.to_string()));
                match kind {
                    "image" => {
                        needs(&["foxglove.RawImage"], "protobuf")?;
                        name().map(Topic::Image)
                    }
                    "calibration" => {
                        needs(&["foxglove.CameraCalibration"], "protobuf")?;
                        name().map(Topic::Calibration)
                    }
                    "header" if channel.schema_name == "netcord.FrameHeader" => name().map(Topic::Header),
                    _ => Ok(Topic::Other),
                }
            }
        }
    }

    fn image(
        &mut self,
        name: &CameraName,
        image: RawImage,
        message: &MessageRef<'_>,
    ) -> Result<(), RecordingError> {
        let camera = match self.cameras.iter().position(|c| c.name == *name) {
            Some(place) => &mut self.cameras[place],
            None => {
                self.frame_ids.insert(name.clone(), image.frame_id.clone());
                self.cameras.push(FilmedCamera {
                    name: name.clone(),
                    calibration: None,
                    table_from_camera: None,
                    frames: Vec::new(),
                    duplicates: 0,
                });
                self.cameras.last_mut().expect("just pushed")
            }
        };
        if let Some(first) = camera.frames.first()
            && (first.width, first.height, first.format) != (image.width, image.height, image.format)
        {
            return Err(RecordingError::Message {
                path: self.path.to_owned(),
                topic: message.channel.topic.clone(),
                index: message.index,
                why: format!(
                    "it is {} × {} {}, but the images before it are {} × {} {}; one camera's must be alike",
                    image.width, image.height, image.format, first.width, first.height, first.format
                ),
            });
        }
        camera.frames.push(FilmedFrame {
            stamp_ns: image.timestamp_ns,
            width: image.width,
            height: image.height,
            step: image.step,
            format: image.format,
            pixels: message.place.part(image.data),
            header: None,
        });
        Ok(())
    }

    fn transforms(&mut self, message: &MessageRef<'_>) -> Result<(), String> {
        let broken = |e| format!("it is no {}: {e}", message.channel.schema_name);
        let transforms = if message.channel.schema_name == "foxglove.FrameTransforms" {
            FrameTransforms::decode(message.data).map_err(broken)?.transforms
        } else {
            vec![FrameTransform::decode(message.data).map_err(broken)?]
        };
        for transform in transforms {
            if transform.parent_frame_id == TABLE_FRAME
                && !self.transforms.contains_key(&transform.child_frame_id)
            {
                let pose = table_from_camera(&transform)
                    .map_err(|why| format!("the transform of {:?}: {why}", transform.child_frame_id))?;
                self.transforms.insert(transform.child_frame_id, pose);
            }
        }
        Ok(())
    }

    fn finish(mut self) -> Result<(Vec<FilmedCamera>, Vec<RecordedTruth>), RecordingError> {
        if self.cameras.is_empty() {
            return Err(RecordingError::Content {
                path: self.path.to_owned(),
                why: "it has no images; messages of foxglove.RawImage on /camera/<name>/image are needed"
                    .into(),
            });
        }
        for camera in &mut self.cameras {
            camera.frames.sort_by_key(|f| f.stamp_ns);
            let before = camera.frames.len();
            camera.frames.dedup_by_key(|f| f.stamp_ns);
            camera.duplicates = (before - camera.frames.len()) as u64;
            if let Some(headers) = self.headers.get(&camera.name) {
                camera.frames.iter_mut().for_each(|f| f.header = headers.get(&f.stamp_ns).copied());
            }
            camera.calibration = self.calibrations.remove(&camera.name);
            let by_calibration = camera.calibration.as_ref().map(|c| c.frame_id.as_str());
            let by_image = self.frame_ids.get(&camera.name).map(String::as_str);
            camera.table_from_camera = [Some(camera.name.as_str()), by_calibration, by_image]
                .into_iter()
                .flatten()
                .find_map(|id| self.transforms.get(id).copied());
            check_size(self.path, camera)?;
        }
        Ok((self.cameras, self.truth.into_values().collect()))
    }

    fn channel(&self, channel: &Channel, why: String) -> RecordingError {
        RecordingError::Channel { path: self.path.to_owned(), topic: channel.topic.clone(), why }
    }
}

fn check_size(path: &Path, camera: &FilmedCamera) -> Result<(), RecordingError> {
    let (Some(calibration), Some(frame)) = (&camera.calibration, camera.frames.first()) else {
        return Ok(());
    };
    let model = &calibration.model;
    if (model.width, model.height) == (frame.width, frame.height) {
        return Ok(());
    }
    Err(RecordingError::Channel {
        path: path.to_owned(),
        topic: camera_topic(&camera.name, "calibration"),
        why: format!(
            "it is for images of {} × {}, but those of the recording are {} × {}",
            model.width, model.height, frame.width, frame.height
        ),
    })
}
