//! Renders a synthetic rally as footage for emulated cameras, with its truth:
//! `usb-footage RIG.toml FRAMES FOOTAGE TRUTH.csv`. Frame n shows the scene n intervals of the rig after its
//! beginning; the truth has a row `frame,x,y,z` for each frame whose ball both of the first two cameras see
//! well.

use std::{
    env,
    error::Error,
    fs::File,
    io::{BufWriter, Write},
    path::Path,
    process::ExitCode,
    sync::Arc,
};

use netcord_capture::synthetic::{
    render::{Exposure, FrameRenderer},
    scene::{Preset, Scene, SceneOptions},
};
use netcord_common::rig::Rig;
use netcord_emulator::footage::{FootageSize, begin};

/// Of a ball that is well seen, at least this share is in the frame and not hidden.
const WELL_SEEN: f64 = 0.9;

fn run(words: &[String]) -> Result<(), Box<dyn Error>> {
    let [rig, frames, footage, truth] = words else {
        return Err("usb-footage RIG.toml FRAMES FOOTAGE TRUTH.csv".into());
    };
    let rig = Rig::load(Path::new(rig))?;
    let frames: u32 = frames.parse()?;
    let options = SceneOptions { preset: Preset::Clean, seed: 3, ..SceneOptions::default() };
    let scene = Arc::new(Scene::new(&rig, &options)?);
    let model = &rig.cameras.first().ok_or("the rig has no camera")?.model;
    let cameras = u32::try_from(rig.cameras.len())?;
    let mut out = BufWriter::new(File::create(footage)?);
    begin(&mut out, FootageSize { cameras, frames, width: model.width, height: model.height })?;
    let mut seen = vec![0; frames as usize];
    let mut balls = vec![None; frames as usize];
    for camera in &rig.cameras {
        let mut renderer = FrameRenderer::new(&scene, camera);
        let mut picture = vec![0; camera.model.width as usize * camera.model.height as usize];
        for frame in 0..frames {
            let mid_s = f64::from(frame) / rig.rate_hz;
            let exposure =
                Exposure { frame: frame.into(), mid_s, length_s: camera.exposure_ns as f64 * 1e-9 };
            let truth = renderer.render(&exposure, &mut picture);
            out.write_all(&picture)?;
            seen[frame as usize] += usize::from(truth.visible >= WELL_SEEN);
            balls[frame as usize] = renderer.ball_at(mid_s);
        }
    }
    out.flush()?;
    let mut out = BufWriter::new(File::create(truth)?);
    writeln!(out, "frame,x,y,z")?;
    for (frame, ball) in balls.iter().enumerate() {
        if let (Some(ball), true) = (ball, seen[frame] >= 2) {
            let p = ball.state.position;
            writeln!(out, "{frame},{},{},{}", p.x, p.y, p.z)?;
        }
    }
    Ok(out.flush()?)
}

fn main() -> ExitCode {
    let words: Vec<String> = env::args().skip(1).collect();
    match run(&words) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("{e}");
            ExitCode::from(2)
        }
    }
}
