use foxglove::messages::{CameraCalibration, RawImage};
use netcord_capture::recording::{calibration_message, timestamp};
use netcord_common::{
    FrameView,
    rig::RigCamera,
    wire::{Detection, Detections, FrameHeader, SearchWindow},
};

/// How large and how often pictures are.
#[derive(Debug, Clone, Copy)]
pub(super) struct PreviewOptions {
    pub(super) rate_hz: f64,
    pub(super) width: u32,
}

/// Makes small pictures of one camera's frames, and moves what is drawn on them to their scale.
#[derive(Debug, Clone, Copy)]
pub(super) struct Preview {
    /// Frame pixels for one of the picture, along x and y; even, so that each sees the same part of the
    /// mosaic.
    scale: usize,
}

impl Preview {
    /// For the frames of `camera`, at most `width` wide.
    pub(super) fn new(camera: &RigCamera, width: u32) -> Self {
        Self { scale: (camera.model.width.div_ceil(width).next_multiple_of(2) as usize).max(2) }
    }

    /// A picture in colour: of every `scale`-th cell of the mosaic, its own red, green and blue.
    pub(super) fn picture(self, header: &FrameHeader, view: &FrameView<'_>, frame_id: &str) -> RawImage {
        let (width, height) = (view.width() / self.scale, view.height() / self.scale);
        let (red_x, red_y) = view.format().red_at().unwrap_or((0, 0));
        let is_grey = view.format().red_at().is_none();
        let mut data = Vec::with_capacity(3 * width * height);
        for y in 0..height {
            let rows = [view.row(y * self.scale), view.row(y * self.scale + 1)];
            for x in (0..width).map(|x| x * self.scale) {
                let red = rows[red_y][x + red_x];
                if is_grey {
                    data.extend([red; 3]);
                    continue;
                }
                let greens = u16::from(rows[red_y][x + 1 - red_x]) + u16::from(rows[1 - red_y][x + red_x]);
                data.extend([red, (greens / 2) as u8, rows[1 - red_y][x + 1 - red_x]]);
            }
        }
        RawImage {
            timestamp: timestamp(header.stamps.mid_exposure_ns),
            frame_id: frame_id.to_owned(),
            width: width as u32,
            height: height as u32,
            encoding: "rgb8".to_owned(),
            step: 3 * width as u32,
            data: data.into(),
        }
    }

    /// The camera's calibration for its pictures.
    pub(super) fn calibration(self, camera: &RigCamera, stamp_ns: u64) -> CameraCalibration {
        let mut model = camera.model;
        let scale = self.scale as f64;
        (model.width, model.height) = (model.width / self.scale as u32, model.height / self.scale as u32);
        (model.fx, model.fy) = (model.fx / scale, model.fy / scale);
        (model.cx, model.cy) = (self.shrink(model.cx), self.shrink(model.cy));
        calibration_message(stamp_ns, camera.name.as_str(), &model)
    }

    /// A pixel position of the frame in the picture: both have pixel centres at whole numbers.
    fn shrink(self, at: f64) -> f64 {
        (at + 0.5) / self.scale as f64 - 0.5
    }

    /// Detections on the picture's scale.
    pub(super) fn detections(self, detections: &Detections) -> Detections {
        let mut out = *detections;
        for item in &mut out.items {
            *item = Detection {
                u_px: self.shrink(item.u_px),
                v_px: self.shrink(item.v_px),
                x0_px: self.shrink(item.x0_px),
                y0_px: self.shrink(item.y0_px),
                x1_px: self.shrink(item.x1_px),
                y1_px: self.shrink(item.y1_px),
                ..*item
            };
        }
        out
    }

    /// A search window on the picture's scale.
    pub(super) fn window(self, window: &SearchWindow) -> SearchWindow {
        SearchWindow {
            x0_px: self.shrink(window.x0_px),
            y0_px: self.shrink(window.y0_px),
            x1_px: self.shrink(window.x1_px),
            y1_px: self.shrink(window.y1_px),
            ..*window
        }
    }
}

#[cfg(test)]
mod tests {
    use netcord_common::{Channel, PixelFormat};

    use super::*;

    #[test]
    fn pictures_have_the_colours_of_the_scene_in_every_mosaic() {
        for format in PixelFormat::ALL {
            let colour = |x, y| match format.channel_at(x, y) {
                Channel::Red => 200,
                Channel::Green => 120,
                Channel::Blue => 40,
                Channel::Luma => 90,
            };
            let bytes = (0..8 * 12).map(|i| colour(i % 12, i / 12)).collect::<Vec<u8>>();
            let view = FrameView::new(&bytes, (12, 8), 12, format).expect("valid");
            let picture = Preview { scale: 4 }.picture(&FrameHeader::default(), &view, "left");
            assert_eq!((picture.width, picture.height, picture.step), (3, 2, 9));
            let expected = if format == PixelFormat::Mono8 { [90; 3] } else { [200, 120, 40] };
            assert!(picture.data.chunks(3).all(|pixel| pixel == expected), "{format}");
        }
    }

    #[test]
    fn the_edges_of_the_frame_are_the_edges_of_the_picture() {
        let preview = Preview { scale: 4 };
        assert_eq!(preview.shrink(-0.5), -0.5);
        assert_eq!(preview.shrink(11.5), 2.5);
    }
}
