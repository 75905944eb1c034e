//! What the page is told.

use std::sync::Arc;

use netcord_calib::session::{Phase, Status, Task};
use serde::Serialize;

use super::{super::source::RawShot, Engine, SHOTS_SHOWN};

#[derive(Serialize)]
struct State<'a> {
    version: u64,
    /// The shot that the cameras' corners belong to.
    shot: u64,
    rig: String,
    board: &'a str,
    folder: String,
    source: SourceState,
    tasks: Vec<TaskState>,
    session: Status,
    step: Option<(&'a str, f64)>,
    trouble: Option<&'a str>,
}

#[derive(Serialize)]
struct SourceState {
    kind: &'static str,
    position: Option<(usize, usize)>,
    ended: bool,
}

#[derive(Serialize)]
struct TaskState {
    task: Task,
    views: usize,
    phase: Phase,
    has_result: bool,
}

impl Engine {
    /// Tells the page how things stand, with the pictures of a shot that was just looked at.
    pub(super) fn publish(&self, raw: Option<&RawShot>) {
        let tasks = self.sessions.iter().map(|s| TaskState {
            task: s.setup().task,
            views: s.kept().len(),
            phase: s.phase(),
            has_result: s.outcome().is_some(),
        });
        let state = State {
            version: 0,
            shot: 0,
            rig: self.rig.display().to_string(),
            board: &self.board,
            folder: self.folder.root().display().to_string(),
            source: SourceState {
                kind: self.source.kind(),
                position: self.source.position(),
                ended: self.state.ended,
            },
            tasks: tasks.collect(),
            session: self.sessions[self.active].status(),
            step: self.state.step.as_ref().map(|(what, share)| (what.as_str(), *share)),
            trouble: self.state.trouble.as_deref(),
        };
        self.desk.publish(|published| {
            if let Some(raw) = raw {
                let number = published.pictures.back().map_or(1, |(number, _)| number + 1);
                let pictures = raw.lumas().into_iter().map(|luma| luma.map(Arc::clone)).collect();
                published.pictures.push_back((number, pictures));
                if published.pictures.len() > SHOTS_SHOWN {
                    published.pictures.pop_front();
                }
            }
            let shot = published.pictures.back().map_or(0, |(number, _)| *number);
            let state = State { shot, version: published.version + 1, ..state };
            published.state =
                serde_json::to_string(&state).expect("texts and numbers always have a JSON form").into();
            published.task = Some(self.task());
            published.shown = self.state.shown.get(self.active).cloned().flatten();
        });
    }
}
