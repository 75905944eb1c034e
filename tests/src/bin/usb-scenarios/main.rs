//! Runs the driver against emulated cameras on a real USB stack, one scenario a call, and judges what a
//! reader of the bus sees: `usb-scenarios SCENARIO RIG.toml [--name value …]`. The row that it prints begins
//! with `ok` or `FAILED`.

mod copies;
mod cost;
mod harness;
mod pipeline;
mod scenarios;

use std::{collections::BTreeMap, env, error::Error, path::Path, process::ExitCode};

use netcord_common::rig::Rig;

type Outcome = Result<String, Box<dyn Error>>;

/// The options behind the rig.
pub(crate) struct Options(BTreeMap<String, String>);

impl Options {
    fn read(words: &[String]) -> Self {
        Self(
            words
                .chunks(2)
                .filter_map(|w| Some((w[0].strip_prefix("--")?.to_owned(), w.get(1)?.clone())))
                .collect(),
        )
    }

    pub(crate) fn number(&self, name: &str, default: u64) -> u64 {
        self.0.get(name).and_then(|v| v.parse().ok()).unwrap_or(default)
    }

    pub(crate) fn text(&self, name: &str) -> &str {
        self.0.get(name).map_or("", String::as_str)
    }
}

pub(crate) fn ensure(holds: bool, what: impl FnOnce() -> String) -> Result<(), Box<dyn Error>> {
    if holds { Ok(()) } else { Err(what().into()) }
}

fn main() -> ExitCode {
    let words: Vec<String> = env::args().skip(1).collect();
    let [name, path, rest @ ..] = words.as_slice() else {
        println!("FAILED usb-scenarios SCENARIO RIG.toml [--name value …]");
        return ExitCode::from(2);
    };
    let mut options = Options::read(rest);
    options.0.insert("rig".into(), path.clone());
    let scenario: fn(&Rig, &Options) -> Outcome = match name.as_str() {
        "clean" => scenarios::clean,
        "fault" => scenarios::fault,
        "replug" => scenarios::replug,
        "control" => scenarios::control,
        "acks" => scenarios::acks,
        "slow" => scenarios::slow,
        "limit" => scenarios::limit,
        "deep" => scenarios::deep,
        "slip" => scenarios::slip,
        "copies" => copies::copies,
        "copy-a-frame" => copies::copy_a_frame,
        "cost" => cost::cost,
        "pipeline" => pipeline::pipeline,
        _ => {
            println!("FAILED {name}: no such scenario");
            return ExitCode::from(2);
        }
    };
    let outcome = Rig::load(Path::new(path)).map_err(Into::into).and_then(|rig| scenario(&rig, &options));
    let title = format!("{name} {}", rest.join(" "));
    match outcome {
        Ok(detail) => {
            println!("ok {title}: {detail}");
            ExitCode::SUCCESS
        }
        Err(e) => {
            println!("FAILED {title}: {e}");
            ExitCode::from(1)
        }
    }
}
