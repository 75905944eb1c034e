//! scratch
use netcord_capture::synthetic::{render::*, scene::*};
use netcord_common::rig::Rig;
use std::{path::Path, sync::Arc, time::Instant};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let rig = Rig::load(Path::new(&a[1])).unwrap();
    let preset: Preset = a[2].parse().unwrap();
    let seed: u64 = a[3].parse().unwrap();
    let t0: u64 = a[4].parse().unwrap();
    let n: u64 = a[5].parse().unwrap();
    let scene = Arc::new(Scene::new(&rig, &SceneOptions { preset, seed, ..Default::default() }).unwrap());
    for cam in &rig.cameras {
        let t = Instant::now();
        let mut r = FrameRenderer::new(&scene, cam);
        println!("{} backdrop {:?}", cam.name, t.elapsed());
        let (w, h) = (cam.model.width as usize, cam.model.height as usize);
        let mut out = vec![0u8; w * h];
        let length_s = scene.exposure_ns.unwrap_or(cam.exposure_ns) as f64 * 1e-9;
        let mut times = Vec::new();
        for k in 0..n {
            let e = Exposure { frame: t0 + k, mid_s: (t0 + k) as f64 * 0.01, length_s };
            let t = Instant::now();
            let truth = r.render(&e, &mut out);
            times.push(t.elapsed().as_micros());
            if k + 1 == n {
                println!("{truth:?} {:?}", r.ball_at(e.mid_s));
            }
        }
        times.sort();
        println!(
            "render µs min {} median {} max {}",
            times[0],
            times[times.len() / 2],
            times[times.len() - 1]
        );
        std::fs::write(format!("/tmp/synth_{}.raw", cam.name), &out).unwrap();
    }
}
