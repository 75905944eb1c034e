//! The emulated camera as a peer for unit tests: no USB, and time that passes only when it is told.

use std::{
    sync::{Arc, Mutex, MutexGuard},
    time::Duration,
};

use netcord_common::Stamp;
use netcord_emulator::{Camera, CameraConfig, PatternImages, Rig};

use super::{
    FeatureAccess,
    genapi::GenApi,
    gencp::{Abrm, ControlChannel, ControlPipe, Memory, PipeError, read_description},
};

/// Emulated cameras and their time.
#[derive(Clone)]
pub(crate) struct Bench {
    inner: Arc<Mutex<(Rig, u64)>>,
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self::of([CameraConfig::default()])
    }

    pub(crate) fn of(configs: impl IntoIterator<Item = CameraConfig>) -> Self {
        let cameras = configs.into_iter().map(|c| Camera::new(c, Box::new(PatternImages))).collect();
        Self { inner: Arc::new(Mutex::new((Rig { cameras, wires: Vec::new() }, 1_000_000))) }
    }

    pub(crate) fn lock(&self) -> MutexGuard<'_, (Rig, u64)> {
        self.inner.lock().expect("no test thread panics with it")
    }

    pub(crate) fn now(&self) -> u64 {
        self.lock().1
    }

    pub(crate) fn pass(&self, time: Duration) {
        let mut inner = self.lock();
        inner.1 += u64::try_from(time.as_nanos()).expect("short");
        let now = inner.1;
        inner.0.advance(now);
    }

    pub(crate) fn channel(&mut self, camera: usize) -> ControlChannel<BenchPipe> {
        ControlChannel::new(BenchPipe { bench: self.clone(), camera })
    }
}

/// An emulated camera's features, through its own description.
pub(crate) struct BenchFeatures {
    api: GenApi,
    channel: ControlChannel<BenchPipe>,
}

impl BenchFeatures {
    pub(crate) fn of(config: CameraConfig) -> Self {
        let mut channel = Bench::of([config]).channel(0);
        let abrm = Abrm::read(&mut channel).expect("registers");
        let description = read_description(&mut channel, abrm.manifest).expect("a description");
        Self { api: GenApi::load(&description).expect("valid"), channel }
    }
}

impl FeatureAccess for BenchFeatures {
    fn parts(&mut self) -> (&mut GenApi, &mut dyn Memory) {
        (&mut self.api, &mut self.channel)
    }
}

pub(crate) struct BenchPipe {
    bench: Bench,
    camera: usize,
}

impl ControlPipe for BenchPipe {
    fn send(&mut self, packet: &[u8], _: Duration) -> Result<(), PipeError> {
        self.bench.pass(Duration::from_micros(50));
        let mut inner = self.bench.lock();
        let now = inner.1;
        let camera = &mut inner.0.cameras[self.camera];
        if camera.control_stalled() {
            return Err(PipeError::Stalled);
        }
        camera.command(packet, now);
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PipeError> {
        let until = self.bench.now() + u64::try_from(timeout.as_nanos()).expect("short");
        loop {
            {
                let mut inner = self.bench.lock();
                let now = inner.1;
                let camera = &mut inner.0.cameras[self.camera];
                if camera.control_stalled() {
                    return Err(PipeError::Stalled);
                }
                if let Some(reply) = camera.reply(now) {
                    buffer[..reply.len()].copy_from_slice(&reply);
                    return Ok(reply.len());
                }
                if now >= until {
                    return Err(PipeError::TimedOut);
                }
            }
            self.bench.pass(Duration::from_millis(1));
        }
    }

    fn clear_halt(&mut self) -> Result<(), PipeError> {
        self.bench.lock().0.cameras[self.camera].clear_control_halt();
        Ok(())
    }

    fn now(&self) -> Stamp {
        Stamp::from_ns(self.bench.now())
    }
}
