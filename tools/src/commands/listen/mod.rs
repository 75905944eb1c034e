//! `netcord listen`: messages as JSON lines, for scripts.

mod as_json;

use std::time::{Duration, Instant};

use netcord_capture::synthetic::truth_domain;
use netcord_common::{
    DomainName, Shutdown,
    bus::{Bus, BusError, FrameSubscriber, Listen, Subscriber, Topic, wait_any},
    rig::Rig,
    wire::Message,
};
use serde_json::{Map, Value};

use self::as_json::AsJson;
use super::RigArgs;
use crate::{
    console,
    exit::{CommandResult, Outcome},
};

/// Arguments of `netcord listen`.
///
/// Each line is one message: {"topic": …, then its fields, in the units that their names say}. Exit codes:
/// 0 it saw --count messages or was stopped; 1 --seconds passed with fewer than --count; 2 an error.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    rig: RigArgs,

    /// What to listen to: topics such as ball/position or camera/left/detections, or their beginnings, such as
    /// ball; default: all but frames. Of frames, the headers are shown. truth/ball needs a synthetic source.
    #[arg(value_name = "TOPIC")]
    topics: Vec<String>,

    /// End after this many messages.
    #[arg(long, value_name = "N")]
    count: Option<u64>,

    /// End after this many seconds.
    #[arg(long, value_name = "N", value_parser = super::seconds, allow_negative_numbers = true)]
    seconds: Option<f64>,
}

/// How long it sleeps at most, so that it sees a request to stop.
const LONGEST_WAIT: Duration = Duration::from_millis(50);

/// Runs `netcord listen`.
pub fn run(args: &Args) -> CommandResult {
    let (rig, domain) = args.rig.load()?;
    let stop = Shutdown::on_signals()?;
    let sources = sources(&rig, &domain, &args.topics)?;
    let listeners: Vec<&dyn Listen> = sources.iter().map(|s| s.source.listener()).collect();
    let started = Instant::now();
    let mut seen = 0;
    // Whoever read us may have seen enough.
    while !stop.is_requested() && console::is_read() {
        if args.seconds.is_some_and(|s| started.elapsed().as_secs_f64() >= s) {
            let missed = args.count.is_some();
            return Ok(if missed { Outcome::Missed } else { Outcome::Good });
        }
        wait_any(&listeners, LONGEST_WAIT)?;
        for source in &sources {
            while let Some(Value::Object(message)) = source.source.next()? {
                let mut line = Map::from_iter([("topic".to_owned(), source.topic.clone().into())]);
                line.extend(message);
                println!("{}", Value::Object(line));
                seen += 1;
                if args.count.is_some_and(|count| seen >= count) {
                    return Ok(Outcome::Good);
                }
            }
        }
    }
    Ok(Outcome::Good)
}

/// A topic's messages as JSON.
trait Source {
    fn next(&self) -> Result<Option<Value>, BusError>;
    fn listener(&self) -> &dyn Listen;
}

impl<T: Message + AsJson> Source for Subscriber<T> {
    fn next(&self) -> Result<Option<Value>, BusError> {
        Ok(self.receive()?.map(|message| message.as_json()))
    }

    fn listener(&self) -> &dyn Listen {
        self
    }
}

impl Source for FrameSubscriber {
    fn next(&self) -> Result<Option<Value>, BusError> {
        Ok(self.receive()?.map(|frame| frame.header().as_json()))
    }

    fn listener(&self) -> &dyn Listen {
        self
    }
}

struct NamedSource {
    topic: String,
    source: Box<dyn Source>,
}

fn sources(
    rig: &Rig,
    domain: &DomainName,
    wanted: &[String],
) -> Result<Vec<NamedSource>, Box<dyn std::error::Error>> {
    let mut open =
        Opener { bus: Bus::join(domain, "listen")?, wanted, valid: Vec::new(), sources: Vec::new() };
    open.messages(&Topic::position())?;
    open.messages(&Topic::trajectory())?;
    open.messages(&Topic::frameset())?;
    open.messages(&Topic::health())?;
    for camera in &rig.cameras {
        open.messages(&Topic::detections(&camera.name))?;
        open.messages(&Topic::window(&camera.name))?;
        let topic = Topic::frames(&camera.name);
        if open.wants(topic.name(), false) {
            let source = Box::new(FrameSubscriber::open(&open.bus, &topic, topic.limits().queue)?);
            open.sources.push(NamedSource { topic: topic.name().to_owned(), source });
        }
    }
    // The truth travels in a domain of its own, which is joined only on request.
    let truth = Topic::truth();
    if open.wants(truth.name(), false) {
        open.bus = Bus::join(&truth_domain(domain)?, "listen")?;
        let source = Box::new(open.bus.subscriber(&truth)?);
        open.sources.push(NamedSource { topic: truth.name().to_owned(), source });
    }
    for topic in wanted {
        if !open.valid.iter().any(|valid| valid.starts_with(topic.as_str())) {
            return Err(format!("no topic {topic:?} in this rig; valid are {}", open.valid.join(", ")).into());
        }
    }
    Ok(open.sources)
}

struct Opener<'a> {
    bus: Bus,
    wanted: &'a [String],
    valid: Vec<String>,
    sources: Vec<NamedSource>,
}

impl Opener<'_> {
    fn wants(&mut self, topic: &str, by_default: bool) -> bool {
        self.valid.push(topic.to_owned());
        if self.wanted.is_empty() {
            by_default
        } else {
            self.wanted.iter().any(|w| topic.starts_with(w.as_str()))
        }
    }

    fn messages<T: Message + AsJson>(&mut self, topic: &Topic<T>) -> Result<(), BusError> {
        if self.wants(topic.name(), true) {
            let source = Box::new(self.bus.subscriber(topic)?);
            self.sources.push(NamedSource { topic: topic.name().to_owned(), source });
        }
        Ok(())
    }
}
