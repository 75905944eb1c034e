//! What cameras see of a scene, as raw mosaics.
//!
//! A frame is the [`Set`], which changes a few times a second at most in any place, and before it the ball,
//! painted into tiles of mean levels; all is then developed: brightness, shot and read noise, quantisation.

mod backdrop;
mod board;
mod canvas;
#[cfg(test)]
mod exact;
mod frame;
mod layer;
mod noise;
mod outline;
mod painter;
mod rays;
mod rect;
mod set;
mod shadow;
mod tiles;
mod view;

use backdrop::Backdrop;
use canvas::Canvas;
pub use frame::{Exposure, FrameRenderer};
use layer::Layer;
use noise::Developer;
pub use noise::{SensorNoise, hash};
use outline::Outline;
#[cfg(test)]
use outline::Seen;
use painter::Painter;
use rays::RayTable;
use rect::Rect;
use set::Set;
use shadow::cast_shadows;
pub use tiles::{TILE, TileGrid};
use view::{View, channels};
