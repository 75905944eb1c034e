//! Bundle adjustment of any number of cameras: one engine for mono, stereo, rigs and moving points.

use nalgebra::{DMatrix, DVector, Rotation3, SMatrix, SVector, Vector2, Vector3};
use netcord_common::{
    camera::{CameraModel, INTRINSICS},
    geometry::{Camera, Point, Transform, World},
};
use rayon::prelude::*;

use super::{
    block::{Block, cross},
    loss::Loss,
    views::PixelMotion,
};

/// Which unknowns of a camera are solved for.
#[derive(Debug, Clone, PartialEq)]
pub struct Freedom {
    /// Which of `fx fy cx cy k1 k2 p1 p2 k3` are free.
    pub intrinsics: [bool; INTRINSICS],
    /// Whether fx / fy stays what it is at the start.
    pub tie_aspect: bool,
    /// Whether the camera may move in the rig.
    pub pose: bool,
    /// Whether its clock may be off; needs sightings in motion.
    pub clock: bool,
}

impl Freedom {
    /// All intrinsics free, the pose fixed.
    pub const INTRINSICS: Self =
        Self { intrinsics: [true; INTRINSICS], tie_aspect: false, pose: false, clock: false };
    /// Nothing free.
    pub const NOTHING: Self =
        Self { intrinsics: [false; INTRINSICS], tie_aspect: false, pose: false, clock: false };

    /// Number of unknowns, with a basis of so many intrinsics.
    fn unknowns(&self, basis: usize) -> usize {
        basis + 6 * usize::from(self.pose) + usize::from(self.clock)
    }

    /// Directions in the space of the nine intrinsics that may be stepped along, one a column.
    fn basis(&self, model: &CameraModel) -> Vec<SVector<f64, INTRINSICS>> {
        let unit = |i: usize| SVector::<f64, INTRINSICS>::from_fn(|r, _| f64::from(u8::from(r == i)));
        let tied = self.tie_aspect && self.intrinsics[0] && self.intrinsics[1];
        let mut columns: Vec<_> =
            (0..INTRINSICS).filter(|&i| self.intrinsics[i] && !(tied && i == 1)).map(unit).collect();
        if tied {
            columns[0][1] = model.fy / model.fx;
        }
        columns
    }
}

/// A camera of the problem.
#[derive(Debug, Clone, PartialEq)]
pub struct BundleCamera {
    /// Intrinsics.
    pub model: CameraModel,
    /// Pose in the rig.
    pub camera_from_rig: Transform<Camera, World>,
    /// How much later than its stamps say its frames were exposed, s.
    pub later_s: f64,
    /// What may change.
    pub freedom: Freedom,
}

impl BundleCamera {
    /// A camera whose clock is right.
    pub const fn new(
        model: CameraModel,
        camera_from_rig: Transform<Camera, World>,
        freedom: Freedom,
    ) -> Self {
        Self { model, camera_from_rig, later_s: 0.0, freedom }
    }
}

/// What one camera saw of one block.
#[derive(Debug, Clone, PartialEq)]
pub struct Sighting {
    /// Index of the camera.
    pub camera: usize,
    /// Index of the block.
    pub block: usize,
    /// Points in the block's own frame, in metres.
    pub object: Vec<Vector3<f64>>,
    /// Their raw pixels.
    pub pixels: Vec<Vector2<f64>>,
    /// How the pixels move: of all points, or none where that is not known.
    pub motion: Vec<PixelMotion>,
    /// How much later than the block's instant it was, s, by the camera's stamps.
    pub after_s: f64,
}

impl Sighting {
    /// Of something that does not move, or at the very instant.
    pub const fn new(
        camera: usize,
        block: usize,
        object: Vec<Vector3<f64>>,
        pixels: Vec<Vector2<f64>>,
    ) -> Self {
        Self { camera, block, object, pixels, motion: Vec::new(), after_s: 0.0 }
    }

    /// Point `i` as it was at the block's instant, when the camera's frames are exposed `later_s` after their
    /// stamps, and how that changes with `later_s`, px/s.
    fn pixel(&self, i: usize, later_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let ago_s = self.after_s + later_s;
        self.motion.get(i).map_or_else(
            || (self.pixels[i], Vector2::zeros()),
            |m| (m.before(&self.pixels[i], ago_s), m.acceleration * ago_s - m.velocity),
        )
    }
}

/// Cameras, blocks and sightings, to be solved together.
#[derive(Debug, Clone)]
pub struct Bundle<const D: usize, B> {
    /// Cameras; at least one should have a fixed pose, or the whole rig floats.
    pub cameras: Vec<BundleCamera>,
    /// Boards or points.
    pub blocks: Vec<B>,
    /// Who saw what.
    pub sightings: Vec<Sighting>,
}

/// How [`Bundle::solve`] works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveOptions {
    /// Loss of each point's residual.
    pub loss: Loss,
    /// Most Levenberg–Marquardt steps.
    pub max_steps: usize,
}

impl Default for SolveOptions {
    fn default() -> Self {
        Self { loss: Loss::Squares, max_steps: 200 }
    }
}

/// How a solution came about.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Σ ρ(|residual|²), in px².
    pub cost: f64,
    /// Accepted and rejected steps.
    pub steps: usize,
    /// Whether the last step no longer changed anything; else the limit of steps was reached.
    pub converged: bool,
    /// (JᵀWJ)⁻¹ of all camera unknowns with the blocks marginalised, for residuals of unit variance;
    /// `None` when some unknown is not determined by the sightings.
    pub inverse_information: Option<DMatrix<f64>>,
    /// Start of each camera's unknowns: its intrinsics' basis first, then 6 of its pose, then its clock.
    pub offsets: Vec<usize>,
}

struct Normal<const D: usize> {
    cost: f64,
    a: DMatrix<f64>,
    g: DVector<f64>,
    v: Vec<SMatrix<f64, D, D>>,
    gb: Vec<SVector<f64, D>>,
    /// Per sighting: camera unknowns × block unknowns.
    w: Vec<DMatrix<f64>>,
}

impl<const D: usize, B: Block<D>> Bundle<D, B> {
    /// Residual vectors (observed − predicted, px) of one sighting; `None` if a point has no image.
    pub fn residuals(&self, sighting: &Sighting) -> Option<Vec<Vector2<f64>>> {
        let camera = &self.cameras[sighting.camera];
        let block = &self.blocks[sighting.block];
        sighting
            .object
            .iter()
            .enumerate()
            .map(|(i, object)| {
                let (pixel, _) = sighting.pixel(i, camera.later_s);
                let at = &camera.camera_from_rig * Point::<World>::from(block.place(object));
                camera.model.project(&at).map(|p| pixel - p)
            })
            .collect()
    }

    /// Σ ρ over all sightings; `None` if a point has no image.
    pub fn cost(&self, loss: Loss) -> Option<f64> {
        self.sightings
            .iter()
            .map(|s| self.residuals(s).map(|r| r.iter().map(|r| loss.cost(r.norm_squared())).sum::<f64>()))
            .sum()
    }

    /// Number of 2D points.
    pub fn points(&self) -> usize {
        self.sightings.iter().map(|s| s.pixels.len()).sum()
    }

    /// Number of scalar unknowns.
    pub fn unknowns(&self) -> usize {
        self.layout().1 + D * self.blocks.len()
    }

    fn layout(&self) -> (Vec<usize>, usize) {
        let mut offsets = Vec::with_capacity(self.cameras.len());
        let mut total = 0;
        for camera in &self.cameras {
            offsets.push(total);
            total += camera.freedom.unknowns(camera.freedom.basis(&camera.model).len());
        }
        (offsets, total)
    }

    fn normal(
        &self,
        loss: Loss,
        bases: &[Vec<SVector<f64, INTRINSICS>>],
        offsets: &[usize],
        total: usize,
    ) -> Option<Normal<D>> {
        struct Part<const D: usize> {
            cost: f64,
            a: DMatrix<f64>,
            g: DVector<f64>,
            v: SMatrix<f64, D, D>,
            gb: SVector<f64, D>,
            w: DMatrix<f64>,
        }
        let part = |s: &Sighting| -> Option<Part<D>> {
            let camera = &self.cameras[s.camera];
            let basis = &bases[s.camera];
            let own = camera.freedom.unknowns(basis.len());
            let mut p = Part {
                cost: 0.0,
                a: DMatrix::zeros(own, own),
                g: DVector::zeros(own),
                v: SMatrix::zeros(),
                gb: SVector::zeros(),
                w: DMatrix::zeros(own, D),
            };
            let block = &self.blocks[s.block];
            let rotation = camera.camera_from_rig.rotation.matrix();
            // The rows of one point: at most 9 + 6 + 1 unknowns.
            let mut jc = SMatrix::<f64, 2, 16>::zeros();
            for (i, object) in s.object.iter().enumerate() {
                let (pixel, by_clock) = s.pixel(i, camera.later_s);
                let in_rig = block.place(object);
                let at = &camera.camera_from_rig * Point::<World>::from(in_rig);
                let projected = camera.model.project_with_jacobians(&at)?;
                let r = pixel - projected.pixel;
                p.cost += loss.cost(r.norm_squared());
                let weight = loss.weight(r.norm_squared());
                for (column, direction) in basis.iter().enumerate() {
                    jc.set_column(column, &(projected.by_intrinsics * direction));
                }
                if camera.freedom.pose {
                    let turned = rotation * in_rig;
                    let by_turn = -(projected.by_point * cross(&turned));
                    for k in 0..3 {
                        jc.set_column(basis.len() + k, &by_turn.column(k));
                        jc.set_column(basis.len() + 3 + k, &projected.by_point.column(k));
                    }
                }
                if camera.freedom.clock {
                    // What moves the observation one way moves the prediction the other way.
                    jc.set_column(own - 1, &-by_clock);
                }
                let jb = projected.by_point * rotation * block.jacobian(object);
                for i in 0..own {
                    let (ix, iy) = (weight * jc[(0, i)], weight * jc[(1, i)]);
                    for j in 0..=i {
                        p.a[(i, j)] += ix * jc[(0, j)] + iy * jc[(1, j)];
                    }
                    p.g[i] += ix * r.x + iy * r.y;
                    for j in 0..D {
                        p.w[(i, j)] += ix * jb[(0, j)] + iy * jb[(1, j)];
                    }
                }
                p.v += jb.transpose() * jb * weight;
                p.gb += jb.transpose() * r * weight;
            }
            p.a.fill_upper_triangle_with_lower_triangle();
            Some(p)
        };
        // Parts are added in order, so that the result does not depend on the number of cores.
        let parts: Vec<_> = if self.points() > 20_000 {
            self.sightings.par_iter().map(part).collect::<Option<_>>()?
        } else {
            self.sightings.iter().map(part).collect::<Option<_>>()?
        };
        let mut n = Normal {
            cost: 0.0,
            a: DMatrix::zeros(total, total),
            g: DVector::zeros(total),
            v: vec![SMatrix::zeros(); self.blocks.len()],
            gb: vec![SVector::zeros(); self.blocks.len()],
            w: Vec::with_capacity(parts.len()),
        };
        for (s, p) in self.sightings.iter().zip(parts) {
            let (at, own) = (offsets[s.camera], p.g.len());
            n.cost += p.cost;
            let mut a = n.a.view_mut((at, at), (own, own));
            a += &p.a;
            let mut g = n.g.rows_mut(at, own);
            g += &p.g;
            n.v[s.block] += p.v;
            n.gb[s.block] += p.gb;
            n.w.push(p.w);
        }
        Some(n)
    }

    /// The camera system with the blocks eliminated (Schur complement), its right-hand side, and the
    /// inverses of the damped block matrices; `None` when a block is not determined.
    fn schur(
        &self,
        n: &Normal<D>,
        by_block: &[Vec<usize>],
        offsets: &[usize],
        lambda: f64,
    ) -> Option<(DMatrix<f64>, DVector<f64>, Vec<SMatrix<f64, D, D>>)> {
        let mut s = n.a.clone();
        for i in 0..s.nrows() {
            s[(i, i)] += lambda * n.a[(i, i)];
        }
        let mut g = n.g.clone();
        let mut inverses = Vec::with_capacity(n.v.len());
        for (block, v) in n.v.iter().enumerate() {
            let mut damped = *v;
            for i in 0..D {
                damped[(i, i)] += lambda * v[(i, i)];
            }
            let inverse = nalgebra::Cholesky::new(damped)?.inverse();
            for &i in &by_block[block] {
                let (at_i, rows) = (offsets[self.sightings[i].camera], n.w[i].nrows());
                if rows == 0 {
                    continue;
                }
                let wv = &n.w[i] * inverse;
                let mut gi = g.rows_mut(at_i, rows);
                gi -= &wv * n.gb[block];
                for &j in &by_block[block] {
                    let (at_j, columns) = (offsets[self.sightings[j].camera], n.w[j].nrows());
                    let mut part = s.view_mut((at_i, at_j), (rows, columns));
                    part -= &wv * n.w[j].transpose();
                }
            }
            inverses.push(inverse);
        }
        Some((s, g, inverses))
    }

    /// Levenberg–Marquardt from the present state (Marquardt's diagonal scaling, Nielsen's update of
    /// the damping), the blocks eliminated in each step. Leaves the best state found; `None` when the
    /// start itself has points without an image.
    pub fn solve(&mut self, options: &SolveOptions) -> Option<Solution> {
        // The basis stays: a tied aspect ratio is that of the start.
        let bases: Vec<_> = self.cameras.iter().map(|c| c.freedom.basis(&c.model)).collect();
        let (offsets, total) = self.layout();
        let mut by_block = vec![Vec::new(); self.blocks.len()];
        for (i, s) in self.sightings.iter().enumerate() {
            by_block[s.block].push(i);
        }
        let mut normal = self.normal(options.loss, &bases, &offsets, total)?;
        let (mut lambda, mut grow) = (1e-4, 2.0);
        let (mut steps, mut converged) = (0, false);
        while steps < options.max_steps && !converged {
            steps += 1;
            let tried = self.step(&normal, &bases, &by_block, &offsets, lambda);
            let better = tried.and_then(|(next, relative)| {
                let cost = next.cost(options.loss)?;
                (cost <= normal.cost).then_some((next, relative, cost))
            });
            match better {
                Some((next, relative, cost)) => {
                    // Both still: no unknown moves by more than 1e-5 of its standard deviation (of
                    // unit residuals), and the cost has no digits left to lose.
                    converged =
                        relative < 1e-10 || (normal.cost - cost) <= 1e-15 * normal.cost && relative < 1e-6;
                    *self = next;
                    normal = self.normal(options.loss, &bases, &offsets, total)?;
                    lambda = (lambda * 0.1).max(1e-15);
                    grow = 2.0;
                }
                None => {
                    // At the very bottom rounding makes every step a hair worse.
                    converged = lambda > 1e12 || lambda > 1e-2 && self.flat(&normal, &by_block, &offsets);
                    lambda *= grow;
                    grow *= 2.0;
                }
            }
        }
        let inverse_information =
            self.schur(&normal, &by_block, &offsets, 0.0).and_then(|(s, _, _)| invert_scaled(&s));
        Some(Solution { cost: normal.cost, steps, converged, inverse_information, offsets })
    }

    /// Whether an undamped step promises less than rounding can show.
    fn flat(&self, normal: &Normal<D>, by_block: &[Vec<usize>], offsets: &[usize]) -> bool {
        let Some((s, g, inverses)) = self.schur(normal, by_block, offsets, 1e-9) else { return false };
        let cameras = s.cholesky().map(|c| c.solve(&g)).map_or(0.0, |x| x.dot(&g));
        let blocks: f64 = inverses.iter().zip(&normal.gb).map(|(v, g)| (g.transpose() * v * g)[0]).sum();
        cameras + blocks < 1e-11 * normal.cost
    }

    /// The state after one damped step, and the step's length in units of standard deviations.
    fn step(
        &self,
        normal: &Normal<D>,
        bases: &[Vec<SVector<f64, INTRINSICS>>],
        by_block: &[Vec<usize>],
        offsets: &[usize],
        lambda: f64,
    ) -> Option<(Self, f64)> {
        let (s, g, inverses) = self.schur(normal, by_block, offsets, lambda)?;
        let delta = if g.is_empty() { g.clone() } else { s.cholesky()?.solve(&g) };
        let mut next = self.clone();
        let mut gain = delta.dot(&normal.g);
        for (i, camera) in next.cameras.iter_mut().enumerate() {
            let (at, basis) = (offsets[i], &bases[i]);
            if !basis.is_empty() {
                let mut p = SVector::<f64, INTRINSICS>::from(camera.model.parameters());
                for (k, direction) in basis.iter().enumerate() {
                    p += direction * delta[at + k];
                }
                camera.model = camera.model.with_parameters(p.into()).ok()?;
            }
            if camera.freedom.pose {
                let at = at + basis.len();
                let turn = Rotation3::new(delta.fixed_rows::<3>(at).into_owned());
                let mut rotation = turn * camera.camera_from_rig.rotation;
                rotation.renormalize();
                let moved = camera.camera_from_rig.translation + delta.fixed_rows::<3>(at + 3);
                camera.camera_from_rig = Transform::new(rotation, moved);
            }
            if camera.freedom.clock {
                camera.later_s += delta[at + camera.freedom.unknowns(basis.len()) - 1];
            }
        }
        for (b, block) in next.blocks.iter_mut().enumerate() {
            let mut rhs = normal.gb[b];
            for &i in &by_block[b] {
                let w = &normal.w[i];
                let rows = delta.rows(offsets[self.sightings[i].camera], w.nrows());
                rhs -= SVector::<f64, D>::from_iterator((w.transpose() * rows).iter().copied());
            }
            let step = inverses[b] * rhs;
            gain += step.dot(&normal.gb[b]);
            *block = block.stepped(&step);
        }
        gain.is_finite().then_some((next, gain.max(0.0).sqrt()))
    }
}

/// The inverse of a symmetric positive matrix, scaled to a unit diagonal first, so that pixels and
/// metres do not hide a singular direction; `None` when a direction is undetermined.
fn invert_scaled(s: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = s.nrows();
    if (0..n).any(|i| s[(i, i)] <= 0.0) {
        return None;
    }
    let d = DVector::from_fn(n, |i, _| 1.0 / s[(i, i)].sqrt());
    let scaled = DMatrix::from_fn(n, n, |i, j| s[(i, j)] * d[i] * d[j]);
    let mut inverse = scaled.cholesky()?.inverse();
    if inverse.iter().any(|v| !v.is_finite()) || (0..n).any(|i| inverse[(i, i)] > 1e13) {
        return None;
    }
    for i in 0..n {
        for j in 0..n {
            inverse[(i, j)] *= d[i] * d[j];
        }
    }
    Some(inverse)
}

impl Solution {
    /// Covariance of camera `camera`'s nine intrinsics and six pose unknowns (rotation vector applied
    /// from the left, in rad; translation in m), given the variance of one residual coordinate in px².
    /// Fixed unknowns have zero rows.
    pub fn camera_covariance(
        &self,
        camera: usize,
        model: &CameraModel,
        freedom: &Freedom,
        variance_px2: f64,
    ) -> Option<SMatrix<f64, 15, 15>> {
        let inverse = self.inverse_information.as_ref()?;
        let basis = freedom.basis(model);
        let own = basis.len() + 6 * usize::from(freedom.pose);
        let mut to_full = DMatrix::<f64>::zeros(15, own);
        for (k, direction) in basis.iter().enumerate() {
            to_full.view_mut((0, k), (INTRINSICS, 1)).copy_from(direction);
        }
        if freedom.pose {
            to_full.view_mut((9, basis.len()), (6, 6)).fill_with_identity();
        }
        let at = self.offsets[camera];
        // The clock comes last, and is not among these.
        let part = inverse.view((at, at), (own, own));
        let full = &to_full * part * to_full.transpose() * variance_px2;
        Some(SMatrix::from_iterator(full.iter().copied()))
    }

    /// Standard deviation of the camera's clock, s, given the variance of one residual coordinate in px²; `None`
    /// where it was fixed or is not determined.
    pub fn clock_sd_s(&self, camera: usize, state: &BundleCamera, variance_px2: f64) -> Option<f64> {
        let own = state.freedom.unknowns(state.freedom.basis(&state.model).len());
        let place = self.offsets[camera] + own.checked_sub(1).filter(|_| state.freedom.clock)?;
        Some((self.inverse_information.as_ref()?[(place, place)] * variance_px2).max(0.0).sqrt())
    }
}
