use hdrhistogram::Histogram;
use netcord_common::wire::{BallPosition, BallTrajectory, Stamps};
use serde::Serialize;

/// The latencies that reports hold, in the order in which they are shown.
pub const LATENCIES: [&str; 6] =
    ["capture", "segment", "triangulate", "predict", "frame_to_position", "exposure_to_position"];

/// Latencies of positions, per stage and end to end, in bounded memory.
///
/// From the stamps that every message carries: `capture` is mid-exposure → frame published, each other
/// stage its predecessor's publication → its own (so waiting and waking count for the stage that was
/// woken), `frame_to_position` frame complete in memory → position published, `exposure_to_position`
/// mid-exposure → position published.
#[derive(Debug, Clone)]
pub struct Latencies {
    histograms: [Histogram<u64>; LATENCIES.len()],
}

/// Latencies from 100 ns to 10 s, to 1 part in 1000.
fn histogram() -> Histogram<u64> {
    let mut histogram = Histogram::new_with_bounds(100, 10_000_000_000, 3).expect("valid bounds");
    histogram.auto(true);
    histogram
}

impl Default for Latencies {
    fn default() -> Self {
        Self { histograms: std::array::from_fn(|_| histogram()) }
    }
}

/// `to − from` of one position's stamps, in nanoseconds; `None` where a stage was not reached.
fn spans(s: &Stamps) -> [Option<u64>; LATENCIES.len()] {
    let span = |from: u64, to: u64| (from != 0 && to >= from).then(|| to - from);
    [
        span(s.mid_exposure_host_ns, s.frame_published_ns),
        span(s.frame_published_ns, s.segment_published_ns),
        span(s.segment_published_ns, s.triangulate_published_ns),
        span(s.triangulate_published_ns, s.predict_published_ns),
        span(s.frame_complete_ns, s.triangulate_published_ns),
        span(s.mid_exposure_host_ns, s.triangulate_published_ns),
    ]
}

/// Place of `predict` in [`LATENCIES`]: the only one that needs the trajectory.
const PREDICT: usize = 3;

impl Latencies {
    /// Takes in a position; where there is none, nothing has arrived and nothing counts.
    pub fn position(&mut self, position: &BallPosition) {
        if position.is_present() {
            self.record(&position.stamps, |i| i != PREDICT);
        }
    }

    /// Takes in a trajectory.
    pub fn trajectory(&mut self, trajectory: &BallTrajectory) {
        self.record(&trajectory.stamps, |i| i == PREDICT);
    }

    /// Takes in all spans that `stamps` tell.
    pub fn spans_of(&mut self, stamps: &Stamps) {
        self.record(stamps, |_| true);
    }

    fn record(&mut self, stamps: &Stamps, wanted: impl Fn(usize) -> bool) {
        for (i, (histogram, span)) in self.histograms.iter_mut().zip(spans(stamps)).enumerate() {
            if let Some(span) = span.filter(|_| wanted(i)) {
                histogram.saturating_record(span);
            }
        }
    }

    /// The quantiles so far.
    pub fn report(&self) -> LatencyReport {
        let [capture, segment, triangulate, predict, frame_to_position, exposure_to_position] =
            std::array::from_fn(|i| Quantiles::of(&self.histograms[i]));
        LatencyReport { frame_to_position, exposure_to_position, capture, segment, triangulate, predict }
    }
}

/// Quantiles in milliseconds; each is absent where nothing was measured.
#[derive(Debug, Clone, Serialize)]
pub struct LatencyReport {
    /// Frame complete in memory → position published.
    pub frame_to_position: Option<Quantiles>,
    /// Mid-exposure → position published.
    pub exposure_to_position: Option<Quantiles>,
    /// Mid-exposure → frame published.
    pub capture: Option<Quantiles>,
    /// Frame published → detections published.
    pub segment: Option<Quantiles>,
    /// Detections published → position published.
    pub triangulate: Option<Quantiles>,
    /// Position published → trajectory published.
    pub predict: Option<Quantiles>,
}

impl LatencyReport {
    /// All, under their names, in the order of [`LATENCIES`].
    pub fn rows(&self) -> [(&'static str, Option<Quantiles>); LATENCIES.len()] {
        let rows = [
            self.capture,
            self.segment,
            self.triangulate,
            self.predict,
            self.frame_to_position,
            self.exposure_to_position,
        ];
        std::array::from_fn(|i| (LATENCIES[i], rows[i]))
    }
}

/// Quantiles of a latency, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// Median.
    pub p50: f64,
    /// 90 %.
    pub p90: f64,
    /// 99 %.
    pub p99: f64,
    /// 99.9 %.
    pub p999: f64,
    /// The longest.
    pub max: f64,
}

impl Quantiles {
    fn of(histogram: &Histogram<u64>) -> Option<Self> {
        let at = |q: f64| histogram.value_at_quantile(q) as f64 * 1e-6;
        (!histogram.is_empty()).then(|| Self {
            p50: at(0.5),
            p90: at(0.9),
            p99: at(0.99),
            p999: at(0.999),
            max: histogram.max() as f64 * 1e-6,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_come_from_the_stamps_and_absence_is_no_zero() {
        let mut latencies = Latencies::default();
        for i in 1..=1000_u64 {
            let stamps = Stamps {
                mid_exposure_host_ns: 1_000_000_000,
                frame_complete_ns: 1_003_000_000,
                frame_published_ns: 1_003_100_000,
                segment_published_ns: 1_003_500_000,
                triangulate_published_ns: 1_003_000_000 + i * 10_000,
                ..Stamps::default()
            };
            latencies.position(&BallPosition { stamps, ..BallPosition::default() });
        }
        latencies.position(&BallPosition { reason: 1, ..BallPosition::default() });
        let report = latencies.report();
        let q = report.frame_to_position.expect("measured");
        assert!(
            (q.p50 - 5.0).abs() < 0.02 && (q.p99 - 9.9).abs() < 0.02 && (q.max - 10.0).abs() < 0.02,
            "{q:?}"
        );
        let exposure = report.exposure_to_position.expect("measured");
        assert!((exposure.p50 - 8.0).abs() < 0.02);
        assert!((report.capture.expect("measured").max - 3.1).abs() < 0.01);
        assert_eq!(report.predict, None);
    }
}
