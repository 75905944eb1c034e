#![allow(clippy::all, missing_docs)]
use netcord_detect::flight::{recorded::*, *};
use std::fs;
fn med(mut v: Vec<f64>, q: f64) -> f64 {
    if v.is_empty() {
        return f64::NAN;
    }
    v.sort_by(f64::total_cmp);
    v[((v.len() - 1) as f64 * q) as usize]
}
fn hash(s: &str) -> u64 {
    s.bytes().fold(0xcbf29ce484222325u64, |h, b| (h ^ b as u64).wrapping_mul(0x100000001b3))
}
fn load(dir: &str) -> Vec<Recording> {
    let mut spins = std::collections::HashMap::new();
    if let Ok(t) = fs::read_to_string(format!("/tmp/flights/{dir}/index.csv")) {
        for l in t.lines().skip(1) {
            let c: Vec<f64> = l.split(',').map(|x| x.parse().unwrap()).collect();
            spins.insert(c[0] as u32, nalgebra::Vector3::new(c[1], c[2], c[3]));
        }
    }
    let mut f: Vec<_> = fs::read_dir(format!("/tmp/flights/{dir}"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| !p.ends_with("index.csv"))
        .collect();
    f.sort();
    f.iter()
        .map(|p| {
            let mut r =
                parse(p.file_name().unwrap().to_str().unwrap(), &fs::read_to_string(p).unwrap()).unwrap();
            r.spin_rad_s = r
                .name
                .split('.')
                .next()
                .and_then(|s| s.parse::<u32>().ok())
                .and_then(|k| spins.get(&k).copied());
            r
        })
        .collect()
}
fn all(sets: &[(&str, Vec<Recording>, Option<Table>)], o: &EvaluateOptions, train: bool) -> Vec<Evaluation> {
    std::thread::scope(|sc| {
        let h: Vec<_> = sets
            .iter()
            .map(|(_, rs, t)| {
                sc.spawn(move || {
                    let part: Vec<Recording> =
                        rs.iter().filter(|r| (hash(&r.name) % 2 == 0) == train).cloned().collect();
                    evaluate_set(
                        &part,
                        *t,
                        &EvaluateOptions { sigma_m: find_noise(rs).unwrap() * (o.sigma_m.x / 0.002), ..*o },
                    )
                })
            })
            .collect();
        h.into_iter().map(|h| h.join().unwrap()).collect()
    })
}
fn score(es: &[Evaluation]) -> f64 {
    es.iter()
        .map(|e| {
            HORIZONS_MS
                .iter()
                .map(|h| {
                    let v = e.prediction_errors_m(*h);
                    (med(v.clone(), 0.5) * 1e3).ln() + 0.3 * (med(v, 0.85) * 1e3).ln()
                })
                .sum::<f64>()
                + (0..4).map(|i| 0.5 * (med(e.landing_m[i].clone(), 0.5) * 1e3).ln()).sum::<f64>()
        })
        .sum()
}
fn show(sets: &[(&str, Vec<Recording>, Option<Table>)], es: &[Evaluation]) {
    for ((n, _, _), e) in sets.iter().zip(es) {
        print!("{n:8}");
        for h in HORIZONS_MS {
            print!(" {:6.1}", med(e.prediction_errors_m(h), 0.5) * 1e3);
        }
        print!(" | p90");
        for h in HORIZONS_MS {
            print!(" {:6.1}", med(e.prediction_errors_m(h), 0.9) * 1e3);
        }
        print!(" | land");
        for i in 0..4 {
            print!(" {:5.1}", med(e.landing_m[i].clone(), 0.5) * 1e3);
        }
        println!(
            " | spin {:.2} {:.2}",
            med(e.spin_perpendicular.clone(), 0.5),
            med(e.spin_full.clone(), 0.5)
        );
    }
    let mut a = Evaluation::default();
    for e in es {
        a.append(&mut e.clone());
    }
    print!("all     ");
    for h in HORIZONS_MS {
        print!(" {:6.1}", med(a.prediction_errors_m(h), 0.5) * 1e3);
    }
    println!();
}
fn main() {
    let sets: Vec<_> = ["tt3d", "spindoe", "mpi-pam"]
        .map(|n| {
            let r = load(n);
            let t = find_table(&r, &EvaluateOptions::default());
            (n, r, t)
        })
        .into();
    for s in &sets {
        println!("{} {:?} {:?}", s.0, s.2, find_noise(&s.1));
    }
    let mut o = EvaluateOptions::default();
    let arg: Vec<String> = std::env::args().collect();
    let names = [
        "drag", "magnus", "rest", "slope", "fric", "accel", "spinq", "bn", "bt", "bf", "ldrag", "lrest",
        "sigma", "sat", "forget",
    ];
    fn get<'a>(o: &'a mut EvaluateOptions, i: usize) -> &'a mut f64 {
        match i {
            0 => &mut o.constants.drag,
            1 => &mut o.constants.magnus,
            2 => &mut o.constants.restitution,
            3 => &mut o.constants.restitution_slope_s_m,
            4 => &mut o.constants.friction,
            5 => &mut o.tuning.noise.acceleration,
            6 => &mut o.tuning.noise.spin,
            7 => &mut o.tuning.noise.bounce.normal,
            8 => &mut o.tuning.noise.bounce.tangential,
            9 => &mut o.tuning.noise.bounce.tangential_floor_m_s,
            10 => &mut o.tuning.latitude.drag,
            11 => &mut o.tuning.latitude.restitution,
            12 => &mut o.sigma_m.x,
            13 => &mut o.constants.magnus_saturation,
            _ => &mut o.tuning.latitude.forgetting,
        }
    }
    for a in &arg[1..] {
        if let Some((k, v)) = a.split_once('=') {
            let i = names.iter().position(|n| *n == k).unwrap();
            *get(&mut o, i) = v.parse().unwrap();
        }
    }
    if arg.iter().any(|a| a == "worst") {
        for s in &sets {
            let mut l: Vec<_> =
                s.1.iter()
                    .map(|r| {
                        let e = evaluate_set(
                            std::slice::from_ref(r),
                            s.2,
                            &EvaluateOptions { sigma_m: find_noise(&s.1).unwrap(), ..o },
                        );
                        (
                            med(e.prediction_errors_m(200), 0.5) * 1e3,
                            med(e.prediction_errors_m(300), 0.5) * 1e3,
                            r.name.clone(),
                            e.flights,
                            e.predictions.len(),
                        )
                    })
                    .filter(|x| x.0.is_finite())
                    .collect();
            l.sort_by(|a, b| b.0.total_cmp(&a.0));
            for x in l.iter().take(22) {
                println!("{} {:?}", s.0, x);
            }
        }
        return;
    }
    if arg.iter().any(|a| a == "phase") {
        let es: Vec<Evaluation> = [true, false].iter().flat_map(|t| all(&sets, &o, *t)).collect();
        for (i, s) in sets.iter().enumerate() {
            for h in [100, 200, 300] {
                for (bb, ba) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0)] {
                    let v: Vec<_> = [&es[i], &es[i + 3]]
                        .iter()
                        .flat_map(|e| e.predictions.iter())
                        .filter(|p| p.horizon_ms == h && p.bounces_before == bb && p.bounces_ahead == ba)
                        .collect();
                    if v.len() < 20 {
                        continue;
                    }
                    let c = |f: &dyn Fn(&&PredictionError) -> f64| {
                        let w: Vec<f64> = v.iter().map(|p| f(p)).collect();
                        med(w, 0.5) * 1e3
                    };
                    println!(
                        "{:8} {h} before {bb} ahead {ba} n {:5} median {:6.1} | med x {:6.1} y {:6.1} z {:6.1} | abs {:6.1} {:6.1} {:6.1}",
                        s.0,
                        v.len(),
                        c(&|p| p.error_m.norm()),
                        c(&|p| p.error_m.x),
                        c(&|p| p.error_m.y * 1.0),
                        c(&|p| p.error_m.z),
                        c(&|p| p.error_m.x.abs()),
                        c(&|p| p.error_m.y.abs()),
                        c(&|p| p.error_m.z.abs())
                    );
                }
            }
        }
    }
    if arg.iter().any(|a| a == "opt") {
        let mut best = score(&all(&sets, &o, true));
        let mut step = vec![0.3; 15];
        step[0] = 0.1;
        step[2] = 0.03;
        for round in 0..5 {
            for i in 0..15 {
                for sgn in [1.0, -1.0] {
                    let mut t = o;
                    *get(&mut t, i) *= 1.0f64 + sgn * step[i];
                    let s = score(&all(&sets, &t, true));
                    if s < best - 1e-3 {
                        best = s;
                        o = t;
                        break;
                    } else if sgn < 0.0 {
                        step[i] *= 0.5;
                    }
                }
            }
            println!(
                "round {round} {best:.3} {:?}",
                (0..15)
                    .map(|i| format!("{}={:.4}", names[i], *get(&mut o.clone(), i)))
                    .collect::<Vec<_>>()
                    .join(" ")
            );
        }
    }
    println!("train");
    let es = all(&sets, &o, true);
    show(&sets, &es);
    println!("score {:.3}", score(&es));
    println!("held");
    let es = all(&sets, &o, false);
    show(&sets, &es);
    println!("score {:.3}", score(&es));
}
