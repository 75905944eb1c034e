use std::collections::BTreeMap;

use netcord_common::wire::{NoPosition, PositionOutcome};

use super::{FrameReport, Latencies, LatencyReport, Losses, Observed};

/// Everything that `latency` and `up` show of a running rig.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    latencies: Latencies,
    losses: Losses,
    positions: u64,
    none: BTreeMap<&'static str, u64>,
    first_ns: Option<u64>,
    last_ns: u64,
    last_position_m: Option<[f64; 3]>,
}

impl Tally {
    /// Takes in a message.
    pub fn see(&mut self, seen: &Observed<'_>) {
        match seen {
            Observed::Frameset(frameset) => self.losses.frameset(frameset),
            Observed::Detections(detections) => self.losses.detections(detections),
            Observed::Health(health) => self.losses.health(health),
            Observed::Trajectory(trajectory) => self.latencies.trajectory(trajectory),
            Observed::Truth(_) => {}
            Observed::Position(position) => {
                self.latencies.position(position);
                let at = position.stamps.triangulate_published_ns;
                self.first_ns.get_or_insert(at);
                self.last_ns = self.last_ns.max(at);
                match position.outcome() {
                    PositionOutcome::Position => {
                        self.positions += 1;
                        self.last_position_m = Some(position.position_m);
                    }
                    PositionOutcome::None(reason) => {
                        *self.none.entry(NoPosition::name(reason)).or_default() += 1
                    }
                }
            }
        }
    }

    /// Triggers a second that got a position or the reason why there is none.
    pub fn rate_hz(&self) -> Option<f64> {
        let triggers = self.positions + self.none.values().sum::<u64>();
        let seconds = self.last_ns.checked_sub(self.first_ns?)? as f64 * 1e-9;
        (triggers > 1 && seconds > 0.0).then(|| (triggers - 1) as f64 / seconds)
    }

    /// Positions so far.
    pub const fn positions(&self) -> u64 {
        self.positions
    }

    /// Triggers without a position so far, by reason.
    pub const fn without_position(&self) -> &BTreeMap<&'static str, u64> {
        &self.none
    }

    /// Latencies so far.
    pub fn latencies(&self) -> LatencyReport {
        self.latencies.report()
    }

    /// Frames so far.
    pub fn frames(&self) -> FrameReport {
        self.losses.report()
    }

    /// All of it as lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        let rate = self.rate_hz().map_or_else(|| "-".into(), |rate| format!("{rate:.1} Hz"));
        let ball = self.last_position_m.map_or_else(
            || "no ball seen yet".into(),
            |[x, y, z]| format!("ball at ({x:+.3}, {y:+.3}, {z:+.3}) m"),
        );
        lines.push(format!("  {rate}, {} positions, {ball}", self.positions));
        lines.push(format!(
            "  {:<22}{:>9}{:>9}{:>9}{:>9}{:>9}",
            "latency, ms", "p50", "p90", "p99", "p99.9", "max"
        ));
        for (name, quantiles) in self.latencies().rows() {
            lines.push(match quantiles {
                Some(q) => format!(
                    "  {name:<22}{:>9.3}{:>9.3}{:>9.3}{:>9.3}{:>9.3}",
                    q.p50, q.p90, q.p99, q.p999, q.max
                ),
                None => format!("  {name:<22}{:>9}", "-"),
            });
        }
        let frames = self.frames();
        let mut text = format!(
            "  frames: {} published, {} lost, {} unsynchronised",
            frames.published, frames.lost, frames.unsynchronised
        );
        for (reason, count) in &frames.lost_by_reason {
            text.push_str(&format!("; {reason} {count}"));
        }
        lines.push(text);
        if !self.none.is_empty() {
            let reasons: Vec<String> = self.none.iter().map(|(reason, n)| format!("{reason} {n}")).collect();
            lines.push(format!("  triggers without position: {}", reasons.join(", ")));
        }
        lines
    }
}
