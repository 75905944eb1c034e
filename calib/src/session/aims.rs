use nalgebra::{Vector2, Vector3};
use netcord_common::camera::{CameraModel, Distortion};
use serde::Serialize;

use super::{
    advice::{Place, Tilt},
    kept::KeptView,
    setup::Task,
};
use crate::solve::board_pose;

/// Regions of the picture along each side that views should reach.
const REGIONS: usize = 3;

/// How much of each kind a task wants of one camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aims {
    /// Views.
    pub views: usize,
    /// Corners in each ninth of the picture: the lens is only known where there were corners.
    pub corners_per_region: u32,
    /// Views tilted each of four ways: frontal views leave the focal length and the distance exchangeable.
    pub views_per_tilt: u32,
    /// The nearest view's share of the picture's side, so that a view fills it.
    pub nearest_fill: f64,
    /// The farthest view's share over the nearest's: different distances.
    pub farthest_over_nearest: f64,
}

impl Aims {
    /// Those of a task.
    pub const fn of(task: Task) -> Self {
        match task {
            Task::Mono => Self {
                views: 12,
                corners_per_region: 6,
                views_per_tilt: 2,
                nearest_fill: 0.4,
                farthest_over_nearest: 0.75,
            },
            // Intrinsics are known; the board should have been in many places that both cameras see.
            Task::Rig => Self {
                views: 12,
                corners_per_region: 0,
                views_per_tilt: 1,
                nearest_fill: 0.0,
                farthest_over_nearest: 0.85,
            },
            Task::Table => Self {
                views: 3,
                corners_per_region: 0,
                views_per_tilt: 0,
                nearest_fill: 0.0,
                farthest_over_nearest: 1.0,
            },
        }
    }
}

/// One aim, for a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Aim {
    /// What.
    pub name: &'static str,
    /// How many there are.
    pub have: usize,
    /// How many there should be.
    pub want: usize,
}

/// What one camera's views have reached.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraAims {
    aims: Aims,
    views: usize,
    regions: [[u32; REGIONS]; REGIONS],
    tilts: [u32; 4],
    nearest: f64,
    farthest: f64,
}

/// A tilt counts from here: 0.2 is the sine of 12°.
const LEAST_TILT: f64 = 0.2;

impl CameraAims {
    /// Of `views`, by the intrinsics where they are known, else by a guess that is good enough for telling tilts.
    pub fn of<'a>(
        aims: Aims,
        model: Option<&CameraModel>,
        views: impl IntoIterator<Item = &'a KeptView>,
    ) -> Self {
        let mut found = Self {
            aims,
            views: 0,
            regions: [[0; REGIONS]; REGIONS],
            tilts: [0; 4],
            nearest: 0.0,
            farthest: f64::INFINITY,
        };
        for view in views {
            found.add(model, view);
        }
        found
    }

    fn add(&mut self, model: Option<&CameraModel>, view: &KeptView) {
        let (width, height) = (f64::from(view.size.0), f64::from(view.size.1));
        self.views += 1;
        for p in &view.view.image {
            let region = |at: f64, size: f64| {
                ((at + 0.5) / size * REGIONS as f64).clamp(0.0, (REGIONS - 1) as f64) as usize
            };
            self.regions[region(p.y, height)][region(p.x, width)] += 1;
        }
        let fill = (area(&view.outline) / (width * height)).sqrt();
        self.nearest = self.nearest.max(fill);
        self.farthest = self.farthest.min(fill);
        if let Some(facing) = facing(model, view) {
            for (count, tilt) in self.tilts.iter_mut().zip(Tilt::ALL) {
                *count += u32::from(facing.dot(&tilt.direction()) >= LEAST_TILT);
            }
        }
    }

    /// How much of the aims is reached, 0–1.
    pub fn reached(&self) -> f64 {
        let share = |have: f64, want: f64| if want <= 0.0 { 1.0 } else { (have / want).clamp(0.0, 1.0) };
        let a = &self.aims;
        let regions: f64 = self
            .regions
            .iter()
            .flatten()
            .map(|n| share(f64::from(*n), f64::from(a.corners_per_region)))
            .sum();
        let tilts: f64 = self.tilts.iter().map(|n| share(f64::from(*n), f64::from(a.views_per_tilt))).sum();
        let parts = [
            (share(self.views as f64, a.views as f64), 2.0),
            (regions / (REGIONS * REGIONS) as f64, 4.0),
            (tilts / 4.0, 3.0),
            (share(self.nearest, a.nearest_fill), 0.5),
            (if self.has_distances() { 1.0 } else { 0.0 }, 0.5),
        ];
        parts.iter().map(|(p, w)| p * w).sum::<f64>() / parts.iter().map(|(_, w)| w).sum::<f64>()
    }

    fn has_distances(&self) -> bool {
        self.views > 0 && self.farthest <= self.aims.farthest_over_nearest * self.nearest
    }

    /// Each aim with how much of it is reached and how much is wanted; those that a task does not have are left out.
    pub fn list(&self) -> Vec<Aim> {
        let a = &self.aims;
        let mut list = vec![Aim { name: "views", have: self.views, want: a.views }];
        if a.corners_per_region > 0 {
            let reached = self.regions.iter().flatten().filter(|n| **n >= a.corners_per_region).count();
            list.push(Aim { name: "picture parts", have: reached, want: REGIONS * REGIONS });
        }
        if a.views_per_tilt > 0 {
            let reached = self.tilts.iter().filter(|n| **n >= a.views_per_tilt).count();
            list.push(Aim { name: "tilts", have: reached, want: self.tilts.len() });
        }
        if a.nearest_fill > 0.0 || a.farthest_over_nearest < 1.0 {
            let near = self.views > 0 && self.nearest >= a.nearest_fill;
            let reached = usize::from(near) + usize::from(self.has_distances());
            list.push(Aim { name: "distances", have: reached, want: 2 });
        }
        list
    }

    /// Views so far.
    pub const fn views(&self) -> usize {
        self.views
    }

    /// Whether there are views enough.
    pub const fn has_views(&self) -> bool {
        self.views >= self.aims.views
    }

    /// The part of the picture that lacks corners most; with `empty_only`, only one that has none.
    pub fn lacking_place(&self, empty_only: bool) -> Option<Place> {
        if self.aims.corners_per_region == 0 {
            return None;
        }
        let limit = if empty_only { 1 } else { self.aims.corners_per_region };
        let cells = (0..REGIONS * REGIONS).map(|i| (i % REGIONS, i / REGIONS));
        cells
            .map(|(x, y)| (self.regions[y][x], x, y))
            .filter(|(n, ..)| *n < limit)
            .min_by_key(|(n, ..)| *n)
            .map(|(_, x, y)| Place { column: x, row: y })
    }

    /// The tilt that lacks views most.
    pub fn lacking_tilt(&self) -> Option<Tilt> {
        let by_count = self.tilts.iter().zip(Tilt::ALL).filter(|(n, _)| **n < self.aims.views_per_tilt);
        by_count.min_by_key(|(n, _)| **n).map(|(_, tilt)| tilt)
    }

    /// Whether no view is near enough.
    pub fn lacks_near(&self) -> bool {
        self.views > 0 && self.nearest < self.aims.nearest_fill
    }

    /// Whether all views are about as far away.
    pub fn lacks_far(&self) -> bool {
        self.views > 1 && !self.has_distances()
    }
}

fn area(polygon: &[Vector2<f64>]) -> f64 {
    0.5 * (0..polygon.len()).map(|i| polygon[i].perp(&polygon[(i + 1) % polygon.len()])).sum::<f64>().abs()
}

/// Where the board faces, in the camera's frame: (0, 0, −1) looks straight at the camera.
fn facing(model: Option<&CameraModel>, view: &KeptView) -> Option<Vector3<f64>> {
    let (width, height) = view.size;
    let guess = || {
        // A lens of about 55° is in the middle of what labs use; tilts are told within a few degrees.
        let f = 0.95 * f64::from(width.max(height));
        let centre = (f64::from(width) / 2.0 - 0.5, f64::from(height) / 2.0 - 0.5);
        CameraModel::new(view.size, (f, f), centre, Distortion::default()).ok()
    };
    let model = model.copied().or_else(guess)?;
    let pose = board_pose(&model, &view.view.object, &view.view.image)?;
    let towards = -(pose.camera_from_board.rotation * Vector3::z());
    // Seen from behind, as OpenCV's boards are numbered when they hang upside down: the same plane.
    Some(if towards.z > 0.0 { -towards } else { towards })
}
