//! `segment --learn`: from marked frames to a ball that is found by its learnt colour.

use std::{collections::BTreeMap, fs, path::Path};

use image::{Rgb, RgbImage};
use netcord_capture::recording::Footage;
use netcord_tests::{Ended, Lab, one_at_a_time};
use serde_json::{Value, json};
use toml_edit::DocumentMut;

const SIZE: (u32, u32) = (480, 320);
const RADIUS_PX: f64 = 11.0;
/// Pictures, of which the first half is marked.
const PICTURES: u32 = 12;

/// Where the ball is in picture `k`, px.
fn ball(k: u32) -> [f64; 2] {
    [50.0 + 33.3 * f64::from(k), 250.0 - 15.7 * f64::from(k)]
}

/// A green ball, which is neither orange nor white, lit from above, before tiles of many other colours.
fn picture(k: u32) -> RgbImage {
    let [u, v] = ball(k);
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        let tile = |step: u32| f64::from((x / 48 * 7 + y / 40 * 5 + k + step) % 11);
        let wall = [60.0 + 12.0 * tile(0), 60.0 + 7.0 * tile(3), 70.0 + 11.0 * tile(6)];
        // Each pixel by sixty-four samples.
        let inside = (0..64)
            .filter(|i| {
                let at = |pixel: u32, step: u32| f64::from(pixel) + (f64::from(step) + 0.5) / 8.0 - 0.5;
                (at(x, i % 8) - u).hypot(at(y, i / 8) - v) < RADIUS_PX
            })
            .count();
        let share = inside as f64 / 64.0;
        let lit = 1.0 - 0.15 * (f64::from(y) - v) / RADIUS_PX;
        // As good as noise, and the same everywhere.
        let mixed = x * 7919 + y * 104_729 + k * 1_299_709 + (x * y) % 8191 * 31;
        let noise = f64::from(mixed % 13) - 6.0;
        let green = [40.0, 170.0, 60.0].map(|level| level * lit);
        let seen = [0, 1, 2].map(|c| wall[c] + share * (green[c] - wall[c]) + noise);
        Rgb(seen.map(|level| level.round().clamp(0.0, 255.0) as u8))
    })
}

/// Pictures in a folder, a recording of them, and what is made of them.
struct Album {
    lab: Lab,
}

impl Album {
    fn new() -> Self {
        let lab = Lab::new();
        fs::create_dir_all(lab.path("pictures")).expect("a folder");
        for k in 0..PICTURES {
            picture(k).save(lab.path("pictures").join(format!("{k:02}.png"))).expect("written");
        }
        let album = Self { lab };
        let ended = album.run(&["import", &album.path("pictures"), "--out", &album.path("film.mcap")]);
        assert_eq!(ended.code, Some(0), "{}", ended.err);
        album
    }

    fn path(&self, name: &str) -> String {
        self.lab.path(name).display().to_string()
    }

    fn write(&self, name: &str, text: &str) -> String {
        let path = self.lab.path(name);
        fs::create_dir_all(path.parent().expect("in the lab")).expect("a folder");
        fs::write(path, text).expect("written");
        self.path(name)
    }

    fn run(&self, arguments: &[&str]) -> Ended {
        self.lab.start(arguments).wait()
    }

    /// Learns from `input` with the marks in a file or folder, into a rig file that is begun.
    fn learn(&self, input: &str, marks: &str, rig: &str) -> Ended {
        self.run(&["segment", "--learn", &self.path(input), "--marks", marks, "--rig", &self.path(rig)])
    }

    /// In how many of the pictures that were not marked the ball is found, and how many other boxes there are.
    fn found(&self, options: &[&str]) -> (usize, usize) {
        let (film, table) = (self.path("film.mcap"), self.path("found.csv"));
        let fixed = ["process", &film, "--single-frames", "--detections", &table];
        let ended = self.run(&[&fixed, options].concat());
        assert_eq!(ended.code, Some(0), "{}", ended.err);
        let text = fs::read_to_string(table).expect("detections");
        let cell = |row: &str, i: usize| row.split(',').nth(i).expect("a column").to_owned();
        let number = |row: &str, i: usize| cell(row, i).parse::<f64>().expect("a number");
        let stamp = |row: &str| cell(row, 0).parse::<u64>().expect("a stamp");
        let (mut found, mut others) = (0, 0);
        for row in text.lines().skip(1).filter(|row| number(row, 8) >= 0.5) {
            // The first picture has the stamp of one second; a hundred follow in the next.
            let k = u32::try_from((stamp(row) - 1_000_000_000) / 10_000_000).expect("few");
            let [u, v] = ball(k);
            let is_ball = (number(row, 2) - u).hypot(number(row, 3) - v) < 1.0;
            found += usize::from(is_ball && k >= PICTURES / 2);
            others += usize::from(!is_ball);
        }
        (found, others)
    }
}

fn has_learnt_colour(rig: &Path) -> bool {
    let text = fs::read_to_string(rig).expect("a rig file");
    let document: DocumentMut = text.parse().expect("TOML");
    let cameras = document["camera"].as_array_of_tables().expect("cameras");
    cameras.iter().all(|camera| camera.get("ball").is_some_and(|ball| ball.get("tests").is_some()))
}

/// The marks of a picture as a CSV row, a JSON object and a YOLO label.
fn csv_row(k: u32) -> String {
    let [u, v] = ball(k);
    format!("{k:02}.png,{u},{v},{}\n", 2.0 * RADIUS_PX)
}

fn json_box(k: u32) -> Value {
    let [u, v] = ball(k);
    let reach = 1.6 * RADIUS_PX;
    json!({ "image": format!("{k:02}"), "x0": u - reach, "y0": v - reach, "x1": u + reach, "y1": v + reach })
}

fn yolo_label(k: u32) -> String {
    let [u, v] = ball(k);
    let (width, height) = (f64::from(SIZE.0), f64::from(SIZE.1));
    let side = 3.2 * RADIUS_PX;
    format!("0 {} {} {} {}\n", (u + 0.5) / width, (v + 0.5) / height, side / width, side / height)
}

#[test]
fn marks_of_every_kind_teach_a_colour_by_which_the_ball_is_found() {
    let album = Album::new();
    let marked = || 0..PICTURES / 2;
    let rows: String = marked().map(csv_row).collect();
    let csv = album.write("marks.csv", &format!("image,u,v,diameter\n{rows}"));
    let json =
        album.write("marks.json", &Value::from(marked().map(json_box).collect::<Vec<_>>()).to_string());
    for k in marked() {
        album.write(&format!("labels/{k:02}.txt"), &yolo_label(k));
    }
    let unmarked = (PICTURES / 2) as usize;
    let (told, _) = album.found(&["--ball", "auto"]);
    assert!(told <= unmarked / 3, "a green ball is found as an orange or white one: {told} of {unmarked}");
    for (marks, rig) in [(csv, "csv.toml"), (json, "json.toml"), (album.path("labels"), "yolo.toml")] {
        let ended = album.learn("pictures", &marks, rig);
        assert_eq!(ended.code, Some(0), "{marks}: {}", ended.err);
        let said = ended.out.join("\n");
        assert!(said.contains("from 6 balls in 6 frames") && said.contains("not learnt from"), "{said}");
        assert!(has_learnt_colour(&album.lab.path(rig)), "{rig}");
        let (found, others) = album.found(&["--rig", &album.path(rig)]);
        assert!(found == unmarked && others <= 1, "{rig}: {found} of {unmarked}, {others} others");
    }
    // Labels beside the pictures need not be named.
    let ended =
        album.run(&["segment", "--learn", &album.path("pictures"), "--rig", &album.path("beside.toml")]);
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    assert!(has_learnt_colour(&album.lab.path("beside.toml")));
}

/// Centre and score of each box, by stamp and camera.
type Boxes = BTreeMap<(u64, String), Vec<([f64; 2], f64)>>;

/// Those of a table of detections.
fn boxes(table: &Path) -> Boxes {
    let mut boxes = Boxes::new();
    for row in fs::read_to_string(table).expect("detections").lines().skip(1) {
        let cells: Vec<&str> = row.split(',').collect();
        let number = |i: usize| cells[i].parse::<f64>().expect("a number");
        let key = (cells[0].parse().expect("a stamp"), cells[1].to_owned());
        boxes.entry(key).or_default().push(([number(2), number(3)], number(8)));
    }
    boxes
}

#[test]
fn a_recordings_own_truth_teaches_the_ball() {
    let _turn = one_at_a_time();
    let lab = Lab::new();
    let rig = lab.synthetic_rig(10.0, &[]).display().to_string();
    let [film, learnt, report, table] = ["film.mcap", "learnt.toml", "report.json", "found.csv"]
        .map(|name| lab.path(name).display().to_string());
    let capture = lab.start(&["capture", "--rig", &rig, "--scene", "clean", "--seed", "3"]);
    // What the recorder misses on a busy machine is not learnt from.
    let recorded = lab.start(&["record", &film, "--truth", "--rig", &rig, "--seconds", "5"]).wait();
    assert!(matches!(recorded.code, Some(0 | 1)), "{}", recorded.err);
    capture.stop();

    let ended = lab.start(&["segment", "--learn", &film, "--rig", &learnt, "--report", &report]).wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    assert!(has_learnt_colour(Path::new(&learnt)));
    let text = fs::read_to_string(report).expect("a report");
    let report: Value = serde_json::from_str(&text).expect("JSON");
    for camera in report["cameras"].as_array().expect("cameras") {
        assert!(camera["balls"].as_u64().expect("a number") >= 10, "{camera}");
        let area = camera["separation"]["area"].as_f64().expect("a number");
        assert!(area > 0.95, "the colour tells the ball: {area}");
    }

    // By what was learnt the ball is found where it truly was.
    let fixed = ["process", &film, "--single-frames", "--rig", &learnt, "--detections", &table];
    let processed = lab.start(&fixed).wait();
    assert!(matches!(processed.code, Some(0 | 1)), "{}", processed.err);
    let footage = Footage::open(Path::new(&film)).expect("a recording");
    let (found, seen) = balls_found(&footage, &boxes(Path::new(&table)));
    assert!(seen >= 20 && 2 * found > seen, "{found} of {seen} balls");
}

/// In how many of a recording's frames the ball is found within 2 px of where it truly is, and in how many it is to be
/// seen.
fn balls_found(footage: &Footage, boxes: &Boxes) -> (usize, usize) {
    let (mut found, mut seen) = (0, 0);
    for truth in footage.truth.iter().filter(|truth| truth.present) {
        for (camera, view) in truth.cameras.iter().filter(|(_, view)| view.visible > 0.9) {
            let frames = footage.cameras.iter().find(|c| c.name.as_str() == camera);
            if !frames.is_some_and(|c| c.frames.iter().any(|frame| frame.stamp_ns == truth.t_ns)) {
                continue;
            }
            let near = |[u, v]: [f64; 2]| (u - view.u_px).hypot(v - view.v_px) < 2.0;
            let here = boxes.get(&(truth.t_ns, camera.clone())).map_or(&[][..], Vec::as_slice);
            seen += 1;
            found += usize::from(here.iter().any(|(at, score)| near(*at) && *score >= 0.5));
        }
    }
    (found, seen)
}

#[test]
fn a_bad_mark_is_refused_with_its_file_and_line_and_nothing_is_written() {
    let album = Album::new();
    let mut number = 0;
    let mut refused = |name: &str, text: &str, says: &[&str]| {
        number += 1;
        let written = album.write(name, text);
        // Of YOLO labels the folder is given.
        let marks = match written.strip_suffix(".txt").and_then(|path| Path::new(path).parent()) {
            Some(folder) => folder.display().to_string(),
            None => written,
        };
        let rig = format!("{number}.toml");
        let ended = album.learn("pictures", &marks, &rig);
        assert_eq!(ended.code, Some(2), "{name}: {}", ended.err);
        for part in says {
            assert!(ended.err.contains(part), "{name}: no {part:?} in {}", ended.err);
        }
        assert!(!ended.err.contains("panicked") && !album.lab.path(&rig).exists(), "{}", ended.err);
    };
    let head = "image,u,v,diameter";
    let good = csv_row(0);
    refused("a.csv", &format!("{head}\n{good}01.png,80,x,22\n"), &["a.csv:3", "column 3"]);
    refused("b.csv", &format!("{head}\n{good}01.png,80\n"), &["b.csv:3", "2 columns"]);
    refused("c.csv", &format!("{head}\n{good}nowhere.png,80,90,22\n"), &["c.csv:3", "nowhere.png"]);
    refused("d.csv", &format!("{head}\n{good}01.png,900,90,22\n"), &["d.csv:3", "outside the image of 480"]);
    refused("e.csv", &format!("{head}\n{good}01.png,80,90,\n"), &["e.csv:3", "u, v and diameter"]);
    refused("f.csv", &format!("{head},blur_u\n00.png,80,90,22,3\n"), &["f.csv:2", "blur_v"]);
    refused("g.csv", &format!("{head},colour\n00.png,80,90,22,red\n"), &["g.csv:", "colour"]);
    refused("h.json", "[\n{\"image\": \"00\",\n}\n]", &["h.json:3"]);
    refused("i.json", &json!([json_box(0), { "image": "01", "u": 3 }]).to_string(), &["i.json: mark 2"]);
    refused("j/00.txt", &format!("{}0 0.5 0.5 0.1\n", yolo_label(0)), &["00.txt:2", "width height"]);
    refused("k/00.txt", "0 0.5 1.5 0.1 0.1\n", &["00.txt:1", "0 to 1"]);
    refused("l/00.txt", "0 0.5 0.5 0.001 0.001\n", &["00.txt:1", "px across"]);
}
