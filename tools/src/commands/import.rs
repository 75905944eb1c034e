//! `netcord import`: pictures become a recording, as if a camera with a colour mosaic had taken them.

use std::path::{Path, PathBuf};

use netcord_capture::recording::{
    RawImage, RecordingWriter, WriterOptions, calibration_message, camera_topic, transform_message,
};
use netcord_common::{
    CameraName, Channel, PixelFormat, Shutdown,
    picture::{Channels, Picture},
    rig::Rig,
};

use crate::{
    exit::{CommandResult, Outcome},
    output::{Output, Plan, refuse_existing},
    recording::{bytes_of, foxglove_schema, world_frame_id},
};

/// Turns pictures (PNG, JPEG) into a recording of raw frames. A folder of pictures is one camera; a folder of
/// folders is one camera for each, named after it. Pictures go in the order of their names; the n-th of each camera
/// has the same time stamp.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A folder of pictures, or of one folder a camera.
    images: PathBuf,

    /// The recording to be written.
    #[arg(long, value_name = "F.mcap")]
    out: PathBuf,

    /// The mosaic: Mono8, BayerRG8, BayerBG8, BayerGB8 or BayerGR8.
    #[arg(long, value_name = "FORMAT", default_value = "BayerRG8")]
    format: PixelFormat,

    /// Pictures a second.
    #[arg(long, value_name = "HZ", default_value_t = 100.0, allow_negative_numbers = true,
          value_parser = super::between(0.001, 100_000.0, "Hz"))]
    rate: f64,

    /// The camera's name, where IMAGES is one folder of pictures.
    #[arg(long, value_name = "NAME", default_value = "camera")]
    camera: CameraName,

    /// A rig file, whose calibration and poses go into the recording.
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,

    /// Replace F.mcap if it is there.
    #[arg(long)]
    overwrite: bool,
}

/// The first picture's stamp, ns: not zero, which messages keep for "not reached".
const FIRST_NS: u64 = 1_000_000_000;

/// Runs `netcord import`.
pub fn run(args: &Args) -> CommandResult {
    let cameras = pictures_by_camera(&args.images, &args.camera)?;
    let pictures = cameras.iter().flat_map(|(_, pictures)| pictures);
    let output = Plan::of(pictures.chain(&args.rig)).begin(&args.out)?;
    refuse_existing(&args.out, args.overwrite)?;
    let rig = args.rig.as_deref().map(Rig::load).transpose()?;
    write(args, rig.as_ref(), &cameras, &output)?;
    output.complete()?;
    let total = cameras.iter().map(|(_, pictures)| pictures.len()).sum::<usize>();
    println!("{}: {total} pictures of {} cameras", args.out.display(), cameras.len());
    Ok(Outcome::Good)
}

fn write(
    args: &Args,
    rig: Option<&Rig>,
    cameras: &[(CameraName, Vec<PathBuf>)],
    output: &Output,
) -> Result<(), Box<dyn std::error::Error>> {
    let stop = Shutdown::on_signals()?;
    let mut writer =
        RecordingWriter::<Vec<u8>>::onto(output.file()?, output.path(), WriterOptions::default())?;
    if let Some(rig) = rig {
        stand(&mut writer, rig, cameras)?;
    }
    let schema = foxglove_schema::<foxglove::messages::RawImage>();
    let channels: Vec<_> =
        cameras.iter().map(|(name, _)| writer.channel(&camera_topic(name, "image"), &schema)).collect();
    let mut sizes = vec![None; cameras.len()];
    let longest = cameras.iter().map(|(_, pictures)| pictures.len()).max().unwrap_or(0);
    for n in 0..longest {
        if stop.is_requested() {
            return Err("stopped before the end; nothing was written".into());
        }
        let stamp_ns = FIRST_NS + (n as f64 * 1e9 / args.rate).round() as u64;
        for (((name, pictures), channel), size) in cameras.iter().zip(&channels).zip(&mut sizes) {
            let Some(path) = pictures.get(n) else { continue };
            let picture = Picture::read(path, Channels::Rgb)?;
            let here = (picture.width(), picture.height());
            let first = *size.get_or_insert(here);
            if here != first {
                return Err(format!(
                    "the picture {} has {} × {} px, the first of camera {name} {} × {}: a camera's have one size",
                    path.display(),
                    here.0,
                    here.1,
                    first.0,
                    first.1
                )
                .into());
            }
            let pixels = mosaic(&picture, args.format);
            let description = RawImage {
                timestamp_ns: stamp_ns,
                frame_id: name.to_string(),
                width: picture.width() as u32,
                height: picture.height() as u32,
                step: picture.width() as u32,
                format: args.format,
                data: 0..pixels.len(),
            };
            writer.write(*channel, stamp_ns, &description.head(), Some(pixels))?;
        }
    }
    Ok(writer.finish()?)
}

/// Calibration and poses of those cameras of the rig that have pictures.
fn stand(
    writer: &mut RecordingWriter<Vec<u8>>,
    rig: &Rig,
    cameras: &[(CameraName, Vec<PathBuf>)],
) -> Result<(), Box<dyn std::error::Error>> {
    let parent = world_frame_id(rig);
    let transforms = writer.channel("/tf", &foxglove_schema::<foxglove::messages::FrameTransform>());
    for (name, _) in cameras {
        let camera = rig.camera(name).ok_or_else(|| {
            format!("the rig {} has no camera {name}, of which there are pictures", rig.name)
        })?;
        let schema = foxglove_schema::<foxglove::messages::CameraCalibration>();
        let channel = writer.channel(&camera_topic(name, "calibration"), &schema);
        let calibration = calibration_message(FIRST_NS, name.as_str(), &camera.model);
        writer.write(channel, FIRST_NS, &bytes_of(&calibration), None)?;
        let transform = transform_message(FIRST_NS, &parent, name.as_str(), &camera.camera_from_world);
        writer.write(transforms, FIRST_NS, &bytes_of(&transform), None)?;
    }
    Ok(())
}

/// The pictures of a folder, by camera: of `single` one, or of each folder inside.
pub(super) fn pictures_by_camera(
    folder: &Path,
    single: &CameraName,
) -> Result<Vec<(CameraName, Vec<PathBuf>)>, Box<dyn std::error::Error>> {
    let here = pictures(folder)?;
    if !here.is_empty() {
        return Ok(vec![(single.clone(), here)]);
    }
    let mut cameras = Vec::new();
    for path in sorted(folder)?.into_iter().filter(|p| p.is_dir()) {
        let pictures = pictures(&path)?;
        // What a folder lists always has a name.
        if let (Some(name), false) = (path.file_name(), pictures.is_empty()) {
            let name = CameraName::new(name.to_string_lossy())
                .map_err(|e| format!("the folder {} is to name a camera: {e}", path.display()))?;
            cameras.push((name, pictures));
        }
    }
    if cameras.is_empty() {
        return Err(format!("{} has no pictures; PNG and JPEG files are read", folder.display()).into());
    }
    Ok(cameras)
}

fn pictures(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let is_picture = |path: &PathBuf| {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        matches!(extension.as_deref(), Some("png" | "jpg" | "jpeg"))
    };
    Ok(sorted(folder)?.into_iter().filter(is_picture).collect())
}

fn sorted(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let entries = std::fs::read_dir(folder).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let entries = entries.map_err(|e| format!("cannot read the folder {}: {e}", folder.display()))?;
    let mut paths = entries.iter().map(std::fs::DirEntry::path).collect::<Vec<_>>();
    paths.sort();
    Ok(paths)
}

/// What a sensor behind the mosaic would have seen of the picture.
pub(super) fn mosaic(picture: &Picture, format: PixelFormat) -> Vec<u8> {
    let value = |x, y| {
        let pixel = picture.pixel(x, y);
        match format.channel_at(x, y) {
            Channel::Red => pixel[0],
            Channel::Green => pixel[1],
            Channel::Blue => pixel[2],
            // Rec. 601, as pictures are made grey everywhere.
            Channel::Luma => {
                let [r, g, b] = [0, 1, 2].map(|c| u32::from(pixel[c]));
                ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
            }
        }
    };
    (0..picture.height())
        .flat_map(|y| (0..picture.width()).map(move |x| (x, y)))
        .map(|(x, y)| value(x, y))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pixel_keeps_the_colour_of_its_filter() {
        let picture = Picture::rgb_from((4, 2), |x, y| [10 + x as u8, 20 + y as u8, 30]);
        assert_eq!(mosaic(&picture, PixelFormat::BayerRG8), [10, 20, 12, 20, 21, 30, 21, 30]);
        assert_eq!(mosaic(&picture, PixelFormat::BayerGB8), [20, 30, 20, 30, 10, 21, 12, 21]);
    }
}
