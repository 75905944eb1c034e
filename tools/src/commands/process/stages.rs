use netcord_capture::recording::{FilmedTrigger, FramePixels};
use netcord_common::{
    Clock as _, FrameView, MonotonicClock, Stamp,
    rig::Rig,
    wire::{BallPosition, BallTrajectory, Detections, FrameHeader, Frameset, Scope, SearchWindow, Verdict},
};
use netcord_detect::{
    flight::{PredictOptions, Predictor},
    segment::{SegmentError, SegmentOptions, Segmenter},
    triangulate::{Matcher, TriangulateOptions},
};

/// One frame of the recording, as capture would hand it on.
#[derive(Debug, Clone)]
pub(super) struct Frame {
    pub(super) header: FrameHeader,
    pub(super) pixels: FramePixels,
}

/// The frames of one trigger, by camera in rig order.
#[derive(Debug)]
pub(super) struct Exposure {
    pub(super) trigger: FilmedTrigger,
    pub(super) frames: Vec<Option<Frame>>,
}

/// What the stages made of one trigger.
#[derive(Debug)]
pub(super) struct Results {
    /// Of each camera its messages, in the order in which the segmenter gave them.
    pub(super) detections: Vec<Vec<Detections>>,
    /// The window that each camera was searched with.
    pub(super) windows: Vec<Option<SearchWindow>>,
    pub(super) position: Option<BallPosition>,
    pub(super) trajectory: Option<Box<BallTrajectory>>,
    pub(super) verdict: Verdict,
    pub(super) spent: Spent,
}

/// Computing time of one trigger, ns: the only thing here that depends on the machine.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spent {
    /// Of the camera that took longest, both searches.
    pub(super) segment: u64,
    pub(super) triangulate: u64,
    pub(super) predict: u64,
}

/// The stages of the live pipeline in one process, in lockstep: frame n is searched with the window that
/// was predicted from frame n − 1. So the results depend on the frames alone, not on threads or time.
pub(super) struct Stages {
    rig: Rig,
    segmenters: Vec<Segmenter>,
    matcher: Matcher,
    predictor: Predictor,
    windows: Vec<Option<SearchWindow>>,
}

/// A segmenter's work on one frame, and how long it took, ns.
type Found = Result<(Vec<Detections>, u64), SegmentError>;

impl Stages {
    pub(super) fn new(rig: &Rig, look_for: &SegmentOptions) -> Result<Self, SegmentError> {
        let segmenters = (0..rig.cameras.len())
            .map(|camera| Segmenter::new(rig, camera, look_for.clone()))
            .collect::<Result<_, _>>()?;
        Ok(Self {
            rig: rig.clone(),
            segmenters,
            matcher: Matcher::new(rig, &TriangulateOptions::default()),
            predictor: Predictor::new(rig, PredictOptions::default()),
            windows: vec![None; rig.cameras.len()],
        })
    }

    /// Lets the background learn from a trigger, and forgets what was found in it.
    pub(super) fn warm_up(&mut self, exposure: &Exposure) -> Result<(), SegmentError> {
        self.segment(exposure).into_iter().try_for_each(|found| found.map(drop))
    }

    /// One trigger, in the order of the recording.
    pub(super) fn step(&mut self, exposure: &Exposure) -> Result<Results, SegmentError> {
        let found = self.segment(exposure).into_iter().collect::<Result<Vec<_>, _>>()?;
        let segment = found.iter().map(|(_, spent)| *spent).max().unwrap_or(0);
        let detections = found.into_iter().map(|(detections, _)| detections).collect::<Vec<_>>();
        let began = MonotonicClock.now();
        let frameset = self.frameset(exposure);
        // The matcher's clock is the recording's: all of a trigger arrives at its exposure, window searches
        // first, as in the live pipeline.
        let now = frameset.mid_exposure_ns.iter().copied().max().unwrap_or(0);
        self.matcher.offer_frameset(&frameset, now);
        let mut position = None;
        for scope in [Scope::Window, Scope::Full] {
            let all = detections.iter().flatten();
            all.filter(|d| d.scope == scope.code()).for_each(|d| self.matcher.offer(d, now));
            while let Some(found) = self.matcher.next(now) {
                position = Some(found);
            }
        }
        let triangulate = since(began);
        let windows = self.windows.clone();
        let began = MonotonicClock.now();
        let trajectory = position.as_ref().map(|position| {
            let trajectory = Box::new(*self.predictor.update(position));
            let next = position.stamps.mid_exposure_ns + self.rig.interval_ns();
            for (slot, window) in self.windows.iter_mut().zip(self.predictor.windows(next)) {
                *slot = Some(window);
            }
            trajectory
        });
        let spent = Spent { segment, triangulate, predict: since(began) };
        let verdict = Verdict::from_code(frameset.verdict).unwrap_or(Verdict::Incomplete);
        Ok(Results { detections, windows, position, trajectory, verdict, spent })
    }

    /// All cameras at the same time.
    fn segment(&mut self, exposure: &Exposure) -> Vec<Found> {
        let windows = &self.windows;
        let segmenters = &mut self.segmenters;
        let mut found: Vec<Found> = exposure.frames.iter().map(|_| Ok((Vec::new(), 0))).collect();
        rayon::scope(|scope| {
            let work = segmenters.iter_mut().zip(&exposure.frames).zip(windows).zip(&mut found);
            for (((segmenter, frame), window), found) in work {
                let Some(frame) = frame else { continue };
                scope.spawn(move |_| *found = segment_one(segmenter, frame, window.as_ref()));
            }
        });
        found
    }

    /// What capture would say of the trigger.
    fn frameset(&self, exposure: &Exposure) -> Frameset {
        let mut frameset = Frameset {
            trigger_id: exposure.trigger.id,
            tolerance_ns: self.rig.tolerance_ns,
            expected: self.rig.camera_mask(),
            ..Frameset::default()
        };
        for (camera, frame) in self.rig.cameras.iter().zip(&exposure.frames) {
            let Some(frame) = frame else { continue };
            frameset.delivered |= camera.index.bit();
            frameset.mid_exposure_ns[camera.index.get()] = frame.header.stamps.mid_exposure_ns;
        }
        let stamps = || exposure.frames.iter().flatten().map(|f| f.header.stamps.mid_exposure_ns);
        frameset.skew_ns = stamps().max().unwrap_or(0) - stamps().min().unwrap_or(0);
        let verdict = if frameset.skew_ns > frameset.tolerance_ns {
            Verdict::Unsynchronised
        } else if frameset.delivered != frameset.expected {
            Verdict::Incomplete
        } else {
            Verdict::Complete
        };
        frameset.verdict = verdict.code();
        frameset
    }
}

fn segment_one(segmenter: &mut Segmenter, frame: &Frame, window: Option<&SearchWindow>) -> Found {
    let header = &frame.header;
    // Footage has checked size and step against the bytes of this frame.
    let view = FrameView::of(header, frame.pixels.as_ref()).expect("checked when the recording was opened");
    let mut found = Vec::with_capacity(2);
    let began = MonotonicClock.now();
    segmenter.process(header, &view, window, &mut |detections| found.push(*detections))?;
    Ok((found, since(began)))
}

fn since(began: Stamp) -> u64 {
    MonotonicClock.now().as_ns() - began.as_ns()
}
