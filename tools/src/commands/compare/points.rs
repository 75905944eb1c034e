//! Given observations, triangulated with each method.

use std::{collections::HashMap, error::Error, fs, path::Path};

use nalgebra::{Matrix2, Vector2};
use netcord_common::rig::Rig;
use netcord_detect::triangulate::{
    Method, Observation, PosedCamera, Robust, all_methods, comparison::posed_cameras,
};
use serde::Deserialize;

use crate::{
    exit::{CommandResult, Outcome},
    output::Plan,
};

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    id: String,
    camera: String,
    x_px: f64,
    y_px: f64,
}

/// All observations of one point, in the order of the rig's cameras.
struct Group {
    id: String,
    seen: Vec<Observation>,
    /// Cameras of which the point was given, also those whose lens has no ray for it.
    cameras: u32,
}

/// Accuracy of the given observations is not known: one pixel, and two for the calibration, so that
/// `robust` takes views within some 9 px for consistent.
const SIGMA_PX: f64 = 1.0;
const SLACK_PX: f64 = 2.0;

/// Reads `points`, and writes one file a method into `out`. Missed where the robust method finds no place of a point.
pub(super) fn triangulate(rig: &Rig, points: &Path, out: &Path) -> CommandResult {
    let cameras = posed_cameras(rig);
    let groups = read(rig, &cameras, points)?;
    fs::create_dir_all(out).map_err(|e| format!("cannot make the folder {}: {e}", out.display()))?;
    let mut plan = Plan::of([points]);
    let robust = Robust::with_slack_px(SLACK_PX);
    let mut nowhere = Vec::new();
    for method in all_methods() {
        let method: &dyn Method = if method.code() == robust.code() { &robust } else { method };
        let path = out.join(format!("{}.csv", method.code()));
        let mut text = String::from("id,x,y,z\n");
        let mut absent = HashMap::new();
        let mut found = 0;
        for group in &groups {
            if group.seen.len() > method.max_views() {
                *absent.entry("TooManyViews").or_insert(0) += 1;
                continue;
            }
            match method.locate(&cameras, &group.seen) {
                Ok(point) => {
                    let p = point.coords;
                    // 17 significant digits: what is read back is the same number.
                    text += &format!("{},{:.16e},{:.16e},{:.16e}\n", group.id, p.x, p.y, p.z);
                    found += 1;
                }
                Err(reason) => {
                    *absent.entry(reason.name()).or_insert(0) += 1;
                    if method.code() == robust.code() {
                        nowhere.push(format!("{} ({})", group.id, reason.name()));
                    }
                }
            }
        }
        plan.begin(&path)?.write(text)?;
        let mut absent: Vec<_> = absent.into_iter().map(|(why, n)| format!("{n} {why}")).collect();
        absent.sort();
        let why = if absent.is_empty() { String::new() } else { format!(" ({})", absent.join(", ")) };
        println!("{}: {found} of {} points{why}", path.display(), groups.len());
    }
    if nowhere.is_empty() {
        return Ok(Outcome::Good);
    }
    eprintln!("netcord: no place was found of the points {}", nowhere.join(", "));
    Ok(Outcome::Missed)
}

fn read(rig: &Rig, cameras: &[PosedCamera], path: &Path) -> Result<Vec<Group>, Box<dyn Error>> {
    let name = path.display();
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(path)
        .map_err(|e| format!("cannot read {name}: {e}"))?;
    let header: Vec<String> = reader.headers()?.iter().map(str::to_owned).collect();
    let mut sorted = header.clone();
    sorted.sort();
    if sorted != ["camera", "id", "x_px", "y_px"] {
        return Err(
            format!("{name}:1: the header is {}; it must be id,camera,x_px,y_px", header.join(",")).into()
        );
    }
    let mut groups: Vec<Group> = Vec::new();
    let mut places: HashMap<String, usize> = HashMap::new();
    let mut record = csv::StringRecord::new();
    let of_line = reader.headers()?.clone();
    while reader.read_record(&mut record)? {
        let at = record.position().map_or(0, csv::Position::line);
        let line: Line = record.deserialize(Some(&of_line)).map_err(|e| match e.kind() {
            csv::ErrorKind::Deserialize { err, .. } => {
                let field =
                    err.field().and_then(|i| of_line.get(usize::try_from(i).ok()?)).unwrap_or("a line");
                format!("{name}:{at}: {field}: {}", err.kind())
            }
            _ => format!("{name}:{at}: {e}"),
        })?;
        if !(line.x_px.is_finite() && line.y_px.is_finite()) {
            return Err(format!("{name}:{at}: a pixel must be two finite numbers").into());
        }
        let camera = rig.cameras.iter().find(|c| c.name.as_str() == line.camera).ok_or_else(|| {
            let valid: Vec<_> = rig.cameras.iter().map(|c| c.name.as_str()).collect();
            format!("{name}:{at}: the rig has no camera {:?}; it has {}", line.camera, valid.join(", "))
        })?;
        let place = *places.entry(line.id.clone()).or_insert_with(|| {
            groups.push(Group { id: line.id.clone(), seen: Vec::new(), cameras: 0 });
            groups.len() - 1
        });
        let group = &mut groups[place];
        if group.cameras & camera.index.bit() != 0 {
            return Err(format!(
                "{name}:{at}: point {} was given for camera {} already",
                line.id, line.camera
            )
            .into());
        }
        group.cameras |= camera.index.bit();
        let covariance = Matrix2::identity() * (SIGMA_PX * SIGMA_PX);
        let i = camera.index.get();
        group.seen.extend(cameras[i].observe(i, Vector2::new(line.x_px, line.y_px), covariance));
    }
    for group in &mut groups {
        group.seen.sort_by_key(|o| o.camera);
    }
    Ok(groups)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> Rig {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../common/rigs/example-4cam.toml");
        Rig::load(&path).expect("an example rig")
    }

    #[test]
    fn exact_observations_give_the_points_with_every_method_that_takes_them() {
        let rig = rig();
        let folder = tempfile::tempdir().expect("a folder");
        let input = folder.path().join("points.csv");
        let truth = [(0.1, -0.3, 0.2), (-0.5, 1.0, 0.4), (0.6, 0.2, 0.02)];
        let mut text = String::from("id,camera,x_px,y_px\n");
        for (id, (x, y, z)) in truth.iter().enumerate() {
            // In the reverse of the rig's order, and the last point from two cameras only.
            for camera in rig.cameras.iter().rev().skip(if id == 2 { 2 } else { 0 }) {
                let at = netcord_common::geometry::Point::new(*x, *y, *z);
                let pixel = camera.model.project(&(&camera.camera_from_world * at)).expect("in view");
                text += &format!("p{id},{},{:?},{:?}\n", camera.name, pixel.x, pixel.y);
            }
        }
        fs::write(&input, &text).expect("written");
        let out = folder.path().join("out");
        assert_eq!(triangulate(&rig, &input, &out).expect("valid"), Outcome::Good);
        for method in all_methods() {
            let text = fs::read_to_string(out.join(format!("{}.csv", method.code()))).expect("written");
            let mut lines = text.lines();
            assert_eq!(lines.next(), Some("id,x,y,z"));
            let mut found = 0;
            for line in lines {
                let fields: Vec<_> = line.split(',').collect();
                let id: usize = fields[0][1..].parse().expect("pN");
                let [x, y, z] = [1, 2, 3].map(|i| fields[i].parse::<f64>().expect("a number"));
                let (tx, ty, tz) = truth[id];
                let error = ((x - tx).powi(2) + (y - ty).powi(2) + (z - tz).powi(2)).sqrt();
                assert!(error < 1e-9, "{} {line}", method.code());
                found += 1;
            }
            assert_eq!(found, if method.max_views() == 2 { 1 } else { 3 }, "{}", method.code());
        }
        text += &format!("lonely,{},100,100\n", rig.cameras[0].name);
        fs::write(&input, text).expect("written");
        assert_eq!(triangulate(&rig, &input, &out).expect("valid"), Outcome::Missed);
    }

    #[test]
    fn mistakes_in_the_points_are_named_with_their_line() {
        let rig = rig();
        let folder = tempfile::tempdir().expect("a folder");
        let input = folder.path().join("points.csv");
        let name = rig.cameras[0].name.as_str();
        let cases = [
            ("id,camera,x,y\n".to_owned(), ":1:", "id,camera,x_px,y_px"),
            (format!("id,camera,x_px,y_px\n1,{name},1,2\n1,nobody,1,2\n"), ":3:", name),
            (format!("id,camera,x_px,y_px\n1,{name},1,2\n1,{name},1,2\n"), ":3:", "already"),
            (format!("id,camera,x_px,y_px\n1,{name},1,zwei\n"), ":2:", "y_px"),
            (format!("id,camera,x_px,y_px\n1,{name},nan,2\n"), ":2:", "finite"),
        ];
        for (text, line, what) in cases {
            fs::write(&input, &text).expect("written");
            let error = triangulate(&rig, &input, folder.path()).expect_err(&text).to_string();
            assert!(error.contains(line) && error.contains(what), "{error}");
        }
    }
}
