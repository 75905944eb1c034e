use std::{
    collections::BTreeMap,
    fs::File,
    io::{self, IoSlice, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use mcap::records::op;

use super::{
    RecordingError,
    records::{Body, ChunkIndex},
};

/// What a channel's messages are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schema {
    /// `foxglove.RawImage`, ….
    pub name: String,
    /// `protobuf`, `jsonschema`, or empty.
    pub encoding: String,
    /// The description itself.
    pub data: Vec<u8>,
    /// `protobuf`, `json`.
    pub message_encoding: String,
}

/// A channel of the file being written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ChannelId(u16);

/// What a message says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MessageStamps {
    /// The writer's count.
    pub sequence: u32,
    /// When it was recorded, ns.
    pub log_ns: u64,
    /// When it was published, ns.
    pub publish_ns: u64,
}

/// How a recording is written.
#[derive(Debug, Clone, Copy)]
pub struct WriterOptions {
    /// A chunk is closed when it holds this many bytes. Pieces are kept until then.
    pub chunk_bytes: usize,
    /// Whether chunks carry a CRC of their bytes: that reads each byte once more.
    pub checksums: bool,
}

impl Default for WriterOptions {
    fn default() -> Self {
        Self { chunk_bytes: 8 << 20, checksums: true }
    }
}

/// Writes an MCAP file. A chunk goes to the file whole, in one gathering write from where its pieces lie:
/// a frame is not copied together with its message. What is on disk is valid up to the last chunk at any
/// moment; [`Self::finish`] adds the index.
///
/// `P` owns the large part of a message, such as a frame in shared memory.
#[derive(Debug)]
pub struct RecordingWriter<P> {
    path: PathBuf,
    file: File,
    options: WriterOptions,
    /// Where the next record goes.
    at: u64,
    schemas: Vec<Schema>,
    channels: Vec<ChannelState>,
    chunk: Chunk<P>,
    chunks: Vec<ChunkIndex>,
    metadata: Vec<(String, u64, u64)>,
}

#[derive(Debug)]
struct ChannelState {
    topic: String,
    schema: u16,
    message_encoding: String,
    /// Messages so far: the next one's sequence.
    count: u32,
}

#[derive(Debug)]
struct Chunk<P> {
    /// All but the large parts.
    small: Vec<u8>,
    /// Each large part, and where in `small` it belongs.
    large: Vec<(usize, P)>,
    /// Bytes of the records.
    length: usize,
    index: BTreeMap<u16, Vec<(u64, u64)>>,
}

impl<P> Default for Chunk<P> {
    fn default() -> Self {
        Self { small: Vec::new(), large: Vec::new(), length: 0, index: BTreeMap::new() }
    }
}

impl<P: AsRef<[u8]>> RecordingWriter<P> {
    /// Begins a file, replacing one that is there.
    ///
    /// # Errors
    /// [`RecordingError::File`].
    pub fn create(path: &Path, options: WriterOptions) -> Result<Self, RecordingError> {
        let failed = |cause| RecordingError::File { doing: "create", path: path.to_owned(), cause };
        Self::onto(File::create(path).map_err(failed)?, path, options)
    }

    /// Begins in an empty file that is open; `path` names it in messages.
    ///
    /// # Errors
    /// [`RecordingError::File`].
    pub fn onto(file: File, path: &Path, options: WriterOptions) -> Result<Self, RecordingError> {
        let mut writer = Self {
            path: path.to_owned(),
            file,
            options,
            at: 0,
            schemas: Vec::new(),
            channels: Vec::new(),
            chunk: Chunk::default(),
            chunks: Vec::new(),
            metadata: Vec::new(),
        };
        let mut head = mcap::MAGIC.to_vec();
        let library = concat!("netcord ", env!("CARGO_PKG_VERSION"));
        Body::begin(&mut head, op::HEADER).text("").text(library).end(0);
        writer.append(&head)?;
        Ok(writer)
    }

    /// Adds a channel; one schema may serve several.
    pub fn channel(&mut self, topic: &str, schema: &Schema) -> ChannelId {
        let same = |s: &Schema| (&s.name, &s.data) == (&schema.name, &schema.data);
        let schema_id = match self.schemas.iter().position(same) {
            _ if schema.name.is_empty() => 0,
            Some(known) => id(known) + 1,
            None => {
                self.schemas.push(schema.clone());
                let place = self.schemas.len() - 1;
                self.chunk.record(|out| write_schema(out, place, schema));
                id(place) + 1
            }
        };
        self.channels.push(ChannelState {
            topic: topic.to_owned(),
            schema: schema_id,
            message_encoding: schema.message_encoding.clone(),
            count: 0,
        });
        let place = self.channels.len() - 1;
        let channel = &self.channels[place];
        self.chunk.record(|out| write_channel(out, place, channel));
        ChannelId(id(place))
    }

    /// Adds a message, its bytes `head` and then, where there is one, `rest`.
    ///
    /// # Errors
    /// [`RecordingError::File`] when a chunk is full and cannot be written.
    pub fn write(
        &mut self,
        channel: ChannelId,
        time_ns: u64,
        head: &[u8],
        rest: Option<P>,
    ) -> Result<(), RecordingError> {
        let state = &mut self.channels[usize::from(channel.0)];
        let sequence = state.count;
        state.count = state.count.wrapping_add(1);
        self.write_as(channel, MessageStamps { sequence, log_ns: time_ns, publish_ns: time_ns }, head, rest)
    }

    /// As [`Self::write`], with the sequence and times that the message already has.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn write_as(
        &mut self,
        channel: ChannelId,
        stamps: MessageStamps,
        head: &[u8],
        rest: Option<P>,
    ) -> Result<(), RecordingError> {
        let MessageStamps { sequence, log_ns, publish_ns } = stamps;
        let offset = self.chunk.length as u64;
        self.chunk.index.entry(channel.0).or_default().push((log_ns, offset));
        let more = rest.as_ref().map_or(0, |rest| rest.as_ref().len());
        self.chunk.record(|out| {
            let body = Body::begin(out, op::MESSAGE).u16(channel.0).u32(sequence);
            body.u64(log_ns).u64(publish_ns).raw(head).end(more as u64);
        });
        if let Some(rest) = rest {
            self.chunk.large.push((self.chunk.small.len(), rest));
            self.chunk.length += more;
        }
        if self.chunk.length >= self.options.chunk_bytes { self.flush() } else { Ok(()) }
    }

    /// Bytes that wait for their chunk to be written.
    pub const fn waiting_bytes(&self) -> usize {
        self.chunk.length
    }

    /// Large parts that wait for their chunk to be written.
    pub fn waiting_parts(&self) -> usize {
        self.chunk.large.len()
    }

    /// Bytes written so far.
    pub const fn written_bytes(&self) -> u64 {
        self.at
    }

    /// The file, for telling the system what is to reach the disk when.
    pub const fn file(&self) -> &File {
        &self.file
    }

    /// Writes what waits as a chunk.
    ///
    /// # Errors
    /// [`RecordingError::File`]; then the chunk is given up, and the file ends as before it.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        if self.chunk.length == 0 {
            return Ok(());
        }
        let chunk = std::mem::take(&mut self.chunk);
        let times = || chunk.index.values().flatten().map(|(time, _)| *time);
        let (first_ns, last_ns) = (times().min().unwrap_or(0), times().max().unwrap_or(0));
        let crc = if self.options.checksums { chunk.crc() } else { 0 };
        let length = chunk.length as u64;
        let mut head = Vec::with_capacity(64);
        let body = Body::begin(&mut head, op::CHUNK).u64(first_ns).u64(last_ns).u64(length);
        body.u32(crc).text("").u64(length).end(length);
        let (record_length, mut indexes) = (head.len() as u64 + length, Vec::new());
        let mut indexes_at = BTreeMap::new();
        for (channel, entries) in &chunk.index {
            indexes_at.insert(*channel, self.at + record_length + indexes.len() as u64);
            let body = Body::begin(&mut indexes, op::MESSAGE_INDEX).u16(*channel);
            let body = body.u32(u32::try_from(16 * entries.len()).expect("less than 4 GB"));
            entries.iter().fold(body, |body, (time, offset)| body.u64(*time).u64(*offset)).end(0);
        }
        let described = ChunkIndex {
            first_ns,
            last_ns,
            at: self.at,
            length: record_length,
            indexes_at,
            indexes_length: indexes.len() as u64,
            records_length: length,
            messages: chunk.index.iter().map(|(channel, e)| (*channel, e.len() as u64)).collect(),
        };
        let mut parts = vec![IoSlice::new(&head)];
        parts.extend(chunk.parts().map(IoSlice::new));
        parts.push(IoSlice::new(&indexes));
        self.append_all(&mut parts)?;
        self.chunks.push(described);
        Ok(())
    }

    /// Writes a metadata record.
    ///
    /// # Errors
    /// As [`Self::flush`].
    pub fn metadata(&mut self, name: &str, entries: &BTreeMap<String, String>) -> Result<(), RecordingError> {
        self.flush()?;
        let mut record = Vec::new();
        Body::begin(&mut record, op::METADATA).text(name).texts(entries).end(0);
        let at = self.at;
        self.append(&record)?;
        self.metadata.push((name.to_owned(), at, record.len() as u64));
        Ok(())
    }

    /// Writes what waits, the index and the end.
    ///
    /// # Errors
    /// As [`Self::flush`].
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.flush()?;
        self.end()
    }

    /// Ends the file where writing more has failed, for want of space: gives up what waits, and as many of
    /// the last chunks as the index needs room for. Returns how many messages of the written ones that cost.
    ///
    /// # Errors
    /// [`RecordingError::File`] when not even that works.
    pub fn finish_without_space(mut self) -> Result<u64, RecordingError> {
        self.chunk = Chunk::default();
        let mut given_up = 0;
        loop {
            match self.end() {
                Ok(()) => return Ok(given_up),
                Err(e) => {
                    let Some(last) = self.chunks.pop() else { return Err(e) };
                    given_up += last.messages.values().sum::<u64>();
                    // Metadata behind the chunk goes with it.
                    self.metadata.retain(|(_, at, _)| *at < last.at);
                    self.cut(last.at)?;
                }
            }
        }
    }

    /// Data end, summary, footer, magic (specification, "File Structure").
    fn end(&mut self) -> Result<(), RecordingError> {
        let mut out = Vec::new();
        Body::begin(&mut out, op::DATA_END).u32(0).end(0);
        let summary_at = self.at + out.len() as u64;
        let mut groups = Vec::new();
        let mut group = |out: &mut Vec<u8>, opcode: u8, write: &mut dyn FnMut(&mut Vec<u8>)| {
            let start = out.len();
            write(out);
            if out.len() > start {
                groups.push((opcode, self.at + start as u64, (out.len() - start) as u64));
            }
        };
        group(&mut out, op::SCHEMA, &mut |out| {
            self.schemas.iter().enumerate().for_each(|(place, schema)| write_schema(out, place, schema));
        });
        group(&mut out, op::CHANNEL, &mut |out| {
            self.channels.iter().enumerate().for_each(|(place, channel)| write_channel(out, place, channel));
        });
        group(&mut out, op::STATISTICS, &mut |out| self.write_statistics(out));
        group(&mut out, op::CHUNK_INDEX, &mut |out| self.chunks.iter().for_each(|chunk| chunk.write(out)));
        group(&mut out, op::METADATA_INDEX, &mut |out| {
            for (name, at, length) in &self.metadata {
                Body::begin(out, op::METADATA_INDEX).u64(*at).u64(*length).text(name).end(0);
            }
        });
        let offsets_at = self.at + out.len() as u64;
        for (opcode, start, length) in groups {
            Body::begin(&mut out, op::SUMMARY_OFFSET).u8(opcode).u64(start).u64(length).end(0);
        }
        Body::begin(&mut out, op::FOOTER).u64(summary_at).u64(offsets_at).u32(0).end(0);
        out.extend(mcap::MAGIC);
        self.append(&out)
    }

    fn write_statistics(&self, out: &mut Vec<u8>) {
        let mut counts = BTreeMap::new();
        for (channel, count) in self.chunks.iter().flat_map(|chunk| &chunk.messages) {
            *counts.entry(*channel).or_insert(0) += count;
        }
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let first = self.chunks.iter().filter(|c| !c.messages.is_empty()).map(|c| c.first_ns).min();
        Body::begin(out, op::STATISTICS)
            .u64(counts.values().sum())
            .u16(id(self.schemas.len()))
            .u32(count(self.channels.len()))
            .u32(0)
            .u32(count(self.metadata.len()))
            .u32(count(self.chunks.len()))
            .u64(first.unwrap_or(0))
            .u64(self.chunks.iter().map(|c| c.last_ns).max().unwrap_or(0))
            .numbers(&counts)
            .end(0);
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), RecordingError> {
        self.append_all(&mut [IoSlice::new(bytes)])
    }

    /// All of `parts`, or the file as it was before.
    fn append_all(&mut self, parts: &mut [IoSlice<'_>]) -> Result<(), RecordingError> {
        let length = parts.iter().map(|part| part.len() as u64).sum::<u64>();
        match write_all(&mut self.file, parts) {
            Ok(()) => {
                self.at += length;
                Ok(())
            }
            Err(cause) => {
                // Why nothing could be written says more than why that cannot be undone, on a device say.
                let _ = self.cut(self.at);
                Err(RecordingError::File { doing: "write", path: self.path.clone(), cause })
            }
        }
    }

    fn cut(&mut self, at: u64) -> Result<(), RecordingError> {
        self.at = at;
        self.file
            .set_len(at)
            .and_then(|()| self.file.seek(SeekFrom::Start(at)).map(|_| ()))
            .map_err(|cause| RecordingError::File { doing: "cut back", path: self.path.clone(), cause })
    }
}

impl<P: AsRef<[u8]>> Chunk<P> {
    fn record(&mut self, write: impl FnOnce(&mut Vec<u8>)) {
        let before = self.small.len();
        write(&mut self.small);
        self.length += self.small.len() - before;
    }

    /// The bytes of the records, in order.
    fn parts(&self) -> impl Iterator<Item = &[u8]> {
        let starts = std::iter::once(0).chain(self.large.iter().map(|(at, _)| *at));
        let ends = self.large.iter().map(|(at, _)| *at).chain(std::iter::once(self.small.len()));
        let larges = self.large.iter().map(|(_, part)| part.as_ref()).chain(std::iter::once([].as_slice()));
        starts.zip(ends).zip(larges).flat_map(|((start, end), large)| [&self.small[start..end], large])
    }

    fn crc(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        self.parts().for_each(|part| hasher.update(part));
        hasher.finalize()
    }
}

/// Pieces that one system call takes; Linux's own limit (UIO_MAXIOV).
const MAX_PIECES: usize = 1024;

fn write_all(file: &mut File, mut parts: &mut [IoSlice<'_>]) -> io::Result<()> {
    IoSlice::advance_slices(&mut parts, 0);
    while !parts.is_empty() {
        let batch = parts.len().min(MAX_PIECES);
        match file.write_vectored(&parts[..batch]) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(written) => IoSlice::advance_slices(&mut parts, written),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

fn write_schema(out: &mut Vec<u8>, place: usize, schema: &Schema) {
    // 0 means "no schema": ids begin with 1.
    let body = Body::begin(out, op::SCHEMA).u16(id(place) + 1);
    body.text(&schema.name).text(&schema.encoding).bytes(&schema.data).end(0);
}

fn write_channel(out: &mut Vec<u8>, place: usize, channel: &ChannelState) {
    let body = Body::begin(out, op::CHANNEL).u16(id(place)).u16(channel.schema);
    body.text(&channel.topic).text(&channel.message_encoding).u32(0).end(0);
}

fn id(place: usize) -> u16 {
    u16::try_from(place).expect("far fewer than 65535 channels and schemas")
}
