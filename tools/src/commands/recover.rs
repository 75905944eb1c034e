//! `netcord recover`: saves what is whole of a recording that was cut off, with a new index.

use std::{
    collections::{BTreeMap, HashMap},
    fs,
    path::PathBuf,
};

use netcord_capture::recording::{
    Ending, Item, MessageStamps, RecordingFile, RecordingWriter, Schema, WriterOptions,
};

use crate::{
    exit::{CommandResult, Outcome},
    output::{Plan, refuse_existing},
};

/// Saves all whole messages and metadata of a recording into a new file with an index, such as one whose
/// recorder was killed. Works on any MCAP file; attachments are left out. Exit code 1 when the last
/// record was lost, or nothing could be saved.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The damaged recording; it is not changed.
    input: PathBuf,

    /// The repaired one; default: INPUT with `.recovered.mcap` at its end.
    output: Option<PathBuf>,

    /// Replace OUTPUT if it is there.
    #[arg(long)]
    overwrite: bool,
}

/// Runs `netcord recover`.
pub fn run(args: &Args) -> CommandResult {
    let output = args.output.clone().unwrap_or_else(|| args.input.with_extension("recovered.mcap"));
    refuse_existing(&output, args.overwrite)?;
    let saved = Plan::of([&args.input]).begin(&output)?;
    let file = RecordingFile::open(&args.input)?;
    let mut writer = RecordingWriter::<Vec<u8>>::onto(saved.file()?, saved.path(), WriterOptions::default())?;
    let mut channels = HashMap::new();
    let mut messages = 0_u64;
    let mut metadata: Vec<(String, BTreeMap<String, String>)> = Vec::new();
    let ending = file.visit(&mut |item| match item {
        Item::Message(message) => {
            let channel = *channels.entry(message.channel.id).or_insert_with(|| {
                let schema = Schema {
                    name: message.channel.schema_name.clone(),
                    encoding: message.channel.schema_encoding.clone(),
                    data: message.channel.schema.clone(),
                    message_encoding: message.channel.message_encoding.clone(),
                };
                writer.channel(&message.channel.topic, &schema)
            });
            messages += 1;
            let stamps = MessageStamps {
                sequence: message.sequence,
                log_ns: message.log_time_ns,
                publish_ns: message.publish_time_ns,
            };
            writer.write_as(channel, stamps, message.data, None)
        }
        Item::Metadata { name, entries } => {
            metadata.push((name.to_owned(), entries.clone()));
            Ok(())
        }
    })?;
    for (name, entries) in &metadata {
        writer.metadata(name, entries)?;
    }
    writer.finish()?;
    saved.complete()?;
    match &ending {
        Ending::Whole => println!("{} was whole", args.input.display()),
        Ending::CutOff { at, why } => println!("{} is cut off at byte {at}: {why}", args.input.display()),
    }
    println!("{}: {messages} messages of {} topics saved", output.display(), channels.len());
    // A file that lacks nothing but its end is saved whole.
    let is_cut = match ending {
        Ending::Whole => false,
        Ending::CutOff { at, .. } => fs::metadata(&args.input)?.len() > at,
    };
    Ok(if messages > 0 && !is_cut { Outcome::Good } else { Outcome::Missed })
}
