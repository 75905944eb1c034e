//! From a raw mosaic to boxes around what may be the ball.
//!
//! One pass over the frame's memory marks the cells that differ from the learnt background by more than noise
//! explains ([`kernel`]); marked cells are grouped; each group is measured by fitting a swept, smoothly
//! shaded disc in front of the background, and judged by what the fit leaves, by its colour in the scene's
//! light, and by whether it moves. Where no background is known yet, colour marks the cells.

mod appearance;
mod background;
mod behind;
mod blobs;
mod blur;
mod candidate;
mod colour;
mod demosaic;
mod describe;
mod fit;
mod follow;
mod foreground;
mod grid;
pub mod kernel;
mod lanes;
pub mod learn;
pub mod live;
mod look;
mod measure;
mod noise;
mod options;
mod outline;
mod patch;
mod rest;
#[cfg(test)]
mod scene;
mod score;
mod segmenter;
mod singles;
mod size;
mod sphere;
mod sweep;
#[cfg(test)]
mod tests;
mod verdict;
#[cfg(test)]
mod window_tests;

pub use options::{InputMode, SegmentError, SegmentOptions};
pub use score::SCORE_THRESHOLD;
pub use segmenter::Segmenter;
