//! The container against another implementation, and against damage.

use std::{collections::BTreeMap, fs, io::Cursor, path::Path};

use mcap::{Compression, WriteOptions, records::MessageHeader};

use super::*;

/// Topic, log time, and bytes of every message.
type Messages = Vec<(String, u64, Vec<u8>)>;

fn visited(path: &Path) -> Result<(Messages, Ending), RecordingError> {
    let mut messages = Vec::new();
    let ending = RecordingFile::open(path)?.visit(&mut |item| {
        if let Item::Message(message) = item {
            messages.push((message.channel.topic.clone(), message.log_time_ns, message.data.to_vec()));
        }
        Ok(())
    })?;
    Ok((messages, ending))
}

fn expected() -> Messages {
    let bytes = |n: u64| (0..500).map(|i| (i * n % 251) as u8).collect();
    (0..40).map(|n| (format!("/topic/{}", n % 3), 1000 + n, bytes(n))).collect()
}

/// The expected messages, written by the `mcap` crate.
fn theirs(options: WriteOptions) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = options.create(&mut bytes).expect("begun");
    let mut channels = BTreeMap::new();
    for (topic, log_time, data) in expected() {
        let channel_id = *channels
            .entry(topic.clone())
            .or_insert_with(|| writer.add_channel(0, &topic, "json", &BTreeMap::new()).expect("added"));
        let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, &data).expect("written");
    }
    writer.finish().expect("finished");
    drop(writer);
    bytes.into_inner()
}

/// The expected messages, written by us.
fn ours(path: &Path, checksums: bool) {
    let options = WriterOptions { chunk_bytes: 4000, checksums };
    let mut writer = RecordingWriter::<Vec<u8>>::create(path, options).expect("begun");
    let schema = Schema {
        name: String::new(),
        encoding: String::new(),
        data: Vec::new(),
        message_encoding: "json".into(),
    };
    let channels = [0, 1, 2].map(|n| writer.channel(&format!("/topic/{n}"), &schema));
    for (n, (_, time_ns, data)) in expected().into_iter().enumerate() {
        let (head, rest) = data.split_at(100);
        writer.write(channels[n % 3], time_ns, head, Some(rest.to_vec())).expect("written");
    }
    writer.metadata("netcord", &BTreeMap::from([("rig".into(), "lab".into())])).expect("written");
    writer.finish().expect("finished");
}

#[test]
fn files_of_another_writer_are_read_however_they_are_packed() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("theirs.mcap");
    let small = || WriteOptions::new().chunk_size(Some(3000));
    let bare = || small().emit_message_indexes(false).emit_chunk_indexes(false).emit_statistics(false);
    let variants = [
        small().compression(Some(Compression::Zstd)),
        small().compression(Some(Compression::Lz4)),
        small().compression(None),
        small().use_chunks(false),
        bare().compression(Some(Compression::Zstd)).repeat_channels(false),
    ];
    for (place, options) in variants.into_iter().enumerate() {
        fs::write(&path, theirs(options)).expect("written");
        let (messages, ending) = visited(&path).expect("valid");
        assert_eq!(ending, Ending::Whole, "variant {place}");
        assert!(messages == expected(), "variant {place}");
    }
}

#[test]
fn our_files_are_valid_to_another_reader() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ours.mcap");
    for checksums in [false, true] {
        ours(&path, checksums);
        let bytes = fs::read(&path).expect("written");
        let options = enumset(mcap::read::Options::ValidateChunkCrcs);
        let read = mcap::MessageStream::new_with_options(&bytes, options).expect("valid");
        let read = read
            .map(|m| m.expect("valid"))
            .map(|m| (m.channel.topic.clone(), m.log_time, m.data.into_owned()));
        assert!(read.collect::<Messages>() == expected());
        // By the index too: each message is where the index says.
        let summary = mcap::Summary::read(&bytes).expect("valid").expect("there");
        assert_eq!(summary.stats.as_ref().expect("there").message_count, 40);
        let mut indexed = 0;
        for chunk in &summary.chunk_indexes {
            for (channel, entries) in summary.read_message_indexes(&bytes, chunk).expect("valid") {
                for entry in entries {
                    let message = summary.seek_message(&bytes, chunk, &entry).expect("there");
                    assert_eq!((message.channel.id, message.log_time), (channel.id, entry.log_time));
                    indexed += 1;
                }
            }
        }
        assert_eq!(indexed, 40);
        assert_eq!(summary.metadata_indexes.len(), 1);
    }
}

/// The one option, as the set that the reader wants.
fn enumset<T: Into<U>, U>(option: T) -> U {
    option.into()
}

#[test]
fn every_cut_leaves_the_messages_before_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cut.mcap");
    let small = WriteOptions::new().chunk_size(Some(3000));
    for options in [
        small.clone().compression(None),
        small.clone().compression(Some(Compression::Zstd)),
        small.use_chunks(false),
    ] {
        let whole = theirs(options);
        let mut before = 0;
        for end in (mcap::MAGIC.len()..whole.len()).step_by(61) {
            fs::write(&path, &whole[..end]).expect("written");
            let (messages, ending) = visited(&path).expect("what is there is valid");
            assert!(matches!(ending, Ending::CutOff { .. }), "cut at {end}");
            assert!(expected().starts_with(&messages) && messages.len() >= before, "cut at {end}");
            before = messages.len();
        }
        assert_eq!(before, 40);
    }
}

#[test]
fn garbled_bytes_are_errors_or_other_messages_but_no_panic() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("garbled.mcap");
    let whole = theirs(WriteOptions::new().chunk_size(Some(3000)).compression(Some(Compression::Lz4)));
    let mut refused = 0;
    for at in (0..whole.len()).step_by(37) {
        let mut garbled = whole.clone();
        garbled[at] ^= 0x5a;
        fs::write(&path, garbled).expect("written");
        refused += usize::from(visited(&path).is_err());
    }
    assert!(refused > 10, "chunks have checksums: {refused} refused");
}

#[test]
fn a_file_ended_for_want_of_space_is_valid() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("full.mcap");
    let mut writer =
        RecordingWriter::<Vec<u8>>::create(&path, WriterOptions { chunk_bytes: 100, checksums: true })
            .expect("begun");
    let schema =
        Schema { name: "s".into(), encoding: "".into(), data: vec![1], message_encoding: "json".into() };
    let channel = writer.channel("/a", &schema);
    writer.write(channel, 1, &[1; 200], None).expect("written");
    writer.write(channel, 2, &[2; 20], None).expect("waits");
    assert_eq!(writer.finish_without_space().expect("ended"), 0);
    let (messages, ending) = visited(&path).expect("valid");
    assert_eq!((messages.len(), ending), (1, Ending::Whole));
}
