use super::{FilmedCamera, FilmedFrame};

/// The frames of one exposure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilmedTrigger {
    /// The recording's own trigger id, or a count from 1.
    pub id: u64,
    /// Which frame of each camera, in the order of the cameras; `None` where it delivered none.
    pub frames: Vec<Option<usize>>,
}

/// Puts frames together that were exposed together.
///
/// By their trigger ids, where all frames have a header. Else by stamps: a trigger is the earliest frame
/// that is left, and of each other camera its earliest, unless that lies further than `tolerance_ns` away
/// or nearer to the first camera's next frame.
pub fn group(cameras: &[&FilmedCamera], tolerance_ns: u64) -> Vec<FilmedTrigger> {
    if cameras.iter().all(|camera| camera.frames.iter().all(|frame| frame.header.is_some())) {
        by_trigger_id(cameras)
    } else {
        by_stamp(cameras, tolerance_ns)
    }
}

fn by_trigger_id(cameras: &[&FilmedCamera]) -> Vec<FilmedTrigger> {
    let mut triggers = std::collections::BTreeMap::<u64, Vec<Option<usize>>>::new();
    for (camera, filmed) in cameras.iter().enumerate() {
        for (place, frame) in filmed.frames.iter().enumerate() {
            let id = frame.header.as_ref().map_or(0, |header| header.trigger_id);
            triggers.entry(id).or_insert_with(|| vec![None; cameras.len()])[camera] = Some(place);
        }
    }
    triggers.into_iter().map(|(id, frames)| FilmedTrigger { id, frames }).collect()
}

fn by_stamp(cameras: &[&FilmedCamera], tolerance_ns: u64) -> Vec<FilmedTrigger> {
    let mut next = vec![0; cameras.len()];
    let mut triggers = Vec::new();
    let stamp = |camera: usize, place: usize| cameras[camera].frames.get(place).map(stamp_of);
    loop {
        let heads = || (0..cameras.len()).filter_map(|c| stamp(c, next[c]).map(|s| (s, c)));
        let Some((first, leader)) = heads().min() else { return triggers };
        let following = stamp(leader, next[leader] + 1);
        let frames = (0..cameras.len())
            .map(|c| {
                let at = stamp(c, next[c])?;
                let nearer_to_the_next = following.is_some_and(|f| f.abs_diff(at) < at - first);
                (at - first <= tolerance_ns && !nearer_to_the_next).then_some(next[c])
            })
            .collect::<Vec<_>>();
        for (next, frame) in next.iter_mut().zip(&frames) {
            *next += usize::from(frame.is_some());
        }
        triggers.push(FilmedTrigger { id: triggers.len() as u64 + 1, frames });
    }
}

fn stamp_of(frame: &FilmedFrame) -> u64 {
    frame.stamp_ns
}

#[cfg(test)]
mod tests {
    use netcord_common::{CameraName, PixelFormat, wire::FrameHeader};

    use super::*;
    use crate::recording::Place;

    fn camera(name: &str, stamps: &[u64]) -> FilmedCamera {
        let frames = stamps.iter().map(|stamp_ns| FilmedFrame {
            stamp_ns: *stamp_ns,
            width: 1,
            height: 1,
            step: 1,
            format: PixelFormat::Mono8,
            pixels: Place::File(0..1),
            header: None,
        });
        FilmedCamera {
            name: CameraName::new(name).expect("valid"),
            calibration: None,
            table_from_camera: None,
            frames: frames.collect(),
            duplicates: 0,
        }
    }

    fn frames(triggers: &[FilmedTrigger]) -> Vec<Vec<Option<usize>>> {
        triggers.iter().map(|t| t.frames.clone()).collect()
    }

    #[test]
    fn frames_of_slightly_different_stamps_and_with_gaps_find_each_other() {
        let left = camera("left", &[100, 200, 400, 500]);
        let right = camera("right", &[103, 198, 301, 502]);
        let expected =
            [[Some(0), Some(0)], [Some(1), Some(1)], [None, Some(2)], [Some(2), None], [Some(3), Some(3)]];
        assert_eq!(frames(&group(&[&left, &right], 50)), expected.map(|e| e.to_vec()));
    }

    #[test]
    fn a_frame_belongs_to_the_nearer_trigger() {
        // Right runs 45 of an interval of 100 before left, and begins one trigger earlier.
        let left = camera("left", &[100, 200, 300]);
        let right = camera("right", &[55, 155, 255]);
        let expected = [[Some(0), Some(0)], [Some(1), Some(1)], [Some(2), Some(2)]];
        assert_eq!(frames(&group(&[&left, &right], 50)), expected.map(|e| e.to_vec()));
        // Left's second frame is lost: right's second is nearer to left's third than the tolerance allows.
        let left = camera("left", &[100, 300]);
        let expected = [[Some(0), Some(0)].to_vec(), [None, Some(1)].to_vec(), [Some(1), Some(2)].to_vec()];
        assert_eq!(frames(&group(&[&left, &right], 50)), expected);
    }

    #[test]
    fn trigger_ids_count_more_than_stamps() {
        let with_ids = |name, stamps: &[u64], ids: &[u64]| {
            let mut camera = camera(name, stamps);
            for (frame, id) in camera.frames.iter_mut().zip(ids) {
                frame.header = Some(FrameHeader { trigger_id: *id, ..FrameHeader::default() });
            }
            camera
        };
        let left = with_ids("left", &[100, 200, 300], &[7, 8, 10]);
        let right = with_ids("right", &[180, 290], &[8, 9]);
        let triggers = group(&[&left, &right], 5);
        assert_eq!(triggers.iter().map(|t| t.id).collect::<Vec<_>>(), [7, 8, 9, 10]);
        let expected = [[Some(0), None], [Some(1), Some(0)], [None, Some(1)], [Some(2), None]];
        assert_eq!(frames(&triggers), expected.map(|e| e.to_vec()));
    }
}
