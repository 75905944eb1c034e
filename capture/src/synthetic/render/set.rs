use std::sync::Arc;

use super::{Layer, Outline, Painter, TileGrid, View, tiles::TILE};
use crate::synthetic::scene::Scene;

/// What stands before the camera beside the ball: the backdrop, with players and balls that are not in play
/// painted onto it as they last were. They are large, or slow beside the ball: each is renewed 5 to 50 times a
/// second, at its own instants, and a frame in which none is costs nothing here.
#[derive(Debug)]
pub struct Set {
    scene: Arc<Scene>,
    /// Mean level of each pixel in full light, DN.
    means: Vec<u8>,
    actors: Vec<Actor>,
    /// Places of the actors in the picture, the farthest first.
    order: Vec<usize>,
    /// Tiles in which an actor was renewed, and whether each tile is one.
    stale: Vec<u32>,
    is_stale: Vec<bool>,
    /// Whether a tile shows an actor.
    dressed: Vec<bool>,
    painter: Painter,
}

/// A body that is not the ball.
#[derive(Debug, Default)]
struct Actor {
    /// Which of its instants the layer is of.
    step: Option<i64>,
    outline: Option<Outline>,
    layer: Layer,
}

/// Room for a player's chest at a metre and a half; memory that is never touched is never taken.
const ACTOR_PIXELS: usize = 1 << 18;

impl Actor {
    fn depth_m(&self) -> f64 {
        self.outline.as_ref().map_or(0.0, |o| o.depth_m)
    }
}

impl Set {
    /// The backdrop of `view`, without anybody before it yet.
    pub fn new(scene: &Arc<Scene>, view: &View) -> Self {
        let tiles = view.grid.count();
        Self {
            scene: Arc::clone(scene),
            means: view.backdrop.means.clone(),
            actors: (0..scene.cast.size())
                .map(|_| Actor { layer: Layer::with_room(ACTOR_PIXELS), ..Actor::default() })
                .collect(),
            order: Vec::with_capacity(scene.cast.size()),
            stale: Vec::with_capacity(tiles),
            is_stale: vec![false; tiles],
            dressed: vec![false; tiles],
            painter: Painter::new(view.grid.width),
        }
    }

    /// Mean level of each pixel in full light, DN.
    pub fn means(&self) -> &[u8] {
        &self.means
    }

    /// The tiles that show an actor.
    pub fn dressed(&self) -> impl Iterator<Item = u32> + '_ {
        self.dressed.iter().enumerate().filter(|(_, dressed)| **dressed).map(|(tile, _)| tile as u32)
    }

    /// Brings the set to the instant `t_s`.
    pub fn renew(&mut self, view: &mut View, t_s: f64) {
        let count = self.actors.len();
        let mut changed = false;
        for index in 0..count {
            let renewal_s = self.scene.cast.renewal_s(index);
            let offset = renewal_s * index as f64 / count as f64;
            let step = ((t_s + offset) / renewal_s).floor();
            if self.actors[index].step != Some(step as i64) {
                self.actors[index].step = Some(step as i64);
                self.renew_actor(index, view, step * renewal_s - offset);
                changed = true;
            }
        }
        if !changed {
            return;
        }
        let Self { actors, order, .. } = self;
        order.clear();
        order.extend((0..count).filter(|i| actors[*i].outline.is_some()));
        order.sort_unstable_by(|a, b| actors[*b].depth_m().total_cmp(&actors[*a].depth_m()));
        self.compose(view);
    }

    /// The actors behind something at this depth, the farthest first.
    pub fn behind(&self, depth_m: f64) -> impl Iterator<Item = &Layer> {
        let actors = self.order.iter().map(|i| &self.actors[*i]);
        actors.take_while(move |actor| actor.depth_m() > depth_m).map(|actor| &actor.layer)
    }

    /// The actors before something at this depth, the farthest first.
    pub fn before(&self, depth_m: f64) -> impl Iterator<Item = &Layer> {
        let actors = self.order.iter().map(|i| &self.actors[*i]);
        actors.skip_while(move |actor| actor.depth_m() > depth_m).map(|actor| &actor.layer)
    }

    fn renew_actor(&mut self, index: usize, view: &mut View, t_s: f64) {
        self.touch(index, view.grid);
        let Self { scene, actors, painter, .. } = self;
        let actor = &mut actors[index];
        let body = scene.cast.body(index, t_s, scene.radius_m);
        let seen = body.and_then(|body| {
            let outline = view.outline_inside(&body, scene.blur_px)?;
            view.contains_some_of(&outline.rect).then_some((outline, body.paint))
        });
        actor.outline = seen.map(|(outline, _)| outline);
        if let Some((outline, paint)) = seen {
            painter.lay(scene, view, std::slice::from_ref(&outline), &paint, &mut actor.layer);
        }
        self.touch(index, view.grid);
    }

    /// Takes note of the tiles that an actor covers.
    fn touch(&mut self, index: usize, grid: TileGrid) {
        let Self { actors, stale, is_stale, .. } = self;
        let Actor { outline: Some(_), layer, .. } = &actors[index] else { return };
        for y in layer.rows() {
            let xs = layer.covered(y);
            if xs.is_empty() {
                continue;
            }
            for tile in grid.tile_of(xs.start, y)..=grid.tile_of(xs.end - 1, y) {
                if !std::mem::replace(&mut is_stale[tile as usize], true) {
                    stale.push(tile);
                }
            }
        }
    }

    /// Paints the tiles that were touched anew.
    fn compose(&mut self, view: &View) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2, as was just asked.
            unsafe { self.compose_avx2(view) };
            return;
        }
        self.compose_here(view);
    }

    /// The same code, compiled for AVX2: twice as many pixels at a time, with the same results.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn compose_avx2(&mut self, view: &View) {
        self.compose_here(view);
    }

    #[inline(always)]
    fn compose_here(&mut self, view: &View) {
        let Self { means, actors, order, stale, is_stale, dressed, .. } = self;
        for tile in stale.drain(..) {
            is_stale[tile as usize] = false;
            let (xs, ys) = view.grid.pixels(tile);
            let row = |y: usize| y * view.grid.width + xs.start..y * view.grid.width + xs.end;
            let mut levels = [[0.0_f32; TILE]; TILE];
            for (y, levels) in ys.clone().zip(&mut levels) {
                for (level, mean) in levels.iter_mut().zip(&view.backdrop.means[row(y)]) {
                    *level = f32::from(*mean);
                }
            }
            dressed[tile as usize] = false;
            for layer in order.iter().map(|i| &actors[*i].layer) {
                for y in layer.rows_among(&xs, &ys) {
                    let painted = layer.blend(y, xs.clone(), 1.0, &mut levels[y - ys.start][..xs.len()]);
                    dressed[tile as usize] |= painted;
                }
            }
            for (y, levels) in ys.clone().zip(&levels) {
                for (mean, level) in means[row(y)].iter_mut().zip(levels) {
                    *mean = (level + 0.5) as u8;
                }
            }
        }
    }
}
