//! Cuts a cloud of colours out of all others by a few planes.
//!
//! Greedy set cover: of many directions, spread evenly over the sphere in the ball's whitened colours, the plane is
//! taken that leaves out most of what the planes before it let through, while it loses only a small share of the
//! ball's cells. What results is convex, needs a few multiplications a cell, and goes through the very kernel that
//! tests the colours that are told beforehand.

use nalgebra::{Matrix3, Vector3};
use netcord_common::rig::{ColourTest, MAX_COLOUR_TESTS};

/// Directions that are tried. Neighbours are about 9° apart.
const DIRECTIONS: usize = 500;
/// Share of the ball's cells that one plane may lose.
const LOSS: f64 = 0.006;
/// Share of what is left that a plane must leave out to be worth it.
const LEAST_GAIN: f64 = 0.02;
/// Variance that a colour has at least in each channel, DN².
const LEAST_VARIANCE: f64 = 2.0;

/// Half-spaces whose intersection holds the ball's colours.
#[derive(Debug, Clone, PartialEq)]
pub struct Polytope {
    /// Tests whose weights have the unit of the ball's spread: moving a bound by one moves the plane by one standard
    /// deviation of the ball's colours.
    pub tests: Vec<ColourTest>,
}

impl Polytope {
    /// Cuts `ball` out of `other`; where `grey`, by brightness alone. `ball` is not empty.
    pub fn fit(ball: &[[f64; 3]], other: &[[f64; 3]], grey: bool) -> Self {
        let n = ball.len() as f64;
        let mean = ball.iter().map(|c| Vector3::from(*c)).sum::<Vector3<f64>>() / n;
        let mut covariance = Matrix3::identity() * LEAST_VARIANCE;
        for colour in ball {
            let d = Vector3::from(*colour) - mean;
            covariance += d * d.transpose() / n;
        }
        let directions = if grey {
            let spread = covariance[(0, 0)].sqrt();
            [-1.0, 1.0].map(|sign| Vector3::repeat(sign / (3.0 * spread))).to_vec()
        } else {
            // w·x has variance wᵀ C w = 1 for w = L⁻ᵀ d, where C = L Lᵀ. With the least variance in it C is positive
            // definite; for colours that are no numbers any directions will do.
            let factor = covariance.cholesky().map_or_else(Matrix3::identity, |c| c.l());
            let inverse = factor.transpose().try_inverse().unwrap_or_else(Matrix3::identity);
            sphere(DIRECTIONS).map(|d| inverse * d).collect()
        };
        let mut left = other.to_vec();
        let mut tests = Vec::new();
        let mut levels = Vec::with_capacity(ball.len());
        while tests.len() < MAX_COLOUR_TESTS && !left.is_empty() {
            let mut best: Option<(usize, ColourTest)> = None;
            for direction in &directions {
                let weights: [f64; 3] = (*direction).into();
                levels.clear();
                levels.extend(ball.iter().map(|c| dot(&weights, c)));
                let lost = ((LOSS * n) as usize).min(ball.len() - 1);
                // Just below the cells that it may lose.
                let bound = *levels.select_nth_unstable_by(lost, f64::total_cmp).1 - 1e-9;
                let removed = left.iter().filter(|c| dot(&weights, c) <= bound).count();
                if best.as_ref().is_none_or(|(most, _)| removed > *most) {
                    best = Some((removed, ColourTest { weights, bound }));
                }
            }
            let Some((removed, test)) = best else { break };
            if (removed as f64) < LEAST_GAIN * left.len() as f64 {
                break;
            }
            left.retain(|c| dot(&test.weights, c) > test.bound);
            tests.push(test);
        }
        if tests.is_empty() {
            // Nothing to be told apart: what is as bright as the ball.
            let weights = [1.0 / 3.0; 3];
            let bound = ball.iter().map(|c| dot(&weights, c)).fold(f64::INFINITY, f64::min) - 1e-9;
            tests.push(ColourTest { weights, bound });
        }
        Self { tests }
    }

    /// By how much a colour is inside all half-spaces: the least distance to a plane, in standard deviations of the
    /// ball's colours; below zero outside.
    pub fn depth(&self, colour: &[f64; 3]) -> f64 {
        self.tests.iter().map(|t| dot(&t.weights, colour) - t.bound).fold(f64::INFINITY, f64::min)
    }

    /// The same with all planes moved outwards by `margin` standard deviations, and bounds and weights in levels of
    /// the mosaic: the largest weight is one.
    pub fn tests(&self, margin: f64) -> Vec<ColourTest> {
        let scaled = |t: &ColourTest| {
            let largest = t.weights.iter().fold(0.0_f64, |most, w| most.max(w.abs())).max(1e-12);
            ColourTest { weights: t.weights.map(|w| w / largest), bound: (t.bound - margin) / largest }
        };
        self.tests.iter().map(scaled).collect()
    }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Points spread evenly over the unit sphere, by the golden angle (Vogel 1979).
fn sphere(n: usize) -> impl Iterator<Item = Vector3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..n).map(move |i| {
        let z = 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        let across = (1.0 - z * z).sqrt();
        Vector3::new(across * cos, across * sin, z)
    })
}
