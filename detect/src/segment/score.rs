use super::{measure::Measured, outline::Outline, size::BallSize};

/// Score from which on a candidate is taken for the ball in play, until other cameras know better.
pub const SCORE_THRESHOLD: f64 = 0.5;

/// Score below which a candidate is not worth a message's place.
pub const LEAST_SCORE: f64 = 0.1;

/// What the fit leaves unexplained, as a share of the change, at which a shape counts half.
const HALF_MISFIT: f32 = 0.26;

/// Signal, in standard deviations over all pixels, at which a candidate counts half.
const HALF_SIGNAL: f32 = 12.0;

/// Red of a ball as a share of that of a white surface beside it, at least: it reflects 0.75 or more of the red light
/// (orange; white 0.85), paper and paint at most 0.9, and the mean over a sphere's visible half is, in the light of a
/// room, seldom less than 0.7 of that over a wall.
const LEAST_RED: f32 = 0.58;

/// Weight of what lacks of that, as a logarithm: half as bright in red as the darkest of balls makes one in 250
/// of the odds (chosen, not fitted).
const DARK: f32 = 8.0;

/// How much a measured candidate looks like the ball in play, 0–1; `likeness` is its colour's, `ball` the size
/// of balls in its camera.
pub fn score(measured: &Measured, likeness: f32, ball: &BallSize) -> f64 {
    let shape = 1.0 / (1.0 + (measured.verdict.misfit / HALF_MISFIT).powi(4));
    let signal = {
        let s = (measured.verdict.signal / HALF_SIGNAL).powi(2);
        s / (1.0 + s)
    };
    // A ball in front of a player has a busy neighbourhood too: this alone condemns nothing.
    let alone = 1.0 - 0.6 * ((measured.verdict.clutter - 0.25) / 0.6).clamp(0.0, 1.0);
    let whole = 1.0 - 0.6 * ((measured.verdict.hidden - 0.1) / 0.5).clamp(0.0, 1.0);
    let diameter = 2.0 * measured.fit.sweep.radius;
    let size =
        ((diameter - 2.8) / 1.0).clamp(0.0, 1.0) * ((ball.most_px + 1.0 - diameter) / 10.0).clamp(0.0, 1.0);
    let colour = likeness.powf(0.8);
    let shadow = if is_shadow(measured) { 0.3 } else { 1.0 };
    let gone = if is_gone(measured) { 0.1 } else { 1.0 };
    f64::from(shape * signal * alone * whole * size * colour * shadow * gone)
}

/// How much a candidate in a frame that stands for itself looks like a ball, 0–1. Nothing moves there, so that the
/// outline must tell all: what the ball explains of it, whether it ends on all sides, and whether what is around is
/// quiet.
///
/// Balls, orange and white ones, reflect nearly all red light, and what is darker in red than [`LEAST_RED`] of the
/// surfaces beside it is none: the gap between two white things, a drawer, a shadow. (A ball whose colour was learnt
/// may be of any colour.)
///
/// The rest is a logistic regression (Cox 1958) on logarithms, each bounded to where it means something. Its weights are rounded
/// means of two fits to 1,400 candidates each in 23 pictures of play with a white ball; score ½ is where one false
/// candidate passed in eight of them. `diameter_px` are the smallest and the largest ball that was marked.
pub fn single_score(
    measured: &Measured,
    outline: &Outline,
    likeness: f32,
    diameter_px: Option<[f32; 2]>,
) -> f64 {
    let sweep = &measured.fit.sweep;
    let diameter = 2.0 * sweep.radius;
    let [_, _, quarter, half] = outline.steps;
    // A ball that covers each place for a part of the exposure only would have to be brighter than anything is.
    let level = measured.verdict.levels.iter().copied().fold(1.0, f32::max);
    let mut evidence = -18.5 - 2.55 * (1.0 - outline.explained).clamp(0.015, 2.0).ln()
        + 2.8 * quarter.clamp(-0.5, 0.8)
        - 4.4 * (half.clamp(0.0, 2.0) - 1.03).abs()
        - 0.87 * outline.busy.clamp(0.02, 3.0).ln()
        - 3.25 * (level / 300.0).clamp(1.0, 10.0).ln()
        - 1.5 * (sweep.length / diameter).clamp(0.5, 10.0).ln()
        + 1.9 * likeness.clamp(0.05, 1.0).ln()
        + 2.17 * measured.verdict.signal.clamp(5.0, 100.0).ln()
        + 4.7 * (diameter.clamp(4.0, 12.0) / 12.0).ln()
        - 7.6 * (diameter.clamp(40.0, 80.0) / 40.0).ln();
    if let (Some(red), None) = (outline.red, diameter_px) {
        evidence -= DARK * (LEAST_RED / red.max(0.01)).max(1.0).ln();
    }
    if let Some([least, most]) = diameter_px {
        // Balls come nearer and go farther than where a few were marked.
        let beyond = (least / diameter).max(diameter / most).max(1.0).ln();
        // Where its colour and size were learnt, fewer other things are candidates at all.
        evidence += 0.7 - 4.0 * (beyond / 1.3_f32.ln()).powi(2);
    }
    f64::from(1.0 / (1.0 + (-evidence).exp()))
}

/// Whether it darkens all colours alike, as a shadow does.
fn is_shadow(measured: &Measured) -> bool {
    let ratio = |i: usize| (measured.verdict.levels[i].max(0.0) + 1.0) / (measured.verdict.behind[i] + 1.0);
    let ratios = [ratio(0), ratio(1), ratio(2)];
    let (low, high) = ratios.iter().fold((f32::MAX, 0.0_f32), |(l, h), r| (l.min(*r), h.max(*r)));
    high < 0.9 && high / low < 1.15
}

/// Whether this is the place that something has left, and not the thing: what is seen goes on around it, and
/// it is the background that has an outline there.
pub fn is_gone(measured: &Measured) -> bool {
    let apart = |a: &[f32; 3], b: &[f32; 3]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>();
    apart(&measured.verdict.levels, &measured.verdict.around)
        < 0.3 * apart(&measured.verdict.levels, &measured.verdict.behind)
}
