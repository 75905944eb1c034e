use std::{
    borrow::Cow,
    collections::BTreeMap,
    fs::File,
    ops::Range,
    path::{Path, PathBuf},
    sync::Arc,
};

use mcap::records::{Record, op};
use memmap2::Mmap;

use super::{RecordingError, chunk};

/// An MCAP file in memory (mapped), read from front to end without its index: so that files without
/// one, and files that were cut off, are read like any other.
#[derive(Debug)]
pub struct RecordingFile {
    path: PathBuf,
    map: Mmap,
}

/// What a file says of one channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Its id in the file.
    pub id: u16,
    /// Its topic.
    pub topic: String,
    /// `protobuf`, `json`, ….
    pub message_encoding: String,
    /// The schema's name; empty when there is none.
    pub schema_name: String,
    /// The schema's encoding.
    pub schema_encoding: String,
    /// The schema itself.
    pub schema: Vec<u8>,
}

/// Where bytes of a recording lie.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// In the file as they are: in no chunk, or in one that is not compressed.
    File(Range<usize>),
    /// In the unpacked bytes of a compressed chunk.
    Chunk {
        /// Where the chunk's record begins in the file.
        chunk: u64,
        /// Where in its unpacked bytes.
        range: Range<usize>,
    },
}

impl Place {
    /// How many bytes.
    pub fn len(&self) -> usize {
        match self {
            Self::File(range) | Self::Chunk { range, .. } => range.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The place of a part of these bytes.
    pub fn part(&self, part: Range<usize>) -> Self {
        let within = |whole: &Range<usize>| whole.start + part.start..whole.start + part.end;
        match self {
            Self::File(range) => Self::File(within(range)),
            Self::Chunk { chunk, range } => Self::Chunk { chunk: *chunk, range: within(range) },
        }
    }
}

/// One message, while it is being visited.
#[derive(Debug)]
pub struct MessageRef<'a> {
    /// Its channel.
    pub channel: &'a Arc<Channel>,
    /// Its place in the channel, from 0.
    pub index: u64,
    /// The writer's count.
    pub sequence: u32,
    /// When it was recorded, ns.
    pub log_time_ns: u64,
    /// When it was published, ns.
    pub publish_time_ns: u64,
    /// The message.
    pub data: &'a [u8],
    /// Where the message lies.
    pub place: Place,
}

/// What a visit comes across.
#[derive(Debug)]
pub enum Item<'a> {
    /// A message.
    Message(MessageRef<'a>),
    /// A metadata record.
    Metadata {
        /// Its name.
        name: &'a str,
        /// Its entries.
        entries: &'a BTreeMap<String, String>,
    },
}

/// How a recording ends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// With everything that a closed file has.
    Whole,
    /// In the middle; all that stands before was visited.
    CutOff {
        /// The byte up to which the file is whole.
        at: u64,
        /// What is there instead of more.
        why: String,
    },
}

/// Chunks that are unpacked at the same time: enough for the cores of today, and no more memory than
/// some dozen frames.
const CHUNKS_AHEAD: usize = 8;

/// Length of a record's head: its opcode and the length of its body.
const RECORD_HEAD: usize = 9;

impl RecordingFile {
    /// Maps a file that begins as an MCAP file does.
    ///
    /// # Errors
    /// [`RecordingError::File`] and [`RecordingError::NoMcap`].
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let failed = |doing| move |cause| RecordingError::File { doing, path: path.to_owned(), cause };
        let file = File::open(path).map_err(failed("open"))?;
        // SAFETY: the map is only read. A file that someone changes while it is mapped would change
        // under this process, or end it where it shrinks; recordings are written once.
        let map = unsafe { Mmap::map(&file) }.map_err(failed("map"))?;
        if !map.starts_with(mcap::MAGIC) {
            let head = &map[..map.len().min(8)];
            let found = if head.is_empty() {
                "nothing (it is empty)".into()
            } else {
                head.iter().map(|b| format!("{b:02X}")).collect::<Vec<_>>().join(" ")
            };
            return Err(RecordingError::NoMcap { path: path.to_owned(), found });
        }
        Ok(Self { path: path.to_owned(), map })
    }

    /// The file's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// All bytes of the file.
    pub fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// Visits all messages and metadata in the order in which they stand. Compressed chunks are
    /// unpacked on all cores, ahead of the visit.
    ///
    /// # Errors
    /// What `visit` returns, and [`RecordingError::Damaged`] for damage in the middle of the file. A
    /// file that just ends too early is no error, but an [`Ending`].
    pub fn visit(
        &self,
        visit: &mut dyn FnMut(Item<'_>) -> Result<(), RecordingError>,
    ) -> Result<Ending, RecordingError> {
        let mut channels = Channels::default();
        let mut waiting = Vec::new();
        let mut at = mcap::MAGIC.len();
        let ending = loop {
            let (opcode, body) = match record_at(&self.map, at) {
                Some(record) => record,
                None => {
                    // A chunk may be cut off in its middle and still hold whole messages.
                    if let Some(cut) = chunk::Packed::cut_off(&self.map, at) {
                        waiting.push(cut);
                    }
                    break Ending::CutOff { at: at as u64, why: why_cut(&self.map, at) };
                }
            };
            match opcode {
                op::CHUNK => {
                    waiting.push(
                        chunk::Packed::whole(&self.map, at, &body)
                            .map_err(|why| self.damaged("chunk", at, why))?,
                    );
                    if waiting.len() == CHUNKS_AHEAD {
                        self.visit_chunks(&mut waiting, &mut channels, visit)?;
                    }
                }
                op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA => {
                    self.visit_chunks(&mut waiting, &mut channels, visit)?;
                    let place = Place::File(body.clone());
                    self.visit_record(opcode, &self.map[body], &place, at, &mut channels, visit)?;
                }
                op::DATA_END => break self.ending(at),
                op::FOOTER => break Ending::Whole,
                _ => {}
            }
            at = body_end(&self.map, at);
        };
        self.visit_chunks(&mut waiting, &mut channels, visit)?;
        Ok(ending)
    }

    /// Behind the data only the summary may be cut off, which nothing here needs.
    fn ending(&self, at: usize) -> Ending {
        if self.map.ends_with(mcap::MAGIC) && self.map.len() > at + mcap::MAGIC.len() {
            Ending::Whole
        } else {
            Ending::CutOff { at: at as u64, why: "its index is not whole; all messages are".into() }
        }
    }

    fn visit_chunks(
        &self,
        waiting: &mut Vec<chunk::Packed>,
        channels: &mut Channels,
        visit: &mut dyn FnMut(Item<'_>) -> Result<(), RecordingError>,
    ) -> Result<(), RecordingError> {
        use rayon::prelude::*;
        let unpacked = waiting.par_iter().map(|packed| packed.unpack(&self.map)).collect::<Vec<_>>();
        for (packed, bytes) in waiting.drain(..).zip(unpacked) {
            let bytes = bytes.map_err(|why| self.damaged("chunk", packed.at(), why))?;
            let mut at = 0;
            while let Some((opcode, body)) = record_at(&bytes, at) {
                let place = packed.place(body.clone());
                self.visit_record(opcode, &bytes[body], &place, packed.at(), channels, visit)?;
                at = body_end(&bytes, at);
            }
            if at != bytes.len() && !packed.is_cut_off() {
                return Err(self.damaged("chunk", packed.at(), "a record in it reaches past its end".into()));
            }
        }
        Ok(())
    }

    fn visit_record(
        &self,
        opcode: u8,
        body: &[u8],
        place: &Place,
        at: usize,
        channels: &mut Channels,
        visit: &mut dyn FnMut(Item<'_>) -> Result<(), RecordingError>,
    ) -> Result<(), RecordingError> {
        let what = match opcode {
            op::SCHEMA => "schema record",
            op::CHANNEL => "channel record",
            op::MESSAGE => "message record",
            op::METADATA => "metadata record",
            _ => return Ok(()),
        };
        let record = mcap::parse_record(opcode, body).map_err(|e| self.damaged(what, at, e.to_string()))?;
        match record {
            Record::Schema { header, data } => {
                channels.schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(record) => channels.add(record).map_err(|why| self.damaged(what, at, why))?,
            Record::Message { header, data } => {
                let (channel, count) = channels.known.get_mut(&header.channel_id).ok_or_else(|| {
                    let why = format!(
                        "it belongs to channel {}, of which the file says nothing",
                        header.channel_id
                    );
                    self.damaged(what, at, why)
                })?;
                // The message is the rest of the record, behind the header.
                let start = body.len() - data.len();
                debug_assert!(matches!(data, Cow::Borrowed(_)));
                let message = MessageRef {
                    channel,
                    index: *count,
                    sequence: header.sequence,
                    log_time_ns: header.log_time,
                    publish_time_ns: header.publish_time,
                    data: &body[start..],
                    place: place.part(start..body.len()),
                };
                *count += 1;
                visit(Item::Message(message))?;
            }
            Record::Metadata(metadata) => {
                visit(Item::Metadata { name: &metadata.name, entries: &metadata.metadata })?;
            }
            _ => {}
        }
        Ok(())
    }

    /// The bytes at `place`, which a visit of this very file gave. A compressed chunk is unpacked for
    /// this call: to read many, see [`super::FrameReader`].
    ///
    /// # Errors
    /// [`RecordingError::Damaged`].
    pub fn read(&self, place: &Place) -> Result<Cow<'_, [u8]>, RecordingError> {
        match place {
            Place::File(range) => Ok(Cow::Borrowed(&self.map[range.clone()])),
            Place::Chunk { chunk, range } => Ok(Cow::Owned(self.unpack(*chunk)?[range.clone()].to_vec())),
        }
    }

    /// The unpacked bytes of the chunk whose record begins at `at`.
    ///
    /// # Errors
    /// [`RecordingError::Damaged`].
    pub fn unpack(&self, at: u64) -> Result<Vec<u8>, RecordingError> {
        let at = usize::try_from(at).expect("a place within a map");
        let packed = match record_at(&self.map, at) {
            Some((_, body)) => chunk::Packed::whole(&self.map, at, &body),
            None => chunk::Packed::cut_off(&self.map, at).ok_or_else(|| "it is not whole".into()),
        };
        packed
            .and_then(|packed| packed.unpack(&self.map).map(Cow::into_owned))
            .map_err(|why| self.damaged("chunk", at, why))
    }

    fn damaged(&self, what: &'static str, at: usize, why: String) -> RecordingError {
        RecordingError::Damaged { path: self.path.clone(), what, at: at as u64, why }
    }
}

/// The opcode and the body's place of the record at `at`, if the whole of it is there.
fn record_at(bytes: &[u8], at: usize) -> Option<(u8, Range<usize>)> {
    let head = bytes.get(at..at + RECORD_HEAD)?;
    let length = usize::try_from(u64::from_le_bytes(head[1..].try_into().expect("8 bytes"))).ok()?;
    let start = at + RECORD_HEAD;
    let end = start.checked_add(length).filter(|end| *end <= bytes.len())?;
    Some((head[0], start..end))
}

/// Where the record at `at`, which is whole, ends.
fn body_end(bytes: &[u8], at: usize) -> usize {
    record_at(bytes, at).map_or(bytes.len(), |(_, body)| body.end)
}

fn why_cut(bytes: &[u8], at: usize) -> String {
    match bytes.get(at..at + RECORD_HEAD) {
        None if at == bytes.len() => "it ends there, without an end of data and an index".into(),
        None => "it ends in the head of a record".into(),
        Some(head) => {
            let length = u64::from_le_bytes(head[1..].try_into().expect("8 bytes"));
            let there = bytes.len() - at - RECORD_HEAD;
            format!("of the record there, {there} of its {length} bytes are in the file")
        }
    }
}

#[derive(Debug, Default)]
struct Channels {
    schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    known: BTreeMap<u16, (Arc<Channel>, u64)>,
}

impl Channels {
    fn add(&mut self, record: mcap::records::Channel) -> Result<(), String> {
        let (schema_name, schema_encoding, schema) =
            self.schemas.get(&record.schema_id).cloned().unwrap_or_default();
        let channel = Channel {
            id: record.id,
            topic: record.topic,
            message_encoding: record.message_encoding,
            schema_name,
            schema_encoding,
            schema,
        };
        // Channels are repeated, in each chunk and in the summary: the same each time.
        match self.known.get(&record.id) {
            Some((known, _)) if known.topic != channel.topic => {
                Err(format!("channel {} is {} here and was {} before", record.id, channel.topic, known.topic))
            }
            Some(_) => Ok(()),
            None => {
                self.known.insert(record.id, (Arc::new(channel), 0));
                Ok(())
            }
        }
    }
}
