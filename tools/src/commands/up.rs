//! `netcord up`: starts, watches, restarts and stops the processes of a rig.

use std::{
    ffi::OsString,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use netcord_capture::synthetic::truth_domain;
use netcord_common::{
    Clock as _, DomainName, MonotonicClock, Shutdown,
    bus::{Bus, BusError, DomainRemains, Subscriber, Topic},
    rig::{ProcessSpec, Rig},
    wire::Health,
};
use serde_json::json;

use crate::{
    exit::{CommandResult, Outcome},
    observer::{Observer, SilenceWatch, Tally},
    stage,
    supervisor::{ChildStatus, Happening, Launch, Phase, Supervisor},
    terminal::LiveLines,
};

/// Arguments of `netcord up`.
///
/// Exit codes: 0 all processes ran until they were stopped; 1 one of them died on the way and was
/// restarted, had to be killed at the end, or ended with an exit code of its own; 2 an error, or a process that does not start however often it is tried.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The rig file, which names the processes under [[process]]; without any, the four stages run.
    #[arg(env = "NETCORD_RIG", value_name = "RIG.toml")]
    rig: PathBuf,

    /// The domain in which the rig's processes meet; default: the rig's name.
    #[arg(long, env = "NETCORD_DOMAIN", value_name = "NAME")]
    domain: Option<DomainName>,

    /// Stop after this many seconds; default: run until SIGINT or SIGTERM.
    #[arg(long, value_name = "N", value_parser = super::seconds, allow_negative_numbers = true)]
    seconds: Option<f64>,

    /// Write a JSON line to standard output for every start, readiness, end and line of a process, and where one is
    /// silent while its input flows.
    #[arg(long)]
    events: bool,

    /// No live view of the processes.
    #[arg(long)]
    quiet: bool,
}

/// How often the live view is drawn, and the domain's messages are read for it.
const VIEW_INTERVAL: Duration = Duration::from_millis(200);

/// How long a stage gets to end in order before it is killed; it looks at its flag ten times a second.
const STOP_PATIENCE: Duration = Duration::from_secs(3);

/// How long a recorder, which has a queue to write, may write nothing before it is killed: a disk that is busy pauses
/// for seconds.
const WRITER_PATIENCE: Duration = Duration::from_secs(15);

/// Runs `netcord up`.
pub fn run(args: &Args) -> CommandResult {
    let rig = Rig::load(&args.rig)?;
    let domain = args.domain.clone().unwrap_or_else(|| rig.name.clone());
    let stop = Shutdown::on_signals()?;
    refuse_second(&rig, &domain)?;
    let mut supervisor = Supervisor::new(launches(&rig, &args.rig, &domain)?);
    let bus = Bus::join(&domain, "up")?;
    bus.clean_up_dead();
    let mut narrator =
        Narrator { events: args.events, live: LiveLines::new(args.quiet), ended_badly: 0, given_up: None };
    let result = watch(args, &rig, &bus, &stop, &mut supervisor, &mut narrator);
    stage::notify_stopping();
    supervisor.stop(&mut |happening| narrator.tell(&happening));
    bus.clean_up_dead();
    drop(bus);
    // A synthetic capture publishes the truth in a domain of its own.
    for domain in [domain.clone(), truth_domain(&domain)?] {
        let remains = DomainRemains::of(&domain);
        // Who watches or records stays where it is, and finds the rig when it is started again.
        if remains.inhabitants()?.is_empty() {
            remains.remove()?;
        }
    }
    result?;
    match (narrator.given_up, narrator.ended_badly) {
        (Some(name), _) => Err(format!("{name} does not start; its last lines are above").into()),
        (None, 0) => Ok(Outcome::Good),
        (None, _) => Ok(Outcome::Missed),
    }
}

/// Two supervisors of one domain would take each other's shared memory away.
fn refuse_second(rig: &Rig, domain: &DomainName) -> Result<(), Box<dyn std::error::Error>> {
    let mut alive = DomainRemains::of(domain).inhabitants()?;
    alive.retain(|name| {
        name == "up" || rig.processes.iter().any(|process| name.starts_with(&process.command))
    });
    if alive.is_empty() {
        return Ok(());
    }
    let alive = alive.join(", ");
    Err(format!("the domain {domain} is in use by {alive}: stop it first, or give another with --domain")
        .into())
}

fn watch(
    args: &Args,
    rig: &Rig,
    bus: &Bus,
    stop: &Shutdown,
    supervisor: &mut Supervisor,
    narrator: &mut Narrator,
) -> CommandResult {
    let started = Instant::now();
    let mut guard = Guard::attach(args, bus)?;
    let mut view = None;
    let mut drawn = Instant::now();
    let mut told_ready = false;
    let over = || args.seconds.is_some_and(|s| started.elapsed().as_secs_f64() >= s);
    while !stop.is_requested() && !over() && !supervisor.all_ended() && narrator.given_up.is_none() {
        supervisor.step(
            VIEW_INTERVAL,
            &mut || {
                bus.clean_up_dead();
            },
            &mut |happening| narrator.tell(&happening),
        )?;
        guard.look(supervisor, narrator)?;
        if !told_ready && supervisor.all_ready() {
            told_ready = true;
            stage::notify_ready();
        }
        if narrator.live.is_seen() && told_ready && drawn.elapsed() >= VIEW_INTERVAL {
            drawn = Instant::now();
            let (observer, tally) = match &mut view {
                Some(view) => view,
                none => none.insert((Observer::attach(bus, rig)?, Tally::default())),
            };
            observer.drain(&mut |seen| tally.see(&seen))?;
            let mut lines = processes(supervisor);
            lines.extend(tally.lines());
            narrator.live.draw(&lines);
        }
    }
    Ok(Outcome::Good)
}

/// Looks after stages that are silent while their input flows.
struct Guard {
    health: Subscriber<Health>,
    watch: SilenceWatch,
    /// Where a person finds out more.
    hint: String,
}

impl Guard {
    fn attach(args: &Args, bus: &Bus) -> Result<Self, BusError> {
        let domain = args.domain.as_ref().map_or_else(String::new, |domain| format!(" --domain {domain}"));
        let rig = args.rig.display();
        let hint = format!(
            "look at what it said above, and at `netcord latency --rig {rig}{domain}` and `netcord listen --rig \
             {rig}{domain} rig/health`"
        );
        Ok(Self { health: bus.subscriber(&Topic::health())?, watch: SilenceWatch::default(), hint })
    }

    fn look(&mut self, supervisor: &Supervisor, narrator: &mut Narrator) -> Result<(), BusError> {
        while let Some(health) = self.health.receive()? {
            self.watch.see(&health);
        }
        let statuses: Vec<ChildStatus<'_>> = supervisor.statuses().collect();
        let ready = |pid| statuses.iter().find(|s| s.pid == Some(pid) && s.phase == Phase::Running);
        for silence in self.watch.look(MonotonicClock.now().as_ns(), |pid| ready(pid).is_some()) {
            if let Some(status) = ready(silence.pid) {
                narrator.warn(status.name, silence.pid, &format!("{silence}; {}", self.hint));
            }
        }
        Ok(())
    }
}

/// One line a process.
fn processes(supervisor: &Supervisor) -> Vec<String> {
    supervisor
        .statuses()
        .map(|s| {
            let pid = s.pid.map_or_else(|| "-".into(), |pid| pid.to_string());
            format!("  {:<14} {:<10} pid {pid:<8} restarts {}", s.name, s.phase.name(), s.restarts)
        })
        .collect()
}

/// How each process of the rig is started: this very executable with the rig and the domain.
fn launches(rig: &Rig, path: &Path, domain: &DomainName) -> std::io::Result<Vec<Launch>> {
    let executable = std::env::current_exe()?;
    let path = path.canonicalize()?;
    let mut launches: Vec<Launch> = Vec::new();
    for process in &rig.processes {
        let same = launches.iter().filter(|l| l.name.split('#').next() == Some(&process.command)).count();
        let name = match same {
            0 => process.command.clone(),
            n => format!("{}#{}", process.command, n + 1),
        };
        let finishes_writing = process.command == "record";
        launches.push(Launch {
            name,
            executable: executable.clone(),
            arguments: arguments(process, &path, domain),
            restart: process.restart,
            stop_patience: if finishes_writing { WRITER_PATIENCE } else { STOP_PATIENCE },
            finishes_writing,
        });
    }
    Ok(launches)
}

fn arguments(process: &ProcessSpec, rig: &Path, domain: &DomainName) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = Vec::new();
    if !process.affinity.is_empty() {
        let cpus: Vec<String> = process.affinity.iter().map(ToString::to_string).collect();
        arguments.extend(["--cpus".into(), cpus.join(",").into()]);
    }
    if let Some(priority) = process.priority {
        arguments.extend(["--priority".into(), priority.to_string().into()]);
    }
    arguments.extend([
        process.command.as_str().into(),
        "--rig".into(),
        rig.into(),
        "--domain".into(),
        domain.as_str().into(),
    ]);
    arguments.extend(process.args.iter().map(Into::into));
    arguments
}

/// Says what happens: for people on standard error, for scripts on standard output.
#[derive(Debug)]
struct Narrator {
    events: bool,
    live: LiveLines,
    /// Ends that were not in order.
    ended_badly: usize,
    given_up: Option<String>,
}

impl Narrator {
    fn tell(&mut self, happening: &Happening) {
        if let Happening::Ended { again_in, well, .. } = happening
            && (again_in.is_some() || !well)
        {
            self.ended_badly += 1;
        }
        if let Happening::GivenUp { name, .. } = happening {
            self.given_up = Some(name.clone());
        }
        if self.events {
            println!("{}", as_json(happening));
        }
        self.live.say(&as_text(happening));
    }

    /// A process that lives, but does not do its work.
    fn warn(&mut self, name: &str, pid: u32, what: &str) {
        if self.events {
            let t_ns = MonotonicClock.now().as_ns();
            println!(
                "{}",
                json!({"t_ns": t_ns, "event": "silent", "process": name, "pid": pid, "what": what})
            );
        }
        self.live.say(&format!("{name}: {what}"));
    }
}

fn as_text(happening: &Happening) -> String {
    match happening {
        Happening::Started { name, pid } => format!("{name}: started (pid {pid})"),
        Happening::Ready { name, after, .. } => format!("{name}: ready after {} ms", after.as_millis()),
        Happening::Line { name, line } => format!("{name}| {line}"),
        Happening::Ended { name, how, again_in: Some(wait), .. } => {
            format!("{name}: {how}; it is started again in {} ms", wait.as_millis())
        }
        Happening::Ended { name, how, again_in: None, .. } => format!("{name}: {how}"),
        Happening::GivenUp { name, .. } => format!("{name}: given up, it never became ready"),
    }
}

fn as_json(happening: &Happening) -> serde_json::Value {
    let t_ns = MonotonicClock.now().as_ns();
    match happening {
        Happening::Started { name, pid } => {
            json!({"t_ns": t_ns, "event": "started", "process": name, "pid": pid})
        }
        Happening::Ready { name, pid, after } => json!({
            "t_ns": t_ns, "event": "ready", "process": name, "pid": pid, "after_ms": after.as_secs_f64() * 1e3,
        }),
        Happening::Line { name, line } => {
            json!({"t_ns": t_ns, "event": "line", "process": name, "line": line})
        }
        Happening::Ended { name, pid, how, again_in, .. } => json!({
            "t_ns": t_ns, "event": "ended", "process": name, "pid": pid, "how": how,
            "again_in_ms": again_in.map(|wait| wait.as_secs_f64() * 1e3),
        }),
        Happening::GivenUp { name, last_lines } => {
            json!({"t_ns": t_ns, "event": "given-up", "process": name, "last_lines": last_lines})
        }
    }
}
