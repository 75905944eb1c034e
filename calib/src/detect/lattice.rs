//! Chessboards without markers: candidates are linked along their edges into a lattice, which is then
//! completed, cut to the board's size and turned as the board's colours demand.

use std::{
    cell::OnceCell,
    collections::{BTreeMap, VecDeque},
};

use nalgebra::{SMatrix, SVector, Vector2};

use super::{
    Corner, Depth,
    chess::{Candidate, MOST, candidates, is_corner, turn},
    fiducial::fit_radius,
    luma::Luma,
    neighbours::{MISFIT_SIGMAS, drop_misfits},
    saddle::{Saddle, SaddleFit},
};

/// A picture, and what its completion takes, computed when it is first asked for.
struct Searched<'a> {
    image: &'a Luma,
    smooth: OnceCell<(Luma, f64)>,
}

impl<'a> Searched<'a> {
    const fn new(image: &'a Luma) -> Self {
        Self { image, smooth: OnceCell::new() }
    }

    /// The picture smoothed twice, and the noise that is left in it.
    fn smooth(&self) -> &(Luma, f64) {
        self.smooth.get_or_init(|| (self.image.binomial().binomial(), 0.27 * self.image.noise()))
    }
}

type Cell = (i32, i32);
type Lattice = BTreeMap<Cell, Saddle>;

/// Steps of the four directions of a lattice, in the order of growing angle (x right, y down).
const STEPS: [Cell; 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];
/// Smallest lattice that is a board.
const LEAST: usize = 6;

/// What was found of a chessboard.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chessboard {
    pub corners: Vec<Corner>,
    /// Whether the corners' numbers are sure: all rows and columns seen, or those missing cut off by the
    /// picture's frame on a known side.
    pub anchored: bool,
}

/// Most lattices of one picture that are looked into.
const MOST_LATTICES: usize = 3;

/// The chessboard with `columns` × `rows` inner corners. Of several, the one with the most corners wins,
/// and of those alike the largest in the picture (not the board's image on a screen behind it).
pub(super) fn find(image: &Luma, columns: usize, rows: usize, depth: Depth) -> Option<Chessboard> {
    let weight = |b: &Chessboard| weight(b.corners.iter().map(|c| c.at));
    let searched = Searched::new(image);
    let placed: Vec<Placed> = lattices(&searched, depth, columns.max(rows))
        .into_iter()
        .filter_map(|l| place(&searched, l, columns, rows))
        .collect();
    // A part of a larger board may pass for this one when the larger one was not found whole.
    let larger = placed.iter().map(|p| if let Placed::Larger(n) = p { *n } else { 0 }).max().unwrap_or(0);
    let boards = placed.into_iter().filter_map(|p| if let Placed::Board(b) = p { Some(b) } else { None });
    boards.max_by(|a, b| weight(a).total_cmp(&weight(b))).filter(|b| b.corners.len() > larger)
}

/// What a lattice is.
enum Placed {
    /// The board, or a part of it.
    Board(Chessboard),
    /// A larger board, with so many corners where this one would be.
    Larger(usize),
}

/// Columns and rows of the largest lattice of corners in the picture, the longer side first.
pub(super) fn seen(image: &Luma) -> Option<(usize, usize)> {
    let lattice =
        lattices(&Searched::new(image), Depth::Final, usize::MAX).into_iter().max_by_key(Lattice::len)?;
    let extent = |axis: fn(&Cell) -> i32| -> Option<usize> {
        Some((lattice.keys().map(axis).max()? - lattice.keys().map(axis).min()? + 1) as usize)
    };
    let (x, y) = (extent(|c| c.0)?, extent(|c| c.1)?);
    Some((x.max(y), x.min(y)))
}

/// What a lattice counts for: the square of its number of corners, times its extent in the picture.
fn weight(corners: impl Iterator<Item = Vector2<f64>> + Clone) -> f64 {
    let count = corners.clone().count() as f64;
    let mean = corners.clone().sum::<Vector2<f64>>() / count.max(1.0);
    let spread = corners.map(|c| (c - mean).norm_squared()).sum::<f64>() / count.max(1.0);
    count * count * spread.sqrt()
}

fn heaviest(mut lattices: Vec<Lattice>) -> Vec<Lattice> {
    let weight = |l: &Lattice| weight(l.values().map(|s| s.at));
    lattices.sort_by(|a, b| weight(b).total_cmp(&weight(a)));
    lattices.truncate(MOST_LATTICES);
    lattices
}

/// The lattices in the picture; completed to no more than `longest` corners along one side.
fn lattices(searched: &Searched<'_>, depth: Depth, longest: usize) -> Vec<Lattice> {
    let image = searched.image;
    let half = (image.width() > 1000).then(|| image.halved()).flatten();
    let mut found = Vec::new();
    if let Some(half) = &half {
        let up = |mut l: Lattice| {
            for s in l.values_mut() {
                s.at = s.at * 2.0 + Vector2::repeat(0.5);
            }
            l
        };
        let most = if depth == Depth::Guiding { 900 } else { MOST };
        let grown = grow(half, &candidates(half, most));
        let half = Searched::new(half);
        let fine = grown.into_iter().map(|l| refined(image, up(complete(&half, l, longest))));
        found.extend(fine.map(|l| if depth == Depth::Final { complete(searched, l, longest) } else { l }));
    }
    if half.is_none() || depth == Depth::Final {
        let most = if depth == Depth::Guiding { 1200 } else { MOST };
        let grown = grow(image, &candidates(image, most));
        found.extend(grown.into_iter().map(|l| complete(searched, refined(image, l), longest)));
    }
    found.retain(|l| l.len() >= LEAST);
    found
}

/// Links candidates and walks the links from the strongest on, into lattices.
fn grow(image: &Luma, nodes: &[Candidate]) -> Vec<Lattice> {
    let links = link(image, nodes);
    let mut used = vec![false; nodes.len()];
    let mut grown: Vec<Lattice> = Vec::new();
    for seed in 0..nodes.len() {
        if used[seed] || links[seed].iter().flatten().count() < 2 {
            continue;
        }
        let mut cells: BTreeMap<Cell, usize> = BTreeMap::new();
        // Each node's slot that points along +x.
        let mut state: BTreeMap<usize, (Cell, usize)> = BTreeMap::new();
        let mut queue = VecDeque::from([seed]);
        cells.insert((0, 0), seed);
        state.insert(seed, ((0, 0), 0));
        used[seed] = true;
        while let Some(a) = queue.pop_front() {
            let (cell, along_x) = state[&a];
            for (slot, other) in links[a].iter().enumerate() {
                let Some((b, back)) = *other else { continue };
                let direction = (slot + 4 - along_x) % 4;
                let step = STEPS[direction];
                let next = (cell.0 + step.0, cell.1 + step.1);
                if cells.contains_key(&next) || state.contains_key(&b) {
                    continue;
                }
                // At b, the slot opposite to the way back goes on in the same direction.
                state.insert(b, (next, (back + 2 + 4 - direction) % 4));
                cells.insert(next, b);
                used[b] = true;
                queue.push_back(b);
            }
        }
        if cells.len() >= LEAST {
            let saddle = |n: usize| {
                let c = &nodes[n];
                // Bright lies between a rising edge and the falling one after it.
                let k = if c.rising[0] { 0 } else { 1 };
                let bright = c.edges[k] + 0.5 * (c.edges[k + 1] - c.edges[k]);
                Saddle { at: c.at, strength: c.strength, bright }
            };
            grown.push(cells.into_iter().map(|(cell, n)| (cell, saddle(n))).collect());
        }
    }
    let mut grown: Vec<Lattice> = heaviest(grown).into_iter().map(without_misfits).collect();
    grown.retain(|l| l.len() >= LEAST);
    grown
}

/// For each candidate's four edges the candidate at the edge's other end, and that one's edge back.
fn link(image: &Luma, nodes: &[Candidate]) -> Vec<[Option<(usize, usize)>; 4]> {
    /// Furthest that an edge may turn between two corners, in radians.
    const BEND: f64 = 0.35;
    const CELL: f64 = 32.0;
    /// How much longer the next edge may be than the last: perspective changes it by less.
    const STRETCH: f64 = 1.6;
    let (gw, gh) = ((image.width() as f64 / CELL) as usize + 1, (image.height() as f64 / CELL) as usize + 1);
    let mut grid = vec![Vec::new(); gw * gh];
    let bucket = |p: &Vector2<f64>| ((p.x / CELL) as usize, (p.y / CELL) as usize);
    for (i, n) in nodes.iter().enumerate() {
        let (x, y) = bucket(&n.at);
        grid[y * gw + x].push(i);
    }
    let nearest = |a: usize| -> [Option<(usize, usize)>; 4] {
        let from = &nodes[a];
        let mut best: [Option<(f64, usize, usize)>; 4] = [None; 4];
        let (bx, by) = bucket(&from.at);
        for ring in 0..gw.max(gh) {
            // Everything in this ring of buckets is at least this far away.
            let least = (ring as f64 - 1.0) * CELL;
            if best.iter().all(|b| b.is_some_and(|b| b.0 < least)) || ring > 9 {
                break;
            }
            let (x0, x1) = (bx as isize - ring as isize, bx as isize + ring as isize);
            let (y0, y1) = (by as isize - ring as isize, by as isize + ring as isize);
            for y in y0.max(0)..=y1.min(gh as isize - 1) {
                for x in x0.max(0)..=x1.min(gw as isize - 1) {
                    if y != y0 && y != y1 && x != x0 && x != x1 {
                        continue;
                    }
                    for &b in &grid[y as usize * gw + x as usize] {
                        let way = nodes[b].at - from.at;
                        let distance = way.norm();
                        if b == a || distance < 4.0 {
                            continue;
                        }
                        let angle = way.y.atan2(way.x);
                        for slot in 0..4 {
                            let off = turn(from.edges[slot], angle).abs();
                            // Along a bent way a corner counts as further off.
                            let score = distance * (1.0 + 2.0 * off);
                            if off > BEND || best[slot].is_some_and(|s| s.0 <= score) {
                                continue;
                            }
                            // The same edge, seen from its other end, brightens the other way round.
                            let back = (0..4).find(|k| {
                                nodes[b].rising[*k] != from.rising[slot]
                                    && turn(nodes[b].edges[*k], angle + std::f64::consts::PI).abs() < BEND
                            });
                            if let Some(back) = back {
                                best[slot] = Some((score, b, back));
                            }
                        }
                    }
                }
            }
        }
        best.map(|b| b.map(|(_, b, back)| (b, back)))
    };
    let one_way: Vec<_> = (0..nodes.len()).map(nearest).collect();
    // A link counts when both ends see each other…
    let mutual: Vec<[Option<(usize, usize)>; 4]> = (0..nodes.len())
        .map(|a| {
            let mut slots = one_way[a];
            for (slot, link) in slots.iter_mut().enumerate() {
                *link = link.filter(|(b, back)| one_way[*b][*back] == Some((a, slot)));
            }
            slots
        })
        .collect();
    // …and is not much longer than the one straight on: that would lead to something else's corner.
    let length =
        |a: usize, link: Option<(usize, usize)>| link.map(|(b, _)| (nodes[b].at - nodes[a].at).norm());
    let longer = |a: usize, slot: usize| -> bool {
        let straight_on = length(a, mutual[a][(slot + 2) % 4]);
        length(a, mutual[a][slot]).zip(straight_on).is_some_and(|(one, other)| one > STRETCH * other)
    };
    (0..nodes.len())
        .map(|a| {
            let mut slots = mutual[a];
            for (slot, link) in slots.iter_mut().enumerate() {
                *link = link.filter(|&(b, back)| !longer(a, slot) && !longer(b, back));
            }
            slots
        })
        .collect()
}

/// Cells of the lattice within two steps of `cell`, without it, the nearest first.
fn around(lattice: &Lattice, cell: Cell) -> Vec<(Cell, Saddle)> {
    let mut near: Vec<(i32, Cell, Saddle)> = Vec::new();
    for y in cell.1 - 3..=cell.1 + 3 {
        for x in cell.0 - 3..=cell.0 + 3 {
            let d = (x - cell.0).pow(2) + (y - cell.1).pow(2);
            if d > 0
                && let Some(s) = lattice.get(&(x, y))
            {
                near.push((d, (x, y), *s));
            }
        }
    }
    near.sort_by_key(|(d, c, _)| (*d, *c));
    near.truncate(10);
    near.into_iter().map(|(_, c, s)| (c, s)).collect()
}

/// Where the cells around put a corner, and how far its neighbours lie there.
fn forecast(lattice: &Lattice, cell: Cell) -> Option<(Vector2<f64>, f64)> {
    let near = around(lattice, cell);
    if near.len() < 5 {
        return None;
    }
    // Homography (x, y, 1) → (a b c; d e f; g h 1) by linear least squares; the cell itself is the origin,
    // so that its image is (c, f), and the corners around keep the numbers small.
    let shift = near[0].1.at;
    let (mut normal, mut rhs) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
    for (c, saddle) in &near {
        let (x, y) = (f64::from(c.0 - cell.0), f64::from(c.1 - cell.1));
        let p = (saddle.at - shift) / 64.0;
        for (row, value) in [
            (SVector::<f64, 8>::from([x, y, 1.0, 0.0, 0.0, 0.0, -x * p.x, -y * p.x]), p.x),
            (SVector::<f64, 8>::from([0.0, 0.0, 0.0, x, y, 1.0, -x * p.y, -y * p.y]), p.y),
        ] {
            normal += row * row.transpose();
            rhs += row * value;
        }
    }
    let q = normal.cholesky()?.solve(&rhs);
    let image = |x: f64, y: f64| {
        Vector2::new(q[0] * x + q[1] * y + q[2], q[3] * x + q[4] * y + q[5]) / (q[6] * x + q[7] * y + 1.0)
            * 64.0
            + shift
    };
    let at = image(0.0, 0.0);
    let spacing = STEPS
        .iter()
        .map(|s| (image(f64::from(s.0), f64::from(s.1)) - at).norm())
        .fold(f64::INFINITY, f64::min);
    (at.x.is_finite() && at.y.is_finite() && spacing.is_finite()).then_some((at, spacing))
}

/// Without corners that lie a quarter of the spacing off where those around put them.
fn without_misfits(mut lattice: Lattice) -> Lattice {
    loop {
        let worst = lattice
            .iter()
            .filter_map(|(cell, s)| {
                let (at, spacing) = forecast(&lattice, *cell)?;
                Some((*cell, (at - s.at).norm() / (0.25 * spacing)))
            })
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match worst {
            Some((cell, off)) if off > 1.0 => lattice.remove(&cell),
            _ => return lattice,
        };
    }
}

fn spacing_at(lattice: &Lattice, cell: Cell) -> Option<f64> {
    let here = lattice.get(&cell)?.at;
    let near = STEPS.iter().filter_map(|s| lattice.get(&(cell.0 + s.0, cell.1 + s.1)));
    Some(near.map(|s| (s.at - here).norm()).fold(f64::INFINITY, f64::min)).filter(|d| d.is_finite())
}

/// All corners fitted on `image`, with a radius after their spacing; those that are no saddle are dropped.
fn refined(image: &Luma, lattice: Lattice) -> Lattice {
    let mut out = Lattice::new();
    for (cell, saddle) in &lattice {
        let Some(spacing) = spacing_at(&lattice, *cell) else { continue };
        let fit = SaddleFit::new(fit_radius(spacing));
        if let Some(fine) = fit.refine(image, saddle.at, (0.25 * spacing).max(1.5))
            && same_axis(fine.bright, saddle.bright)
        {
            out.insert(*cell, fine);
        }
    }
    out
}

fn same_axis(a: f64, b: f64) -> bool {
    let off = (a - b).rem_euclid(std::f64::consts::PI);
    off.min(std::f64::consts::PI - off) < 35f64.to_radians()
}

/// Adds corners beside those found, foretold from them, as long as there are saddles of about the same
/// strength and of the right colours, and each side is no longer than `longest`.
fn complete(searched: &Searched<'_>, mut lattice: Lattice, longest: usize) -> Lattice {
    lattice = without_misfits(lattice);
    loop {
        let mut added = Vec::new();
        let mut open: Vec<Cell> = lattice
            .keys()
            .flat_map(|c| STEPS.iter().map(move |s| (c.0 + s.0, c.1 + s.1)))
            .filter(|c| !lattice.contains_key(c))
            .collect();
        open.sort_unstable();
        open.dedup();
        // No further than any board reaches: beyond lies texture.
        let fits = |pick: fn(&Cell) -> i32, cell: &Cell| -> bool {
            let (low, high) =
                lattice.keys().map(pick).fold((i32::MAX, i32::MIN), |(l, h), v| (l.min(v), h.max(v)));
            let grown = high.max(pick(cell)) - low.min(pick(cell)) + 1;
            grown == high - low + 1 || grown as usize <= longest
        };
        open.retain(|c| fits(|c| c.0, c) && fits(|c| c.1, c));
        for cell in open {
            let Some((at, spacing)) = forecast(&lattice, cell) else { continue };
            let near = around(&lattice, cell);
            let Some(saddle) = SaddleFit::new(fit_radius(spacing)).refine(searched.image, at, 0.3 * spacing)
            else {
                continue;
            };
            let strength =
                near.iter().take(4).map(|(_, s)| s.strength).sum::<f64>() / near.len().min(4) as f64;
            // Neighbours have their bright squares across; the nearest is one step away.
            let (beside, reference) = near[0];
            let odd = (beside.0 - cell.0 + beside.1 - cell.1).rem_euclid(2) == 1;
            let expected = reference.bright + if odd { std::f64::consts::FRAC_PI_2 } else { 0.0 };
            let four_sectors = || {
                let (smooth, noise) = searched.smooth();
                is_corner(smooth, saddle.at, (0.3 * spacing).clamp(2.8, 7.0), *noise)
            };
            if saddle.strength > 0.4 * strength && same_axis(saddle.bright, expected) && four_sectors() {
                added.push((cell, saddle));
            }
        }
        if added.is_empty() {
            return lattice;
        }
        lattice.extend(added);
    }
}

/// Cuts the lattice to the board and numbers its corners.
fn place(searched: &Searched<'_>, lattice: Lattice, columns: usize, rows: usize) -> Option<Placed> {
    let image = searched.image;
    let (x0, x1) = (lattice.keys().map(|c| c.0).min()?, lattice.keys().map(|c| c.0).max()?);
    let (y0, y1) = (lattice.keys().map(|c| c.1).min()?, lattice.keys().map(|c| c.1).max()?);
    let mut strengths: Vec<f64> = lattice.values().map(|s| s.strength).collect();
    strengths.sort_by(f64::total_cmp);
    let usual = strengths[strengths.len() / 2];
    // Score, heading, window's origin, quarter turns (the board's x is direction `turns` of the lattice).
    let mut best: Option<(f64, f64, Cell, usize, bool)> = None;
    for turns in 0..4 {
        let (w, h) =
            if turns % 2 == 0 { (columns as i32, rows as i32) } else { (rows as i32, columns as i32) };
        let (xs, x_sure) = offsets(image, &lattice, (x0, x1), w, true);
        let (ys, y_sure) = offsets(image, &lattice, (y0, y1), h, false);
        for &ox in &xs {
            for &oy in &ys {
                let inside: Vec<(Cell, &Saddle)> = lattice
                    .iter()
                    .filter(|(c, _)| (ox..ox + w).contains(&c.0) && (oy..oy + h).contains(&c.1))
                    .map(|(c, s)| (*c, s))
                    .collect();
                if inside.is_empty() || !colours_fit(&lattice, &inside, (ox, oy), (w, h), turns) {
                    continue;
                }
                // Corners of texture beside the board are mostly weaker than the board's own.
                let score: f64 = inside.iter().map(|(_, s)| (s.strength / usual).min(1.0)).sum();
                // Among turns that fit alike, the one whose x points most to the picture's right.
                let right = heading(&lattice, turns);
                let better = best.is_none_or(|b| score > b.0 + 1e-9 || score > b.0 - 1e-9 && right > b.1);
                if better {
                    best = Some((score, right, (ox, oy), turns, x_sure && y_sure));
                }
            }
        }
    }
    let (_, _, origin, turns, anchored) = best?;
    let (w, h) = if turns % 2 == 0 { (columns as i32, rows as i32) } else { (rows as i32, columns as i32) };
    if goes_on(&lattice, origin, (w, h), usual) {
        return Some(Placed::Larger(lattice.len().min(columns * rows)));
    }
    let points: Vec<_> = (0..columns * rows)
        .map(|i| nalgebra::Vector3::new((i % columns) as f64, (i / columns) as f64, 0.0))
        .collect();
    let id_of = |c: &Cell| -> Option<usize> {
        let (x, y) = (c.0 - origin.0, c.1 - origin.1);
        ((0..w).contains(&x) && (0..h).contains(&y)).then(|| {
            let (column, row) = on_board((x, y), (w, h), turns);
            row as usize * columns + column as usize
        })
    };
    // What lies off goes, what is missing is looked for once more, without the texture around the board.
    let mut board: Lattice = lattice.into_iter().filter(|(c, _)| id_of(c).is_some()).collect();
    let mut corners = Vec::new();
    for _ in 0..2 {
        let cells: BTreeMap<usize, Cell> = board.keys().filter_map(|c| id_of(c).map(|id| (id, *c))).collect();
        corners = cells.iter().map(|(id, c)| Corner { id: *id, at: board[c].at }).collect();
        drop_misfits(&mut corners, &points, 1.0, MISFIT_SIGMAS);
        let before = corners.len();
        board = corners.iter().map(|c| (cells[&c.id], board[&cells[&c.id]])).collect();
        board = complete(searched, board, columns.max(rows))
            .into_iter()
            .filter(|(c, _)| id_of(c).is_some())
            .collect();
        if board.len() == before {
            break;
        }
    }
    (corners.len() >= LEAST).then_some(Placed::Board(Chessboard { corners, anchored }))
}

/// Whether a whole further line of corners, as strong as the others, lies along one side of the window of
/// `w` × `h` at `origin`: then this is a larger board.
fn goes_on(lattice: &Lattice, origin: Cell, (w, h): (i32, i32), usual: f64) -> bool {
    let strong = |cell: Cell| lattice.get(&cell).is_some_and(|s| s.strength > 0.6 * usual);
    let line = |along_x: bool, at: i32| {
        let (start, size) = if along_x { (origin.0, w) } else { (origin.1, h) };
        let found = (start..start + size).filter(|i| strong(if along_x { (*i, at) } else { (at, *i) }));
        found.count() as f64 >= 0.8 * f64::from(size)
    };
    line(true, origin.1 - 1)
        || line(true, origin.1 + h)
        || line(false, origin.0 - 1)
        || line(false, origin.0 + w)
}

/// Column and row on the board of a cell of the window of `w` × `h`, the board's x being direction
/// `turns` of the lattice.
fn on_board((x, y): Cell, (w, h): (i32, i32), turns: usize) -> Cell {
    match turns {
        0 => (x, y),
        1 => (y, w - 1 - x),
        2 => (w - 1 - x, h - 1 - y),
        _ => (h - 1 - y, x),
    }
}

/// Where along one axis the board's window may begin, and whether that is sure. Seen as much or more: every
/// window inside. Seen less: when the lattice's end on one side lies inside the picture and on the other at
/// its frame, the missing columns were cut off there; else any.
fn offsets(
    image: &Luma,
    lattice: &Lattice,
    (low, high): (i32, i32),
    size: i32,
    along_x: bool,
) -> (Vec<i32>, bool) {
    let seen = high - low + 1;
    if seen >= size {
        return ((low..=high - size + 1).collect(), true);
    }
    let cut = |line: i32| -> bool {
        let cells: Vec<Cell> =
            lattice.keys().map(|c| if along_x { (line, c.1) } else { (c.0, line) }).collect();
        let (mut outside, mut known) = (0, 0);
        for cell in cells {
            let Some((at, spacing)) = forecast(lattice, cell) else { continue };
            known += 1;
            let margin = 0.35 * spacing;
            let inside = at.x > margin
                && at.y > margin
                && at.x < image.width() as f64 - margin
                && at.y < image.height() as f64 - margin;
            outside += u32::from(!inside);
        }
        outside * 2 > known
    };
    match (cut(low - 1), cut(high + 1)) {
        (true, false) => (vec![high - size + 1], true),
        (false, true) => (vec![low], true),
        _ => ((high - size + 1..=low).collect(), false),
    }
}

/// Whether the square at the board's first corner is black, by the vote of all corners: the squares along
/// the board's diagonal are black at corners whose column and row add up to an even number.
fn colours_fit(
    lattice: &Lattice,
    inside: &[(Cell, &Saddle)],
    origin: Cell,
    size: (i32, i32),
    turns: usize,
) -> bool {
    let mut votes = 0i32;
    for (cell, saddle) in inside {
        let at = |step: Cell, sign: i32| {
            lattice.get(&(cell.0 + sign * step.0, cell.1 + sign * step.1)).map(|s| s.at)
        };
        let axis = |step: Cell| -> Option<Vector2<f64>> {
            at(step, 1).map(|p| p - saddle.at).or_else(|| at(step, -1).map(|p| saddle.at - p))
        };
        let (Some(x), Some(y)) = (axis(STEPS[turns]), axis(STEPS[(turns + 1) % 4])) else { continue };
        let diagonal = x.normalize() + y.normalize();
        let bright_along = same_axis_nearer(saddle.bright, diagonal, x.normalize() - y.normalize());
        let (column, row) = on_board((cell.0 - origin.0, cell.1 - origin.1), size, turns);
        let black_expected = (column + row) % 2 == 0;
        votes += if bright_along == black_expected { -1 } else { 1 };
    }
    votes > 0
}

/// Whether `angle` is nearer to the axis `a` than to the axis `b`.
fn same_axis_nearer(angle: f64, a: Vector2<f64>, b: Vector2<f64>) -> bool {
    let direction = Vector2::new(angle.cos(), angle.sin());
    (direction.dot(&a) / a.norm()).abs() > (direction.dot(&b) / b.norm()).abs()
}

/// How much direction `turns` of the lattice points to the picture's right, −1 … 1.
fn heading(lattice: &Lattice, turns: usize) -> f64 {
    let step = STEPS[turns];
    let ways =
        lattice.iter().filter_map(|(c, s)| lattice.get(&(c.0 + step.0, c.1 + step.1)).map(|n| n.at - s.at));
    ways.sum::<Vector2<f64>>().try_normalize(0.0).map_or(0.0, |d| d.x)
}
