use std::{fs, path::Path};

use nalgebra::{Rotation3, UnitQuaternion, Vector2, Vector3};
use netcord_common::{
    board::{BoardError, CalibrationBoard},
    geometry::{Board, Camera, Point, Transform, World},
    rig::{Rig, RigCamera},
};
use thiserror::Error;

/// A calibration board that somebody carries through the scene.
#[derive(Debug, Clone)]
pub struct CarriedBoard {
    /// What is printed on it.
    pub board: CalibrationBoard,
    /// White around the pattern, m.
    pub margin_m: f64,
    path: BoardPath,
}

/// The way of a board: poses at instants, between which it moves evenly; at its end it begins anew.
#[derive(Debug, Clone)]
pub struct BoardPath {
    stops: Vec<Stop>,
}

#[derive(Debug, Clone, Copy)]
struct Stop {
    t_s: f64,
    world_from_board: Transform<World, Board>,
}

/// A board, or its way, that cannot be.
#[derive(Debug, Error)]
pub enum CarriedBoardError {
    /// The description of the board.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The file of its way.
    #[error(
        "the board's way {file}: {what}; each line is t,x,y,z,rx,ry,rz: seconds, the board's origin in metres and its rotation vector in radians, in the world frame, the seconds growing"
    )]
    Path {
        /// The file.
        file: String,
        /// What is wrong.
        what: String,
    },
}

/// How long a board is held still at each place of a tour, s…
const HOLD_S: f64 = 0.8;
/// …and how long it is on its way to the next.
const MOVE_S: f64 = 0.7;
/// White around the pattern, as a share of its height.
const MARGIN: f64 = 0.06;

impl CarriedBoard {
    /// The board after its description, on the way of the CSV file `path`, or on a tour for `rig`.
    ///
    /// # Errors
    /// [`CarriedBoardError`].
    pub fn new(rig: &Rig, spec: &str, path: Option<&Path>) -> Result<Self, CarriedBoardError> {
        let board =
            CalibrationBoard::parse(spec, |file| fs::read_to_string(file).map_err(|e| e.to_string()))?;
        let path = match path {
            Some(path) => BoardPath::read(path)?,
            None => BoardPath::tour(rig, &board),
        };
        let (low, high) = board.extent();
        Ok(Self { margin_m: MARGIN * (high - low).min(), board, path })
    }

    /// Where the board is at `t_s`.
    pub fn at(&self, t_s: f64) -> Transform<World, Board> {
        self.path.at(t_s)
    }

    /// The way.
    pub const fn path(&self) -> &BoardPath {
        &self.path
    }
}

impl BoardPath {
    /// Poses at instants, s, which must grow.
    ///
    /// # Errors
    /// [`CarriedBoardError::Path`] for fewer than one pose, or instants that do not grow.
    pub fn new(poses: &[(f64, Transform<World, Board>)]) -> Result<Self, CarriedBoardError> {
        Self::checked(
            poses.iter().map(|(t_s, p)| Stop { t_s: *t_s, world_from_board: *p }).collect(),
            "given",
        )
    }

    fn checked(stops: Vec<Stop>, file: &str) -> Result<Self, CarriedBoardError> {
        let failed = |what: String| CarriedBoardError::Path { file: file.to_owned(), what };
        if stops.is_empty() {
            return Err(failed("it holds no pose".to_owned()));
        }
        match stops.windows(2).position(|w| w[0].t_s >= w[1].t_s || !w[1].t_s.is_finite()) {
            Some(i) => Err(failed(format!("pose {} is not later than the one before", i + 2))),
            None => Ok(Self { stops }),
        }
    }

    /// Reads lines `t,x,y,z,rx,ry,rz`.
    ///
    /// # Errors
    /// [`CarriedBoardError::Path`] names the line.
    pub fn read(path: &Path) -> Result<Self, CarriedBoardError> {
        let file = path.display().to_string();
        let failed = |what: String| CarriedBoardError::Path { file: file.clone(), what };
        let text = fs::read_to_string(path).map_err(|e| failed(e.to_string()))?;
        let mut stops = Vec::new();
        for (n, line) in text.lines().enumerate() {
            let line = line.trim();
            let heading = n == 0 && line.starts_with('t');
            if line.is_empty() || line.starts_with('#') || heading {
                continue;
            }
            let numbers: Vec<f64> = line
                .split(',')
                .map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite()))
                .collect::<Option<_>>()
                .ok_or_else(|| failed(format!("line {} holds something that is no number", n + 1)))?;
            let [t_s, x, y, z, rx, ry, rz] = numbers[..] else {
                return Err(failed(format!("line {} holds {} numbers, not 7", n + 1, numbers.len())));
            };
            let world_from_board = Transform::from_rodrigues(Vector3::new(rx, ry, rz), Vector3::new(x, y, z));
            stops.push(Stop { t_s, world_from_board });
        }
        Self::checked(stops, &file)
    }

    /// A way that shows `board` to each camera of `rig` alone, all over its image and at many tilts, then to
    /// as many cameras at once as see it, and at last lying on the table.
    pub fn tour(rig: &Rig, board: &CalibrationBoard) -> Self {
        let mut poses: Vec<Transform<World, Board>> = Vec::new();
        for camera in &rig.cameras {
            poses.extend(before(camera, board));
        }
        poses.extend(together(rig, board));
        poses.push(on_table(board, 0.0, 0.35));
        let mut stops = Vec::new();
        let mut t_s = 0.0;
        for pose in poses {
            stops.push(Stop { t_s, world_from_board: pose });
            stops.push(Stop { t_s: t_s + HOLD_S, world_from_board: pose });
            t_s += HOLD_S + MOVE_S;
        }
        // Back to where it began.
        stops.push(Stop { t_s, world_from_board: stops[0].world_from_board });
        Self { stops }
    }

    /// From the first instant to the last, s.
    pub fn length_s(&self) -> f64 {
        self.stops[self.stops.len() - 1].t_s - self.stops[0].t_s
    }

    /// The pose at `t_s`, counted from the first pose's instant.
    pub fn at(&self, t_s: f64) -> Transform<World, Board> {
        let first = self.stops[0].t_s;
        let length = self.length_s();
        let t = if length > 0.0 { first + t_s.rem_euclid(length) } else { first };
        let next = self.stops.partition_point(|s| s.t_s <= t).min(self.stops.len() - 1);
        let (a, b) = (&self.stops[next.saturating_sub(1)], &self.stops[next]);
        let share = if b.t_s > a.t_s { ((t - a.t_s) / (b.t_s - a.t_s)).clamp(0.0, 1.0) } else { 0.0 };
        let turn = |s: &Stop| UnitQuaternion::from_rotation_matrix(&s.world_from_board.rotation);
        let (from, to) = (turn(a), turn(b));
        // Half a turn has no shorter way round: then the later pose is taken at once.
        let rotation = from.try_slerp(&to, share, 1e-9).unwrap_or(to).to_rotation_matrix();
        let translation = a.world_from_board.translation.lerp(&b.world_from_board.translation, share);
        Transform::new(rotation, translation)
    }

    /// As lines that [`Self::read`] reads.
    pub fn to_csv(&self) -> String {
        let mut text = "t,x,y,z,rx,ry,rz\n".to_owned();
        for Stop { t_s, world_from_board } in &self.stops {
            // By way of a quaternion: of a half turn, which a board that faces up is, the matrix's antisymmetric
            // part says nothing.
            let turn = UnitQuaternion::from_rotation_matrix(&world_from_board.rotation);
            let (p, r) = (world_from_board.translation, turn.scaled_axis());
            text.push_str(&format!("{t_s},{},{},{},{},{},{}\n", p.x, p.y, p.z, r.x, r.y, r.z));
        }
        text
    }
}

fn middle(board: &CalibrationBoard) -> Vector3<f64> {
    let (low, high) = board.extent();
    let middle = (low + high) / 2.0;
    Vector3::new(middle.x, middle.y, 0.0)
}

/// Images of the pattern's corners and of the middles of its sides; `None` where one has none.
fn outline(
    camera: &RigCamera,
    board: &CalibrationBoard,
    pose: &Transform<World, Board>,
) -> Option<Vec<Vector2<f64>>> {
    let (low, high) = board.extent();
    let camera_from_board = &camera.camera_from_world * pose;
    [(0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (1.0, 0.5), (1.0, 1.0), (0.5, 1.0), (0.0, 1.0), (0.0, 0.5)]
        .iter()
        .map(|(x, y)| {
            let at = low + (high - low).component_mul(&Vector2::new(*x, *y));
            camera.model.project(&(&camera_from_board * Point::new(at.x, at.y, 0.0)))
        })
        .collect()
}

/// Whether the whole board lies in the image, `rim_px` from its edges.
fn is_inside(camera: &RigCamera, outline: &[Vector2<f64>], rim_px: f64) -> bool {
    let (width, height) = (f64::from(camera.model.width), f64::from(camera.model.height));
    outline
        .iter()
        .all(|p| p.x > rim_px && p.y > rim_px && p.x < width - 1.0 - rim_px && p.y < height - 1.0 - rim_px)
}

/// Poses before one camera: in three rows of five over the image, each tilted another way.
fn before(camera: &RigCamera, board: &CalibrationBoard) -> Vec<Transform<World, Board>> {
    const TILTS_DEG: [f64; 5] = [0.0, 25.0, 35.0, 42.0, 18.0];
    let model = &camera.model;
    let (low, high) = board.extent();
    let diagonal = (high - low).norm();
    let (width, height) = (f64::from(model.width), f64::from(model.height));
    let image = Vector2::new(width, height);
    let rim_px = 0.012 * width;
    let mut poses = Vec::new();
    for k in 0..15_usize {
        let place = Vector2::new(0.1 + 0.2 * (k % 5) as f64, 0.15 + 0.35 * (k / 5) as f64);
        // Every third is nearer than the others.
        let distance = diagonal * model.fx / (width * [0.36, 0.44, 0.62][k % 3]);
        let tilt = TILTS_DEG[(k * 2 + k / 5) % 5].to_radians();
        let about = std::f64::consts::TAU * (k as f64 * 0.381_966);
        let roll = 0.35 * ((k * 7 % 15) as f64 / 7.5 - 1.0);
        let found = (0..24).find_map(|step| {
            // Towards the middle until the whole board is in the image.
            let pulled =
                Vector2::repeat(0.5) + (place - Vector2::repeat(0.5)) * (1.0 - 0.04 * f64::from(step));
            let sight = model.ray(&(image.component_mul(&pulled) - Vector2::repeat(0.5)))?;
            let facing = Rotation3::rotation_between(&Vector3::z(), &sight)?;
            let axis = Vector3::new(about.cos(), about.sin(), 0.0);
            let turn = facing * Rotation3::new(axis * tilt) * Rotation3::new(Vector3::z() * roll);
            let camera_from_board =
                Transform::<Camera, Board>::new(turn, sight * distance - turn * middle(board));
            let pose = &camera.camera_from_world.inverse() * &camera_from_board;
            let seen = outline(camera, board, &pose)?;
            is_inside(camera, &seen, rim_px).then_some(pose)
        });
        poses.extend(found);
    }
    poses
}

/// The board lying face up at height `z_m`, its middle at the table's, turned about the vertical.
fn on_table(board: &CalibrationBoard, z_m: f64, yaw: f64) -> Transform<World, Board> {
    let x = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
    let z = -Vector3::z();
    let turn = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    Transform::new(turn, Vector3::new(0.0, 0.0, z_m) - turn * middle(board))
}

/// Poses over the table that at least two cameras see whole and not too much from the side: each time the
/// one that serves the camera with the fewest best.
fn together(rig: &Rig, board: &CalibrationBoard) -> Vec<Transform<World, Board>> {
    const WANTED: usize = 16;
    /// Cosine of the steepest look at the board: 66°.
    const LEAST_COSINE: f64 = 0.4;
    let mut candidates = Vec::new();
    for k in 0..240_usize {
        let share = |by: f64| (k as f64 * by + 0.5).fract();
        let at = Vector3::new(
            0.9 * (share(0.819_173) - 0.5),
            1.8 * (share(0.671_044) - 0.5),
            0.15 + 0.75 * share(0.549_700),
        );
        let tilt = 30f64.to_radians() * share(0.381_966);
        let about = std::f64::consts::TAU * share(0.618_034);
        let flat = on_table(board, 0.0, std::f64::consts::TAU * share(0.236_068));
        let turn = Rotation3::new(Vector3::new(about.cos(), about.sin(), 0.0) * tilt) * flat.rotation;
        let pose = Transform::new(turn, at - turn * middle(board));
        let normal = -(pose.rotation * Vector3::z());
        let sizes: Vec<f64> = rig
            .cameras
            .iter()
            .map(|camera| {
                let sight = (camera.camera_from_world.origin().coords - at).normalize();
                let seen = outline(camera, board, &pose).filter(|o| is_inside(camera, o, 8.0));
                let side = |o: &Vec<Vector2<f64>>| (o[0] - o[4]).norm().min((o[2] - o[6]).norm());
                let faces = normal.dot(&sight) > LEAST_COSINE;
                seen.as_ref().filter(|_| faces).map_or(0.0, |o| side(o) / f64::from(camera.model.width))
            })
            .collect();
        if sizes.iter().filter(|s| **s > 0.0).count() >= 2 {
            candidates.push((pose, sizes));
        }
    }
    let mut shown = vec![0_usize; rig.cameras.len()];
    let mut chosen = Vec::new();
    while chosen.len() < WANTED {
        let value = |sizes: &[f64]| -> f64 {
            sizes.iter().zip(&shown).map(|(size, n)| size / (1.0 + *n as f64)).sum()
        };
        let best = (0..candidates.len())
            .max_by(|a, b| value(&candidates[*a].1).total_cmp(&value(&candidates[*b].1)));
        let Some(best) = best else { break };
        let (pose, sizes) = candidates.swap_remove(best);
        for (n, size) in shown.iter_mut().zip(&sizes) {
            *n += usize::from(*size > 0.0);
        }
        // What is much like it is not needed.
        candidates.retain(|(other, _)| (other.translation - pose.translation).norm() > 0.15);
        chosen.push(pose);
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::test_rig;

    const SPEC: &str = "charuco:6x4:DICT_4X4_50:120mm:90mm";

    #[test]
    fn a_tour_shows_the_board_to_each_camera_and_to_both() {
        let rig = test_rig();
        let carried = CarriedBoard::new(&rig, SPEC, None).expect("valid");
        let (mut alone, mut both) = ([0, 0], 0);
        let stops: Vec<_> = carried.path.stops.iter().step_by(2).collect();
        for stop in &stops {
            let seen = [0, 1].map(|i| {
                let camera = &rig.cameras[i];
                let faces = |o: &Vec<Vector2<f64>>| (o[2] - o[0]).perp(&(o[6] - o[0])) > 0.0;
                outline(camera, &carried.board, &stop.world_from_board)
                    .is_some_and(|o| is_inside(camera, &o, 1.0) && faces(&o))
            });
            alone = [0, 1].map(|i| alone[i] + usize::from(seen[i]));
            both += usize::from(seen[0] && seen[1]);
        }
        assert!(alone[0] >= 20 && alone[1] >= 20 && both >= 10, "{alone:?} {both} of {}", stops.len());
    }

    #[test]
    fn a_way_is_held_between_its_poses_and_read_back_as_written() {
        let rig = test_rig();
        let carried = CarriedBoard::new(&rig, SPEC, None).expect("valid");
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("way.csv");
        fs::write(&file, carried.path.to_csv()).expect("written");
        let read = BoardPath::read(&file).expect("as written");
        for k in 0..300 {
            let t_s = f64::from(k) * 0.37;
            let (a, b) = (carried.at(t_s), read.at(t_s));
            assert!(
                (a.translation - b.translation).norm() < 1e-12
                    && (a.rotation.matrix() - b.rotation.matrix()).amax() < 1e-9
            );
        }
        let (start, held) = (carried.at(0.0), carried.at(HOLD_S * 0.9));
        assert!((start.translation - held.translation).norm() < 1e-12, "held still");
        assert!((carried.at(carried.path.length_s()).translation - start.translation).norm() < 1e-9, "round");

        fs::write(&file, "0,0,0,1,0,0,0\n1,0,0,1,0,0\n").expect("written");
        let error = BoardPath::read(&file).expect_err("six numbers").to_string();
        assert!(error.contains("line 2") && error.contains("6 numbers"), "{error}");
        fs::write(&file, "1,0,0,1,0,0,0\n1,0,0,1,0,0,0\n").expect("written");
        let error = BoardPath::read(&file).expect_err("no time goes by").to_string();
        assert!(error.contains("pose 2"), "{error}");
        assert!(CarriedBoard::new(&rig, "chessboard:1x1:5mm", None).is_err());
    }
}
