//! Pictures for the page: small, as JPEG, raw or undistorted.

use jpeg_encoder::{ColorType, Encoder, EncodingError};
use nalgebra::Vector2;
use netcord_calib::detect::Luma;
use netcord_common::{
    camera::CameraModel,
    geometry::{Camera, Point},
};

/// Above this the eye sees nothing of the compression.
const QUALITY: u8 = 82;

/// A picture at most `width` px wide, as JPEG, brightened where it is dark: frames of a millisecond are.
///
/// # Errors
/// What the encoder reports.
pub fn jpeg(picture: &Luma, width: usize) -> Result<Vec<u8>, EncodingError> {
    let shrunk = brightened(shrink(picture, width));
    let mut bytes = Vec::new();
    // The page's pictures are far below the 65,535 px that JPEG can hold.
    let [columns, rows] = [shrunk.width(), shrunk.height()].map(|n| u16::try_from(n).unwrap_or(u16::MAX));
    Encoder::new(&mut bytes, QUALITY).encode(shrunk.pixels(), columns, rows, ColorType::Luma)?;
    Ok(bytes)
}

/// Its brightest half percent made nearly white; never darker than it was.
fn brightened(picture: Luma) -> Luma {
    const NEARLY_WHITE: usize = 235;
    let mut histogram = [0usize; 256];
    picture.pixels().iter().for_each(|v| histogram[usize::from(*v)] += 1);
    let mut above = 0;
    let bright = (1..256).rev().find(|level| {
        above += histogram[*level];
        200 * above >= picture.pixels().len()
    });
    let Some(bright) = bright.filter(|level| *level < NEARLY_WHITE) else { return picture };
    let table: Vec<u8> = (0..256).map(|v| (v * NEARLY_WHITE / bright).min(255) as u8).collect();
    let data = picture.pixels().iter().map(|v| table[usize::from(*v)]).collect();
    Luma::new(picture.width(), picture.height(), data).unwrap_or(picture)
}

/// Each pixel the mean of those it stands for, by a whole factor.
fn shrink(picture: &Luma, width: usize) -> Luma {
    let factor = picture.width().div_ceil(width.max(1));
    if factor <= 1 {
        return picture.clone();
    }
    let (w, h) = (picture.width() / factor, picture.height() / factor);
    let mut data = Vec::with_capacity(w * h);
    let mut sums = vec![0u32; w];
    for y in 0..h {
        sums.fill(0);
        for row in y * factor..(y + 1) * factor {
            for (sum, cells) in sums.iter_mut().zip(picture.row(row).chunks_exact(factor)) {
                *sum += cells.iter().map(|v| u32::from(*v)).sum::<u32>();
            }
        }
        data.extend(sums.iter().map(|s| (s / (factor * factor) as u32) as u8));
    }
    Luma::new(w, h, data).unwrap_or_else(|| picture.clone())
}

/// As a pinhole camera of the same focal length would have seen it: straight lines are straight. Black where the
/// camera saw nothing.
pub fn undistorted(picture: &Luma, model: &CameraModel) -> Option<Luma> {
    let (width, height) = (picture.width(), picture.height());
    let mut data = Vec::with_capacity(width * height);
    for v in 0..height {
        for u in 0..width {
            let n = model.distorted_of(&Vector2::new(u as f64, v as f64));
            let raw = model.project(&Point::<Camera>::new(n.x, n.y, 1.0));
            data.push(raw.and_then(|p| picture.sample(p.x, p.y)).map_or(0, |value| value.round() as u8));
        }
    }
    Luma::new(width, height, data)
}

#[cfg(test)]
mod tests {
    use netcord_common::camera::Distortion;

    use super::*;

    #[test]
    fn a_line_that_the_lens_bends_is_straight_again() {
        let lens = Distortion::from_array([-0.25, 0.05, 0.0, 0.0, 0.0]);
        let model = CameraModel::new((320, 240), (220.0, 220.0), (159.5, 119.5), lens).expect("valid");
        // In the world: a dark band where |y / z + 0.4| < 0.02.
        let data = (0..320 * 240)
            .map(|i| {
                let pixel = Vector2::new(f64::from(i % 320), f64::from(i / 320));
                let n = model.undistort(&pixel).expect("inside");
                if (n.y + 0.4).abs() < 0.02 { 20 } else { 220 }
            })
            .collect();
        let picture = Luma::new(320, 240, data).expect("fits");
        let straight = undistorted(&picture, &model).expect("fits");
        let darkest = |image: &Luma, x: usize| (0..120).min_by_key(|y| image.at(x, *y)).expect("rows");
        let row = |image: &Luma| [40, 160, 280].map(|x| darkest(image, x));
        let (bent, now) = (row(&picture), row(&straight));
        assert!(bent[0].abs_diff(bent[1]) >= 2, "{bent:?}");
        // 0.4 · 220 px above the centre.
        assert!(now.iter().all(|y| y.abs_diff(31) <= 4), "{now:?}");
        assert!(now[0].abs_diff(now[1]) <= 4 && now[2].abs_diff(now[1]) <= 4, "{now:?}");
    }

    #[test]
    fn shrinking_keeps_the_mean() {
        let picture =
            Luma::new(8, 4, (0..32).map(|i| if i % 2 == 0 { 10 } else { 30 }).collect()).expect("fits");
        let small = shrink(&picture, 4);
        assert_eq!((small.width(), small.height()), (4, 2));
        assert!(small.pixels().iter().all(|v| *v == 20));
        // Half of its pixels are brighter than 10; they become nearly white.
        assert_eq!(&brightened(picture.clone()).pixels()[..2], &[78, 235]);
        assert!(jpeg(&picture, 4).expect("encodes").starts_with(&[0xff, 0xd8]));
    }
}
