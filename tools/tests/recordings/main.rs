//! `netcord process`, `recover` and `plot` as their users run them: real processes, real files.

mod filming;
mod live;
mod mistakes;
mod python;

use std::{
    path::Path,
    process::{Command, Output},
};

use filming::{Film, Shot};
use prost::Message as _;

/// Runs the `netcord` of this very tree.
fn netcord(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_netcord"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("netcord starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Rows of a CSV file, without its header line.
fn rows(path: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(path).expect("the table is there");
    text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

#[test]
fn positions_are_where_the_ball_was_at_the_images_own_stamps() {
    let folder = tempfile::tempdir().expect("a folder");
    let film = Film::new(24);
    film.write(&folder.path().join("in.mcap"), &Shot::default());
    let out = netcord(folder.path(), &["process", "in.mcap", "--positions", "p.csv", "--report", "r.json"]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let rows = rows(&folder.path().join("p.csv"));
    assert!(rows.len() >= 18, "{} positions of 20", rows.len());
    for row in &rows {
        let t_ns: u64 = row[0].parse().expect("a stamp");
        let truth = film.ball_at(t_ns).expect("a ball at an image's stamp");
        let found = [1, 2, 3].map(|i| row[i].parse::<f64>().expect("a number"));
        let error = found.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        // The discs are 6 to 9 px wide: half a pixel is 3 mm there.
        assert!(error < 0.004, "{error} m off at {t_ns}");
        assert_eq!((row[8].as_str(), row[9].as_str()), ("2", "robust"));
    }
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("r.json")).expect("written")).expect("JSON");
    assert_eq!(report["frames"]["published"], 48);
    assert!(report["recall"].as_f64().expect("the film has a truth") >= 0.9, "{report}");
}

#[test]
fn the_same_recording_gives_the_same_bytes_on_one_thread_and_on_many() {
    let folder = tempfile::tempdir().expect("a folder");
    Film::new(16).write(&folder.path().join("in.mcap"), &Shot { dropped: vec![(1, 9)], ..Shot::default() });
    for threads in ["1", "2"] {
        let names = ["out.mcap", "p.csv", "d.csv", "q.csv", "r.json"].map(|name| format!("{threads}-{name}"));
        let [out, p, d, q, r] = &names;
        let arguments = ["process", "in.mcap", "--threads", threads, "--out", out, "--positions", p]
            .into_iter()
            .chain(["--detections", d, "--predictions", q, "--report", r, "--warm-up", "4"])
            .collect::<Vec<_>>();
        let output = netcord(folder.path(), &arguments);
        assert_eq!(output.status.code(), Some(1), "a frame is missing: {}", text(&output.stderr));
    }
    let read = |name: &str, threads| {
        std::fs::read(folder.path().join(format!("{threads}-{name}"))).expect("written")
    };
    for name in ["out.mcap", "p.csv", "d.csv", "q.csv"] {
        assert!(read(name, "1") == read(name, "2"), "{name} differs");
    }
    // Computing times are the machine's; all else that is reported is the recording's.
    let [one, two] = ["1", "2"].map(|threads| {
        let mut report: serde_json::Value = serde_json::from_slice(&read("r.json", threads)).expect("JSON");
        let times = report.as_object_mut().and_then(|report| report.remove("latency_ms")).expect("there");
        for stage in ["segment", "triangulate", "predict", "frame_to_position"] {
            let quantiles = ["p50", "p90", "p99", "p999", "max"].map(|q| times[stage][q].as_f64());
            assert!(quantiles.is_sorted() && quantiles[0].is_some_and(|ms| ms > 0.0), "{stage}: {times}");
        }
        for absent in ["capture", "exposure_to_position"] {
            assert_eq!(times.get(absent), Some(&serde_json::Value::Null), "{times}");
        }
        report
    });
    assert_eq!(one, two);
    // What was written is a recording in its turn, with the same results.
    let again =
        netcord(folder.path(), &["process", "1-out.mcap", "--positions", "again.csv", "--warm-up", "4"]);
    assert_eq!(again.status.code(), Some(1), "the frame is missing still: {}", text(&again.stderr));
    // Poses pass through a quaternion: what rounding leaves is far below a nanometre.
    let (first, again) = (rows(&folder.path().join("1-p.csv")), rows(&folder.path().join("again.csv")));
    assert_eq!(first.len(), again.len());
    for (first, again) in first.iter().zip(&again) {
        assert_eq!(first[0], again[0]);
        for i in 1..4 {
            let number = |row: &[String]| row[i].parse::<f64>().expect("a number");
            assert!((number(first) - number(again)).abs() < 1e-10, "{first:?} {again:?}");
        }
    }
}

#[test]
fn a_recording_that_was_cut_off_gives_what_is_whole_and_is_recovered() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    Film::new(16).write(&path("whole.mcap"), &Shot::default());
    let bytes = std::fs::read(path("whole.mcap")).expect("written");
    std::fs::write(path("cut.mcap"), &bytes[..bytes.len() * 3 / 4]).expect("written");
    let out = netcord(folder.path(), &["process", "cut.mcap", "--positions", "cut.csv"]);
    assert_eq!(out.status.code(), Some(1), "done, but something was missed: {}", text(&out.stderr));
    assert!(text(&out.stderr).contains("truncated at byte"), "{}", text(&out.stderr));
    let cut = rows(&path("cut.csv"));
    assert!(cut.len() >= 6, "{} positions", cut.len());

    let out = netcord(folder.path(), &["recover", "cut.mcap", "saved.mcap"]);
    assert_eq!(out.status.code(), Some(1), "a record was lost: {}", text(&out.stderr));
    let saved = std::fs::read(path("saved.mcap")).expect("written");
    // Read by another reader, through the new index.
    let summary = mcap::Summary::read(&saved).expect("valid").expect("there");
    let counted = summary.stats.expect("there").message_count;
    let read = mcap::MessageStream::new(&saved).expect("valid").filter(|m| m.is_ok()).count();
    assert_eq!(counted, read as u64);
    let out = netcord(folder.path(), &["process", "saved.mcap", "--positions", "saved.csv"]);
    assert!(matches!(out.status.code(), Some(0 | 1)), "{}", text(&out.stderr));
    assert_eq!(rows(&path("saved.csv")), cut);
}

#[test]
fn pictures_become_a_recording_that_another_reader_can_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, size: (u32, u32), n: u8| {
        let path = folder.path().join("pictures").join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        let pixel = |x: u32, y: u32| image::Rgb([x as u8, y as u8, n]);
        image::RgbImage::from_fn(size.0, size.1, pixel).save(path).expect("written");
    };
    for n in 0..3 {
        write(&format!("left/{n}.png"), (16, 8), n);
        write(&format!("right/{n}.png"), (8, 8), n);
    }
    let import = |more: &[&str]| {
        let always = ["import", "pictures", "--out", "p.mcap", "--rate", "50"];
        netcord(folder.path(), &[&always, more].concat())
    };
    let out = import(&[]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    assert_eq!(text(&out.stdout).trim(), "p.mcap: 6 pictures of 2 cameras");
    let file = std::fs::read(folder.path().join("p.mcap")).expect("written");
    let images = mcap::MessageStream::new(&file)
        .expect("valid")
        .map(|message| message.expect("whole"))
        .filter(|message| message.channel.topic == "/camera/left/image")
        .collect::<Vec<_>>();
    assert_eq!(
        images.iter().map(|m| m.log_time - images[0].log_time).collect::<Vec<_>>(),
        [0, 20_000_000, 40_000_000]
    );
    let image = foxglove::messages::RawImage::decode(&*images[2].data).expect("valid");
    assert_eq!((image.width, image.height, image.step, &*image.encoding), (16, 8, 16, "bayer_rggb8"));
    // Red at (4, 2), green at (5, 2) and (4, 3), blue at (5, 3).
    let at = |x: usize, y: usize| image.data[y * 16 + x];
    assert_eq!([at(4, 2), at(5, 2), at(4, 3), at(5, 3)], [4, 2, 3, 2]);

    // A camera has one size of picture, and what is no picture is named; the recording that is there stays.
    write("left/3.png", (16, 10), 3);
    let out = import(&[]);
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("p.mcap is there already"), "{}", text(&out.stderr));
    let out = import(&["--overwrite"]);
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("left/3.png has 16 × 10 px"), "{}", text(&out.stderr));
    assert!(std::fs::read(folder.path().join("p.mcap")).is_ok_and(|now| now == file));
    std::fs::write(folder.path().join("pictures/left/3.png"), b"hello").expect("written");
    let out = import(&["--overwrite"]);
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("left/3.png"), "{}", text(&out.stderr));
    // A picture is not made a recording.
    let picture = std::fs::read(folder.path().join("pictures/left/0.png")).expect("there");
    let onto = ["import", "pictures", "--out", "pictures/left/0.png", "--overwrite"];
    let out = netcord(folder.path(), &onto);
    assert!(text(&out.stderr).contains("is read by this command"), "{}", text(&out.stderr));
    assert!(std::fs::read(folder.path().join("pictures/left/0.png")).is_ok_and(|now| now == picture));
}

#[test]
fn no_output_destroys_an_input_or_another_output() {
    let folder = tempfile::tempdir().expect("a folder");
    Film::new(5).write(&folder.path().join("in.mcap"), &Shot::default());
    let before = std::fs::read(folder.path().join("in.mcap")).expect("there");
    for (arguments, said) in [
        (vec!["process", "in.mcap", "--positions", "in.mcap"], "is read by this command"),
        (vec!["process", "in.mcap", "--positions", "a.csv", "--detections", "./a.csv"], "two outputs"),
        (vec!["plot", "in.mcap", "--out", "in.mcap"], "is read by this command"),
        (vec!["plot", "in.mcap", "--out", "b.png", "--report", "b.png"], "two outputs"),
        (vec!["recover", "in.mcap", "in.mcap", "--overwrite"], "is read by this command"),
        (vec!["process", "in.mcap", "--positions", "no/folder.csv"], "there is no folder"),
    ] {
        let out = netcord(folder.path(), &arguments);
        assert_eq!(out.status.code(), Some(2), "{arguments:?}");
        assert!(text(&out.stderr).contains(said), "{arguments:?}: {}", text(&out.stderr));
    }
    assert!(std::fs::read(folder.path().join("in.mcap")).is_ok_and(|now| now == before));
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 1, "nothing was begun");
}

#[test]
fn a_recording_becomes_a_picture() {
    let folder = tempfile::tempdir().expect("a folder");
    Film::new(16).write(&folder.path().join("in.mcap"), &Shot::default());
    netcord(folder.path(), &["process", "in.mcap", "--out", "out.mcap"]);
    for picture in ["out.png", "out.svg"] {
        let out = netcord(folder.path(), &["plot", "out.mcap", "--out", picture]);
        assert!(out.status.success(), "{}", text(&out.stderr));
        assert!(std::fs::metadata(folder.path().join(picture)).expect("written").len() > 10_000);
    }
    let out = netcord(folder.path(), &["plot", "in.mcap", "--out", "none.png", "--at", "0.1"]);
    assert!(out.status.success(), "the truth alone can be drawn: {}", text(&out.stderr));
}

/// The same film with its truth moved: the plot's errors are by how much.
#[test]
fn a_plots_errors_are_by_how_much_the_truth_is_off() {
    let median_mm = |truth_off_m: [f64; 3]| {
        let folder = tempfile::tempdir().expect("a folder");
        let shot = Shot { truth_off_m, ..Shot::default() };
        Film::new(24).write(&folder.path().join("in.mcap"), &shot);
        for arguments in [
            &["process", "in.mcap", "--out", "out.mcap"] as &[&str],
            &["plot", "out.mcap", "--out", "out.svg", "--report", "r.json"],
        ] {
            let out = netcord(folder.path(), arguments);
            assert!(out.status.success(), "{}", text(&out.stderr));
        }
        let report = std::fs::read(folder.path().join("r.json")).expect("written");
        let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
        assert!(report["position_error_mm"]["n"].as_u64() >= Some(18), "{report}");
        let median = report["position_error_mm"]["median"].as_f64().expect("there is a truth");
        let picture = std::fs::read_to_string(folder.path().join("out.svg")).expect("written");
        assert!(picture.contains(&format!("median {median:.2}")), "the picture says the same as the report");
        median
    };
    // The film's discs are found to 4 mm.
    let (as_is, moved) = (median_mm([0.0; 3]), median_mm([0.03, -0.04, 0.12]));
    assert!(as_is < 4.0 && (moved - 130.0).abs() < 4.0, "{as_is} {moved}");
}

/// All texts of a JSON value that name a topic, keys included, without the path to a field.
fn topics_in(value: &serde_json::Value, into: &mut std::collections::BTreeSet<String>) {
    let mut take = |text: &str| {
        if text.starts_with('/') {
            into.insert(text.split('.').next().unwrap_or(text).to_owned());
        }
    };
    match value {
        serde_json::Value::String(text) => take(text),
        serde_json::Value::Array(items) => items.iter().for_each(|item| topics_in(item, into)),
        serde_json::Value::Object(members) => {
            for (key, member) in members {
                if key.starts_with('/') {
                    into.insert(key.clone());
                }
                topics_in(member, into);
            }
        }
        _ => {}
    }
}

#[test]
fn the_layout_for_viewers_shows_topics_of_a_recording_by_panels_that_know_their_schemas() {
    let folder = tempfile::tempdir().expect("a folder");
    Film::new(12).write(&folder.path().join("in.mcap"), &Shot::default());
    let out = netcord(folder.path(), &["process", "in.mcap", "--out", "out.mcap"]);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let file = std::fs::read(folder.path().join("out.mcap")).expect("written");
    let summary = mcap::Summary::read(&file).expect("valid").expect("with an index");
    let schema_of = |topic: &str| {
        let channel = summary.channels.values().find(|c| c.topic == topic)?;
        Some(channel.schema.as_ref()?.name.clone())
    };
    let layout: serde_json::Value =
        serde_json::from_str(include_str!("../../foxglove/netcord.json")).expect("JSON");
    let mut topics = std::collections::BTreeSet::new();
    topics_in(&layout, &mut topics);
    // Latencies are those of a running rig: only `view` serves them.
    assert!(topics.remove("/statistics"), "{topics:?}");
    assert!(topics.len() >= 9, "{topics:?}");
    // Viewers take the speed of playing from it, and refuse a layout without.
    assert!(layout["playbackConfig"]["speed"].is_number());
    for topic in &topics {
        assert!(schema_of(topic).is_some(), "{topic} is not in a recording");
    }
    for (panel, config) in layout["configById"].as_object().expect("panels") {
        let expect = |topic: &serde_json::Value, schema: &str| {
            let topic = topic.as_str().expect("a topic");
            assert_eq!(schema_of(topic).as_deref(), Some(schema), "{panel}: {topic}");
        };
        if panel.starts_with("Image!") {
            let mode = &config["imageMode"];
            expect(&mode["imageTopic"], "foxglove.RawImage");
            expect(&mode["calibrationTopic"], "foxglove.CameraCalibration");
            for topic in mode["annotations"].as_object().expect("annotations").keys() {
                expect(&topic.as_str().into(), "foxglove.ImageAnnotations");
            }
        }
        if panel.starts_with("3D!") {
            for topic in config["topics"].as_object().expect("topics").keys() {
                let schema = if topic.ends_with("/calibration") {
                    "foxglove.CameraCalibration"
                } else {
                    "foxglove.SceneUpdate"
                };
                expect(&topic.as_str().into(), schema);
            }
        }
    }
}
