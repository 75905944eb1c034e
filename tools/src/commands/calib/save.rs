//! Results into the rig file.

use std::{
    error::Error,
    path::Path,
    time::{SystemTime, UNIX_EPOCH},
};

use netcord_calib::{
    solve::{MonoCalibration, RigCalibration},
    table::TableCalibration,
};
use netcord_common::{
    CameraName,
    rig::{CalibrationNote, ClockDelay, RigEdit},
};

/// Today, ISO 8601, UTC (days to civil date after Howard Hinnant).
pub fn today() -> String {
    let days =
        SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs() / 86_400) as i64 + 719_468;
    let era = days.div_euclid(146_097);
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

/// The camera's name, if the rig file has it.
fn known(edit: &RigEdit, rig: &Path, name: &str) -> Result<CameraName, Box<dyn Error>> {
    let names = edit.camera_names();
    if !names.iter().any(|n| n == name) {
        let cameras = names.join(", ");
        return Err(format!("{} has no camera {name:?}; it has {cameras}", rig.display()).into());
    }
    Ok(CameraName::new(name)?)
}

/// Writes intrinsics into the rig file.
pub fn intrinsics<'a>(
    rig: &Path,
    board: &str,
    cameras: impl Iterator<Item = &'a MonoCalibration>,
) -> Result<(), Box<dyn Error>> {
    let mut edit = RigEdit::open(rig)?;
    for c in cameras {
        let name = known(&edit, rig, &c.name)?;
        let note = CalibrationNote {
            date: today(),
            board: board.to_owned(),
            frames: c.views.len() as u64,
            rms_px: c.rms_px,
        };
        edit.set_intrinsics(&name, &c.model, Some(&c.standard_deviations()), Some(&note));
    }
    save(&edit, rig)
}

/// Writes the rig file, and says so.
pub fn save(edit: &RigEdit, path: &Path) -> Result<(), Box<dyn Error>> {
    let kept =
        edit.save()?.map_or_else(String::new, |old| format!("; the old one is kept as {}", old.display()));
    println!("written to {}{kept}", path.display());
    Ok(())
}

/// Writes poses, and intrinsics, into the rig file.
pub fn rig(path: &Path, board: &str, rig: &RigCalibration) -> Result<(), Box<dyn Error>> {
    let mut edit = RigEdit::open(path)?;
    let first = edit.camera_names().first().cloned().unwrap_or_default();
    if rig.cameras.first().is_some_and(|c| c.name != first) {
        return Err(format!(
            "poses in {} refer to its first camera, {first}; give that one first",
            path.display()
        )
        .into());
    }
    for (i, c) in rig.cameras.iter().enumerate() {
        let name = known(&edit, path, &c.name)?;
        let frames = rig.views.iter().filter(|v| v.camera == i).count() as u64;
        let note = CalibrationNote { date: today(), board: board.to_owned(), frames, rms_px: rig.rms_px };
        let sd = |k: usize| c.covariance[(k, k)].max(0.0).sqrt();
        // Fixed intrinsics keep the uncertainty that their own calibration noted.
        if c.covariance[(0, 0)] > 0.0 {
            edit.set_intrinsics(&name, &c.model, Some(&std::array::from_fn(sd)), Some(&note));
        }
        let clock = c.clock.as_ref().map(|k| ClockDelay { delay_s: k.later_s, sigma_s: k.sd_s });
        // A board that stood still says nothing of clocks: what is known of them stays.
        if clock.is_some() || rig.timed {
            edit.set_clock_delay(&name, clock.as_ref());
        }
        let pose_sd = std::array::from_fn(|k| sd(9 + k));
        let pose = &c.camera_from_first;
        edit.set_pose(
            &name,
            pose.rotation.matrix(),
            &pose.translation,
            (i > 0).then_some(&pose_sd),
            Some(&note),
        );
    }
    save(&edit, path)
}

/// Writes the table's pose.
pub fn table(
    path: &Path,
    board: &str,
    frames: usize,
    table: &TableCalibration,
) -> Result<(), Box<dyn Error>> {
    let mut edit = RigEdit::open(path)?;
    let note = CalibrationNote {
        date: today(),
        board: board.to_owned(),
        frames: frames as u64,
        rms_px: table.rms_px,
    };
    let pose = &table.first_from_table;
    let sigma = table.standard_deviations();
    edit.set_table(pose.rotation.matrix(), &pose.translation, Some(&sigma), Some(&note));
    save(&edit, path)
}
