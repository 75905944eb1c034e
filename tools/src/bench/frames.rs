use std::sync::Arc;

use netcord_capture::synthetic::{
    render::{Exposure, FrameRenderer},
    scene::{Preset, Scene, SceneError, SceneOptions},
};
use netcord_common::{
    rig::Rig,
    wire::{CameraTruth, FrameHeader, Stamps},
};

/// Rendered frames of one camera, taken in turn from more memory than caches hold.
#[derive(Debug)]
pub struct FrameRing {
    frames: Vec<(FrameHeader, Vec<u8>, CameraTruth)>,
}

/// No cache is larger than this.
const RING_BYTES: usize = 136 << 20;

impl FrameRing {
    /// Renders frames of the rig's first camera, one interval apart, until the ring is larger than caches.
    ///
    /// # Errors
    /// As [`Scene::new`].
    pub fn render(rig: &Rig, preset: Preset, seed: u64) -> Result<Self, SceneError> {
        let options = SceneOptions { preset, seed, ..SceneOptions::default() };
        let scene = Arc::new(Scene::new(rig, &options)?);
        let camera = &rig.cameras[0];
        let mut renderer = FrameRenderer::new(&scene, camera);
        let (width, height) = (camera.model.width, camera.model.height);
        let bytes = width as usize * height as usize;
        let interval_s = rig.interval_ns() as f64 * 1e-9;
        let exposure_ns = scene.exposure_ns.unwrap_or(camera.exposure_ns);
        let frames = (0..RING_BYTES.div_ceil(bytes) as u64)
            .map(|frame| {
                let mid_s = 1.0 + frame as f64 * interval_s;
                let mut mosaic = vec![0; bytes];
                let exposure = Exposure { frame, mid_s, length_s: exposure_ns as f64 * 1e-9 };
                let truth = renderer.render(&exposure, &mut mosaic);
                let mid_exposure_ns = (mid_s * 1e9) as u64;
                let stamps =
                    Stamps { mid_exposure_ns, mid_exposure_host_ns: mid_exposure_ns, ..Stamps::default() };
                let header = FrameHeader {
                    trigger_id: frame + 1,
                    sequence: frame + 1,
                    session: 1,
                    stamps,
                    exposure_ns,
                    width,
                    height,
                    stride: width,
                    pixel_format: camera.pixel_format.pfnc(),
                    camera: camera.index.code(),
                    ..FrameHeader::default()
                };
                (header, mosaic, truth)
            })
            .collect();
        Ok(Self { frames })
    }

    /// Header, mosaic and truth of frame `n`, round and round; the header's counts and stamps go on.
    pub fn frame(&self, n: usize, interval_ns: u64) -> (FrameHeader, &[u8], &CameraTruth) {
        let (header, mosaic, truth) = &self.frames[n % self.frames.len()];
        let mut header = *header;
        let laps = (n / self.frames.len() * self.frames.len()) as u64;
        header.trigger_id += laps;
        header.sequence += laps;
        header.stamps.mid_exposure_ns += laps * interval_ns;
        header.stamps.mid_exposure_host_ns += laps * interval_ns;
        (header, mosaic, truth)
    }

    /// How many frames it holds.
    pub fn len(&self) -> usize {
        self.frames.len()
    }
}
