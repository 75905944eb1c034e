use std::path::Path;

use crate::{
    geometry::{Point, World},
    pixel::PixelFormat,
    rig::{BallColour, Rig, StampMeaning, TriggerEdge, Wiring},
    wire::WorldFrame,
};

const RIG: &str = r#"
name = "lab"
rate_hz = 200.0

[ball]
colour = "white"

[table] # first_from_table: the camera hangs 2 m above the table's centre and looks straight down
rotation = [1, 0, 0, 0, -1, 0, 0, 0, -1]
translation_m = [0, 0, 2]

[[camera]]
name = "left"
width = 1920
height = 1200
pixel_format = "BayerRG8"
exposure_us = 1000
intrinsics = { fx = 700, fy = 700, cx = 960, cy = 600, distortion = [0, 0, 0, 0, 0] }

[[camera]]
name = "right"
width = 1920
height = 1200
pixel_format = "BayerRG8"
exposure_us = 1000
intrinsics = { fx = 700, fy = 700, cx = 960, cy = 600, distortion = [0, 0, 0, 0, 0] }
pose = { rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1], translation_m = [-1, 0, 0] }
"#;

fn error_of(text: &str) -> String {
    Rig::parse(text, Path::new("lab.toml")).expect_err("must be refused").to_string()
}

#[test]
fn poses_chain_from_the_table_over_the_first_camera() {
    let rig = Rig::parse(RIG, Path::new("lab.toml")).expect("valid");
    assert_eq!(
        (rig.world, rig.ball.colour, rig.interval_ns()),
        (WorldFrame::Table, BallColour::White, 5_000_000)
    );
    assert_eq!(rig.tolerance_ns, 2_500_000, "half an interval");
    let on_table = Point::<World>::new(0.5, 0.25, 0.0);
    let in_left = &rig.cameras[0].camera_from_world * on_table;
    assert!(in_left.distance(&Point::new(0.5, -0.25, 2.0)) < 1e-12);
    let in_right = &rig.cameras[1].camera_from_world * on_table;
    assert!(in_right.distance(&Point::new(-0.5, -0.25, 2.0)) < 1e-12);
    assert_eq!(rig.processes.len(), 4);
}

#[test]
fn wiring_and_the_devices_name_of_a_mosaic_are_read_and_checked() {
    let usual = Rig::parse(RIG, Path::new("lab.toml")).expect("valid");
    assert_eq!((usual.cameras[0].wiring, usual.cameras[0].device_format), (Wiring::default(), None));
    let keys = "exposure_us = 1000\ntrigger_edge = \"falling\"\ntrigger_delay_us = 12.5\n\
                stamp = \"exposure-end\"\ndevice_format = \"BayerGB8\"\n";
    let wired = RIG.replacen("exposure_us = 1000\n", keys, 1);
    let camera = Rig::parse(&wired, Path::new("lab.toml")).expect("valid").cameras[0].clone();
    let wiring = Wiring { edge: TriggerEdge::Falling, delay_ns: 12_500, stamp: StampMeaning::ExposureEnd };
    assert_eq!((camera.wiring, camera.device_format), (wiring, Some(PixelFormat::BayerGB8)));
    let e = error_of(&wired.replace("\"falling\"", "\"sideways\""));
    assert!(e.contains("sideways") && e.contains("falling"), "{e}");
    let e = error_of(&wired.replace("12.5", "-1"));
    assert!(e.contains("trigger_delay_us is -1"), "{e}");
    let e = error_of(&wired.replace("BayerGB8", "BayerGB12p"));
    assert!(e.contains("BayerGB12p") && e.contains("BayerGB8"), "{e}");
}

#[test]
fn each_mistake_is_named_with_its_line_and_the_cure() {
    let unknown = RIG.replace("rate_hz", "rate");
    let e = error_of(&unknown);
    assert!(e.starts_with("lab.toml:3:") && e.contains("`rate`") && e.contains("`rate_hz`"), "{e}");

    let e = error_of(&RIG.replace("\"right\"", "\"left\""));
    assert!(e.starts_with("lab.toml:21:") && e.contains("two cameras are called \"left\""), "{e}");

    let e = error_of(&RIG.replacen("intrinsics", "#intrinsics", 1));
    assert!(e.contains("camera left has no [camera.intrinsics]") && e.contains("netcord calib mono"), "{e}");

    let e = error_of(&RIG.replace("pose =", "#pose ="));
    assert!(e.contains("camera right has no [camera.pose]"), "{e}");

    let e = error_of(&RIG.replace("[1, 0, 0, 0, 1, 0, 0, 0, 1]", "[1, 0, 0, 0, 1, 0, 0, 0.1, 1]"));
    assert!(e.starts_with("lab.toml:27:") && e.contains("no rotation"), "{e}");

    let e = error_of(&RIG.replacen("BayerRG8", "RGB8", 1));
    assert!(e.starts_with("lab.toml:16:") && e.contains("RGB8") && e.contains("BayerGB8"), "{e}");

    let e = error_of(&RIG.replacen("exposure_us = 1000", "exposure_us = 0", 1));
    assert!(e.contains("exposure_us is 0"), "{e}");

    for (key, value) in [("gain_db", "nan"), ("line_delay_us", "-3")] {
        let with = format!("exposure_us = 1000\n{key} = {value}");
        let e = error_of(&RIG.replacen("exposure_us = 1000", &with, 1));
        assert!(e.to_lowercase().contains(&format!("camera left: {key} is {value}")), "{e}");
    }
    let e = error_of(&RIG.replace("[ball]", "[flight]\nhitting_plane_y_m = inf\n\n[ball]"));
    assert!(e.contains("hitting_plane_y_m is inf"), "{e}");

    let e = error_of(&RIG.replacen("fx = 700", "fx = -700", 1));
    assert!(e.contains("camera left: fx is -700"), "{e}");

    assert!(error_of("name = \"x\"").contains("no [[camera]]"));
    let e = error_of(&format!("{RIG}\n[[process]]\ncommand = \"sgment\""));
    assert!(e.contains("sgment") && e.contains("segment"), "{e}");
}

#[test]
fn the_example_rigs_are_valid_and_look_at_the_table() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("rigs");
    for (file, cameras) in [("example-2cam", 2), ("example-4cam", 4), ("example-8cam", 8)] {
        let rig = Rig::load(&folder.join(format!("{file}.toml"))).expect("valid");
        assert_eq!((rig.name.as_str(), rig.cameras.len()), (file, cameras));
        assert_eq!(rig.world, WorldFrame::Table);
        for camera in &rig.cameras {
            for end_y in [-1.37, 0.0, 1.37] {
                let in_camera = &camera.camera_from_world * Point::new(0.0, end_y, 0.2);
                let pixel = camera.model.project(&in_camera).expect("in front");
                assert!(camera.model.contains(&pixel), "{file}: {} does not see y = {end_y}", camera.name);
            }
        }
    }
}
