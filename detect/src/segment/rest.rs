//! Tells what stays where it is from what flies.

/// Most things watched at a time.
const MOST: usize = 48;

/// How far something at rest may seem to move, in diameters and px: noise of the measurement, and things
/// that shake.
const STILL_SHARE: f64 = 0.1;
const STILL_PX: f64 = 1.0;

#[derive(Debug, Clone, Copy)]
struct Watched {
    anchor: [f64; 2],
    frames: u32,
    missed: u32,
}

impl Watched {
    fn is_within(&self, reach: f64, place: [f64; 2]) -> bool {
        (self.anchor[0] - place[0]).hypot(self.anchor[1] - place[1]) <= reach
    }
}

/// Watches where candidates are from frame to frame.
#[derive(Debug)]
pub struct RestWatch {
    watched: Vec<Watched>,
    enough: u32,
    /// How far something slow comes between frames, diameters.
    slow_share: f64,
}

/// Time in one place after which something is at rest. A ball at the top of its flight stays within a
/// millimetre of one place for 30 ms only.
const REST_S: f64 = 0.15;

/// Balls in flight are faster, diameters a second: 2 m/s.
const SLOW_DIAMETERS_S: f64 = 50.0;

/// Frames for which something may be hidden before it is forgotten.
const PATIENCE: u32 = 10;

impl RestWatch {
    /// For a camera at `rate_hz`.
    pub fn new(rate_hz: f64) -> Self {
        Self {
            watched: Vec::with_capacity(MOST),
            enough: (REST_S * rate_hz).ceil().clamp(3.0, 1e4) as u32,
            slow_share: SLOW_DIAMETERS_S / rate_hz,
        }
    }

    /// For how many frames something has been at `place`; changes nothing.
    pub fn frames_at(&self, place: [f64; 2], diameter: f64) -> u32 {
        self.find(place, diameter).map_or(0, |i| self.watched[i].frames)
    }

    /// Whether what is at `place` has come to rest.
    pub fn is_at_rest(&self, place: [f64; 2], diameter: f64) -> bool {
        self.frames_at(place, diameter) >= self.enough
    }

    /// Whether something was seen in the last frame from which it takes no ball in flight to come to `place`.
    pub fn is_slow(&self, place: [f64; 2], diameter: f64) -> bool {
        let reach = STILL_PX + (STILL_SHARE + self.slow_share) * diameter;
        self.watched.iter().any(|w| w.missed <= 1 && w.is_within(reach, place))
    }

    fn find(&self, place: [f64; 2], diameter: f64) -> Option<usize> {
        let reach = STILL_PX + STILL_SHARE * diameter;
        self.watched.iter().position(|w| w.is_within(reach, place))
    }

    /// Begins a frame.
    pub fn next_frame(&mut self) {
        for watched in &mut self.watched {
            watched.missed += 1;
        }
        self.watched.retain(|w| w.missed <= PATIENCE);
    }

    /// Takes note of a candidate of the present frame.
    pub fn see(&mut self, place: [f64; 2], diameter: f64) {
        match self.find(place, diameter) {
            Some(i) => {
                let watched = &mut self.watched[i];
                watched.missed = 0;
                watched.frames = watched.frames.saturating_add(1);
            }
            None if self.watched.len() < MOST => {
                self.watched.push(Watched { anchor: place, frames: 1, missed: 0 });
            }
            None => {}
        }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.watched.clear();
    }
}
