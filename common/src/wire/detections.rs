use iceoryx2::prelude::ZeroCopySend;

use super::{Message, Stamps, assert_layout, code_enum};

/// Most candidates in one message; the ones of lowest score are left out.
pub const MAX_DETECTIONS: usize = 16;

code_enum! {
    /// What part of the frame a message speaks for.
    Scope {
        /// The whole frame.
        Full = 0 => "full",
        /// The predicted search window only; a message of scope `full` follows.
        Window = 1 => "window",
    }
}

/// What is known of a detection beside its measures: bits of [`Detection::flags`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DetectionFlags;

impl DetectionFlags {
    /// The ball's image is cut by the frame's edge.
    pub const CUT_BY_FRAME: u32 = 1;
    /// Part of the ball's outline is hidden or could not be seen.
    pub const OCCLUDED: u32 = 2;
    /// Pixels inside are saturated.
    pub const SATURATED: u32 = 4;
    /// It has not moved for some frames: a look-alike, or a ball at rest.
    pub const AT_REST: u32 = 8;
    /// `u, v` are corrected from the centre of the sphere's outline to the image of its centre.
    pub const SPHERE_CORRECTED: u32 = 16;
    /// `blur_u_px, blur_v_px` were measured (else they are zero because nothing was seen of blur).
    pub const BLUR_MEASURED: u32 = 32;
}

/// One candidate for a ball in one frame, in raw (distorted) pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("netcord.Detection")]
#[repr(C)]
pub struct Detection {
    /// Image of the ball's centre at mid-exposure, x, px.
    pub u_px: f64,
    /// Image of the ball's centre at mid-exposure, y, px.
    pub v_px: f64,
    /// Covariance of (u, v), px²: uu, uv, vv.
    pub covariance_px2: [f64; 3],
    /// Left edge of the ball's image swept over the exposure, in continuous coordinates (pixel j
    /// spans j − 0.5 … j + 0.5), px.
    pub x0_px: f64,
    /// Top edge, px.
    pub y0_px: f64,
    /// Right edge, px.
    pub x1_px: f64,
    /// Bottom edge, px.
    pub y1_px: f64,
    /// Diameter of the ball's image across the blur, px.
    pub diameter_px: f64,
    /// Area of the swept image, px².
    pub area_px2: f64,
    /// Path of the centre during the exposure, x, px; the sign of the pair is not known, the first
    /// non-zero of (u, v) is positive.
    pub blur_u_px: f64,
    /// Path of the centre during the exposure, y, px.
    pub blur_v_px: f64,
    /// How much this looks like the ball in play, 0–1.
    pub score: f64,
    /// Bits of [`DetectionFlags`].
    pub flags: u32,
    #[doc(hidden)]
    pub _reserved: u32,
}

assert_layout!(Detection, size = 120, covariance_px2 = 16, x0_px = 40, score = 104, flags = 112);

/// What the segmenter found in one frame of one camera: `camera/<name>/detections`.
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("netcord.Detections")]
#[repr(C)]
pub struct Detections {
    /// The frame's.
    pub trigger_id: u64,
    /// The frame's.
    pub sequence: u64,
    /// The frame's session.
    pub session: u64,
    /// The frame's, with segment's own.
    pub stamps: Stamps,
    /// The frame's exposure, ns.
    pub exposure_ns: u64,
    /// Frames of this session that this segmenter has not looked at so far.
    pub frames_lost: u64,
    /// Place of the camera in the rig file, from 0.
    pub camera: u32,
    /// [`Scope`] as its code.
    pub scope: u32,
    /// How many of `items` are filled, best score first.
    pub count: u32,
    #[doc(hidden)]
    pub _reserved: u32,
    /// The candidates; beyond `count` zero.
    pub items: [Detection; MAX_DETECTIONS],
}

assert_layout!(
    Detections,
    size = 136 + 120 * MAX_DETECTIONS,
    stamps = 24,
    exposure_ns = 104,
    camera = 120,
    items = 136
);

impl Message for Detections {}

impl Default for Detections {
    fn default() -> Self {
        Self {
            trigger_id: 0,
            sequence: 0,
            session: 0,
            stamps: Stamps::default(),
            exposure_ns: 0,
            frames_lost: 0,
            camera: 0,
            scope: Scope::Full.code(),
            count: 0,
            _reserved: 0,
            items: [Detection::default(); MAX_DETECTIONS],
        }
    }
}

impl Detections {
    /// The filled items.
    pub fn items(&self) -> &[Detection] {
        &self.items[..(self.count as usize).min(MAX_DETECTIONS)]
    }

    /// Adds a candidate, in order of score; where all places are taken the worst is left out.
    pub fn insert(&mut self, item: Detection) {
        let count = (self.count as usize).min(MAX_DETECTIONS);
        let place = self.items[..count].iter().position(|other| other.score < item.score).unwrap_or(count);
        if place == MAX_DETECTIONS {
            return;
        }
        let count = (count + 1).min(MAX_DETECTIONS);
        self.items.copy_within(place..count - 1, place + 1);
        self.items[place] = item;
        self.count = u32::try_from(count).expect("at most 16");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_sixteen_are_kept_in_order() {
        let mut message = Detections::default();
        for i in 0..40_u32 {
            message.insert(Detection { score: f64::from((i * 17) % 40) / 40.0, ..Detection::default() });
        }
        let scores = message.items().iter().map(|d| d.score).collect::<Vec<_>>();
        let expected = (0..16).map(|i| f64::from(39 - i) / 40.0).collect::<Vec<_>>();
        assert_eq!(scores, expected);
    }
}
