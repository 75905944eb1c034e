use std::{
    collections::VecDeque,
    error::Error,
    sync::Arc,
    time::{Duration, Instant},
};

use netcord_calib::{detect::Luma, gather::Rejection};
use netcord_common::{
    CameraName, DomainName, FrameView,
    bus::{Bus, Frame, FrameSubscriber, Topic},
};
use rayon::prelude::*;

use super::{Next, Picture, RawShot, Source};

/// Frames of each camera that are held until the others' of the same trigger are there.
const HELD: usize = 3;
/// Looks a second, at most: more would take time from the pipeline, and show nobody anything new.
const LOOK_EVERY: Duration = Duration::from_millis(120);
/// How long asking waits for a frame.
const WAIT: Duration = Duration::from_millis(50);

/// The frames of a running rig: at each look the newest that all cameras have of one trigger.
#[derive(Debug)]
pub struct LiveSource {
    cameras: Vec<LiveCamera>,
    looked: Instant,
    last_trigger: u64,
}

#[derive(Debug)]
struct LiveCamera {
    frames: FrameSubscriber,
    held: VecDeque<Frame>,
}

impl LiveSource {
    /// Reads the frames of `cameras` in `domain`.
    ///
    /// # Errors
    /// When the domain cannot be joined.
    pub fn attach(domain: &DomainName, cameras: &[String]) -> Result<Self, Box<dyn Error>> {
        let bus = Bus::join(domain, "calib")?;
        let cameras = cameras
            .iter()
            .map(|name| {
                let frames =
                    FrameSubscriber::open(&bus, &Topic::frames(&CameraName::new(name.as_str())?), 2)?;
                Ok(LiveCamera { frames, held: VecDeque::new() })
            })
            .collect::<Result<_, Box<dyn Error>>>()?;
        Ok(Self { cameras, looked: Instant::now(), last_trigger: 0 })
    }

    /// The newest trigger that most cameras have a frame of.
    fn trigger(&self) -> Option<u64> {
        let of = |id: u64| {
            self.cameras.iter().filter(|c| c.held.iter().any(|f| f.header().trigger_id == id)).count()
        };
        let ids = self.cameras.iter().flat_map(|c| c.held.iter().map(|f| f.header().trigger_id));
        ids.map(|id| (of(id), id)).max().map(|(_, id)| id)
    }
}

impl Source for LiveSource {
    fn kind(&self) -> &'static str {
        "live"
    }

    fn next(&mut self) -> Result<Next, Box<dyn Error>> {
        if let Some(rest) = LOOK_EVERY.checked_sub(self.looked.elapsed()) {
            std::thread::sleep(rest.min(WAIT));
        }
        // What waited in the queues is old: the newest of each camera are kept.
        for camera in &mut self.cameras {
            while let Some(frame) = camera.frames.receive()? {
                camera.held.push_back(frame);
                if camera.held.len() > HELD {
                    camera.held.pop_front();
                }
            }
        }
        if self.looked.elapsed() < LOOK_EVERY {
            return Ok(Next::NotYet);
        }
        let Some(trigger) = self.trigger().filter(|t| *t != self.last_trigger) else {
            if let Some(first) = self.cameras.first() {
                first.frames.wait(WAIT)?;
            }
            return Ok(Next::NotYet);
        };
        self.looked = Instant::now();
        self.last_trigger = trigger;
        let frames: Vec<Option<Frame>> = self
            .cameras
            .iter_mut()
            .map(|c| {
                let frame = c.held.drain(..).find(|f| f.header().trigger_id == trigger);
                c.held.clear();
                frame
            })
            .collect();
        let views: Vec<_> = frames
            .iter()
            .map(|f| {
                f.as_ref().map(|f| (FrameView::of(f.header(), f.bytes()), f.header().stamps.mid_exposure_ns))
            })
            .collect();
        let pictures = views
            .par_iter()
            .map(|view| {
                view.as_ref().map(|(view, stamp)| match view {
                    Ok(view) => Ok(Picture { luma: Arc::new(Luma::of_frame(view)), stamp_ns: Some(*stamp) }),
                    Err(e) => Err(Rejection::Unreadable(e.to_string())),
                })
            })
            .collect();
        Ok(Next::Shot(RawShot { name: format!("trigger{trigger}"), pictures }))
    }

    fn is_continuous(&self) -> bool {
        true
    }
}
