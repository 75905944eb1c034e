//! The table's lines, found in pictures.

use std::{collections::BTreeMap, error::Error};

use netcord_calib::{
    session::Mark,
    table::{Table, find_marks},
};
use netcord_common::geometry::{Transform, World};

use super::{pictures::CameraPictures, rigged::CalibratedRig};

/// The marks where the table's lines cross, in pictures of a table that stands about where `rough` has it; of
/// several pictures of a camera, the median.
pub fn find(
    rig: &CalibratedRig,
    images: &[CameraPictures],
    rough: &Transform<World, Table>,
) -> Result<Vec<Mark>, Box<dyn Error>> {
    /// Pictures of a camera that are looked at: the table stands still.
    const ENOUGH: usize = 9;
    let mut seen: BTreeMap<(String, String), Vec<[f64; 2]>> = BTreeMap::new();
    for (camera, pictures) in images {
        let known = &rig.cameras[rig.place(camera)?];
        let camera_from_table = &known.camera_from_first * rough;
        let stride = pictures.len().div_ceil(ENOUGH).max(1);
        for (name, picture) in pictures.iter().step_by(stride) {
            let image = picture.read().map_err(|e| format!("{camera}, {name}: {e}"))?;
            let (size, expected) = ((image.width(), image.height()), (known.model.width, known.model.height));
            if size != (expected.0 as usize, expected.1 as usize) {
                return Err(format!(
                    "{camera}, {name}: the picture is {} × {} px, the rig file says {} × {}",
                    size.0, size.1, expected.0, expected.1
                )
                .into());
            }
            for mark in find_marks(&image, &known.model, &camera_from_table) {
                seen.entry((camera.clone(), mark.mark)).or_default().push(mark.at.into());
            }
        }
    }
    if seen.is_empty() {
        return Err("none of the table's lines was found within 10 cm of where the rough pose has them: \
                    point at its corners with --mark, or look at the picture"
            .into());
    }
    let middle = |places: &[[f64; 2]], axis: usize| {
        let mut values: Vec<f64> = places.iter().map(|p| p[axis]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let marks = seen.into_iter().map(|((camera, mark), places)| {
        let at = [middle(&places, 0), middle(&places, 1)];
        println!("{camera}: the lines cross at {mark} m: ({:.2}, {:.2}) px", at[0], at[1]);
        Mark { camera, mark, at }
    });
    Ok(marks.collect())
}
