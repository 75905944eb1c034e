use std::{collections::VecDeque, f64::consts::TAU};

use foxglove::messages::{
    Color, CubePrimitive, Duration, LinePrimitive, Point3, Pose, Quaternion, SceneEntity, SceneUpdate,
    SpherePrimitive, Vector3, line_primitive,
};
use nalgebra::{Matrix2, Vector2};
use netcord_capture::recording::{TABLE_FRAME, timestamp};
use netcord_common::{
    rig::Rig,
    wire::{BallPosition, BallTrajectory, LandingKind, WorldFrame},
};

use super::colours;

/// The topics of the scene's parts.
pub const TABLE_TOPIC: &str = "/scene/table";
/// As [`TABLE_TOPIC`].
pub const BALL_TOPIC: &str = "/scene/ball";
/// As [`TABLE_TOPIC`].
pub const PATH_TOPIC: &str = "/scene/path";

/// Measures of a table (ITTF Laws 2.1 and 2.2), m.
mod table {
    pub(super) const WIDTH: f64 = 1.525;
    pub(super) const LENGTH: f64 = 2.74;
    pub(super) const NET_HEIGHT: f64 = 0.1525;
    pub(super) const NET_WIDTH: f64 = 1.83;
    /// Lines at the edges are 20 mm wide, the centre line 3 mm.
    pub(super) const EDGE_LINE: f64 = 0.02;
    pub(super) const CENTRE_LINE: f64 = 0.003;
    /// Thickness of a usual board; only for looks.
    pub(super) const THICKNESS: f64 = 0.025;
}

/// How much of the past the trail shows, ns.
const TRAIL_NS: u64 = 1_000_000_000;
/// How long a ball stays in the picture when nothing follows, ns.
const LIFETIME_NS: u32 = 200_000_000;
/// The landing ellipse holds 95 % of a normal distribution of two dimensions: χ²₂(0.95) = 5.99.
const ELLIPSE_SIGMAS: f64 = 2.447;
const ELLIPSE_POINTS: u32 = 32;

/// The 3D scene of a rig: table and net once, then ball, trail and predicted path for each message.
#[derive(Debug)]
pub struct Scene {
    frame_id: String,
    has_table: bool,
    ball_diameter_m: f64,
    trail: VecDeque<(u64, [f64; 3])>,
}

/// The frame of reference of a rig's results, as `/tf` and scenes name it.
pub fn world_frame_id(rig: &Rig) -> String {
    match rig.world {
        WorldFrame::Table => TABLE_FRAME.to_owned(),
        WorldFrame::FirstCamera => rig.cameras[0].name.to_string(),
    }
}

impl Scene {
    /// The scene of a rig.
    pub fn new(rig: &Rig) -> Self {
        Self {
            frame_id: world_frame_id(rig),
            has_table: rig.world == WorldFrame::Table,
            ball_diameter_m: rig.ball.diameter_m,
            trail: VecDeque::new(),
        }
    }

    /// Table, lines and net; nothing where no table is known.
    pub fn table(&self, stamp_ns: u64) -> Option<SceneUpdate> {
        use table::{CENTRE_LINE, EDGE_LINE, LENGTH, NET_HEIGHT, NET_WIDTH, THICKNESS, WIDTH};
        if !self.has_table {
            return None;
        }
        let mut entity = self.entity("table", stamp_ns, None);
        // A little below the surface, so that the lines on it are seen.
        entity.cubes = vec![
            cube((0.0, 0.0, -0.5 * THICKNESS - 0.001), (WIDTH, LENGTH, THICKNESS), colours::TABLE),
            cube((0.0, 0.0, 0.5 * NET_HEIGHT), (NET_WIDTH, 0.004, NET_HEIGHT), colours::NET),
        ];
        let (x, y) = (0.5 * (WIDTH - EDGE_LINE), 0.5 * (LENGTH - EDGE_LINE));
        let edge = [(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)].map(|(x, y)| point([x, y, 0.0]));
        let centre = [(0.0, -y), (0.0, y)].map(|(x, y)| point([x, y, 0.0]));
        entity.lines = vec![
            line(edge.to_vec(), EDGE_LINE, colours::LINES),
            line(centre.to_vec(), CENTRE_LINE, colours::LINES),
        ];
        Some(update(entity))
    }

    /// The ball where it was measured, and its past.
    pub fn ball(&mut self, position: &BallPosition) -> Option<SceneUpdate> {
        if !position.is_present() {
            return None;
        }
        let t_ns = position.stamps.mid_exposure_ns;
        self.trail.push_back((t_ns, position.position_m));
        // Also when a recording is replayed from its start again.
        self.trail.retain(|(t, _)| *t <= t_ns && t_ns - t <= TRAIL_NS);
        let mut entity = self.entity("ball", t_ns, Some(LIFETIME_NS));
        let size = self.ball_diameter_m;
        entity.spheres = vec![SpherePrimitive {
            pose: Some(pose(position.position_m)),
            size: Some(Vector3 { x: size, y: size, z: size }),
            color: Some(colours::BALL),
        }];
        let trail = self.trail.iter().map(|(_, p)| point(*p)).collect::<Vec<_>>();
        if trail.len() > 1 {
            entity.lines = vec![line(trail, 0.01, colours::TRAIL)];
        }
        Some(update(entity))
    }

    /// The predicted path, the paler the less sure, and the ellipse in which the ball will land.
    pub fn path(&self, trajectory: &BallTrajectory) -> Option<SceneUpdate> {
        if trajectory.path().is_empty() {
            return None;
        }
        let mut entity = self.entity("path", trajectory.stamps.mid_exposure_ns, Some(LIFETIME_NS));
        let points = trajectory.path().iter().map(|p| point(p.position_m)).collect::<Vec<_>>();
        let shade = |confidence: f64| Color { a: 0.1 + 0.9 * confidence.clamp(0.0, 1.0), ..colours::PATH };
        let colors = trajectory.path().iter().map(|p| shade(p.confidence)).collect();
        entity.lines = vec![LinePrimitive { colors, ..line(points, 0.015, colours::PATH) }];
        let landing = &trajectory.landing;
        if landing.kind != LandingKind::None.code() {
            let outline = ellipse(landing.position_m, landing.covariance_m2);
            entity.lines.push(line(outline, 0.008, colours::LANDING));
        }
        Some(update(entity))
    }

    fn entity(&self, id: &str, stamp_ns: u64, lifetime_ns: Option<u32>) -> SceneEntity {
        SceneEntity {
            timestamp: timestamp(stamp_ns),
            frame_id: self.frame_id.clone(),
            id: id.to_owned(),
            lifetime: lifetime_ns.map(|ns| Duration::new(0, ns)),
            ..SceneEntity::default()
        }
    }
}

/// The outline of a confidence ellipse on the table's surface, closed.
fn ellipse([x, y]: [f64; 2], [xx, xy, yy]: [f64; 3]) -> Vec<Point3> {
    let eigen = Matrix2::new(xx, xy, xy, yy).symmetric_eigen();
    (0..=ELLIPSE_POINTS)
        .map(|i| {
            let (sin, cos) = (TAU * f64::from(i) / f64::from(ELLIPSE_POINTS)).sin_cos();
            let along = |axis: usize| eigen.eigenvalues[axis].max(0.0).sqrt() * ELLIPSE_SIGMAS;
            let at = eigen.eigenvectors * Vector2::new(along(0) * cos, along(1) * sin);
            point([x + at.x, y + at.y, 0.002])
        })
        .collect()
}

fn update(entity: SceneEntity) -> SceneUpdate {
    SceneUpdate { deletions: Vec::new(), entities: vec![entity] }
}

fn point([x, y, z]: [f64; 3]) -> Point3 {
    Point3 { x, y, z }
}

fn pose([x, y, z]: [f64; 3]) -> Pose {
    Pose {
        position: Some(Vector3 { x, y, z }),
        orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    }
}

fn cube((x, y, z): (f64, f64, f64), (dx, dy, dz): (f64, f64, f64), colour: Color) -> CubePrimitive {
    CubePrimitive {
        pose: Some(pose([x, y, z])),
        size: Some(Vector3 { x: dx, y: dy, z: dz }),
        color: Some(colour),
    }
}

fn line(points: Vec<Point3>, thickness: f64, colour: Color) -> LinePrimitive {
    LinePrimitive {
        r#type: line_primitive::Type::LineStrip.into(),
        pose: Some(pose([0.0; 3])),
        thickness,
        points,
        color: Some(colour),
        ..LinePrimitive::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_landing_ellipse_has_the_axes_of_its_covariance() {
        // 10 mm along the diagonal, 1 mm across.
        let (a, b) = (1e-4, 1e-6);
        let outline = ellipse([0.5, -0.5], [0.5 * (a + b), 0.5 * (a - b), 0.5 * (a + b)]);
        let along = |p: &Point3| (p.x - 0.5 + p.y + 0.5) / 2.0_f64.sqrt();
        let across = |p: &Point3| (p.x - 0.5 - p.y - 0.5) / 2.0_f64.sqrt();
        let longest = outline.iter().map(along).fold(0.0, f64::max);
        let widest = outline.iter().map(across).fold(0.0, f64::max);
        assert!((longest - 0.02447).abs() < 1e-4, "{longest}");
        assert!((widest - 0.002447).abs() < 1e-5, "{widest}");
    }
}
