//! Two near markers measured together in one frame: which of a camera's dots is the one's, the other's, or both in one.
//!
//! The unknowns are both places; what is known before is where the pair is, roughly, and the vector between them. Camera
//! by camera each way to explain the dots is a hypothesis with a Kalman update of its own (Kalman 1960); a few of the
//! likeliest are kept (beam search), and the likeliest of all cameras together is the answer. A dot of both is where the
//! middle of their images is.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Matrix6, SMatrix, Vector2, Vector3, Vector6};

/// Hypotheses that are kept from one camera to the next.
const BEAM: usize = 6;
/// A dot farther off than this is no explanation (standard deviations, squared).
const GATE: f64 = 25.0;
/// The middle of a blob is off the middle of two markers by this part of their distance in the image.
const BLOB: f64 = 0.1;
/// The distance at which two dots become one differs by this part of it.
const SOFT: f64 = 0.15;
/// However far apart or near, two are one dot with a probability within these bounds.
const MERGED: [f64; 2] = [1e-4, 0.95];
/// How likely it is that a camera sees both, the one, the other, neither; and that what it sees in a frame is drawn
/// from that anew.
const USUAL: [f64; 4] = [0.6, 0.1, 0.1, 0.2];
const ANEW: f64 = 0.15;

/// What a camera sees of the pair, by chance: both, the one, the other, neither.
pub type Seen = [f64; 4];

/// A dot that may be the pair's.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Its index in the frame.
    pub dot: u32,
    /// Where it is (px).
    pub pixel: Vector2<f64>,
    /// Its noise (px).
    pub sigma_px: f64,
    /// Logarithm of the density (px⁻²) of dots that belong to nobody known.
    pub ln_alone: f64,
}

/// A camera's candidates, and where the two markers are expected in its image.
#[derive(Clone, Debug)]
pub struct View<'a> {
    /// Index of the camera.
    pub camera: usize,
    /// The dots.
    pub candidates: &'a [Candidate],
    /// Both images (px) and their derivatives by the places (px/m), at the prior.
    pub expected: [(Vector2<f64>, Matrix2x3<f64>); 2],
    /// What the camera sees, by other frames.
    pub seen: Seen,
}

/// Where two markers are: places, one after the other (m), and their covariance (m²).
#[derive(Clone, Debug)]
pub struct Pose {
    /// Both places.
    pub mean: Vector6<f64>,
    /// Their covariance.
    pub covariance: Matrix6<f64>,
}

/// What a camera's dots are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Choice {
    /// Index among the candidates of the one's and the other's dot; the same where one is for both.
    pub of: [Option<usize>; 2],
}

/// The likeliest explanation of all cameras.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The places with the rays taken in.
    pub pose: Pose,
    /// By camera, in the order of the views.
    pub choices: Vec<Choice>,
}

impl Pose {
    /// From the middle of the two and the vector from the one to the other, each with its covariance.
    pub fn new(middle: (&Vector3<f64>, &Matrix3<f64>), between: (&Vector3<f64>, &Matrix3<f64>)) -> Self {
        let mut mean = Vector6::zeros();
        let mut covariance = Matrix6::zeros();
        let (own, cross) = (middle.1 + 0.25 * between.1, middle.1 - 0.25 * between.1);
        for (k, sign) in [(0, -0.5), (3, 0.5)] {
            mean.fixed_rows_mut::<3>(k).copy_from(&(middle.0 + sign * between.0));
            covariance.fixed_view_mut::<3, 3>(k, k).copy_from(&own);
            covariance.fixed_view_mut::<3, 3>(k, 3 - k).copy_from(&cross);
        }
        Self { mean, covariance }
    }

    /// Place and covariance of the one (0) or the other (1).
    pub fn place(&self, which: usize) -> (Vector3<f64>, Matrix3<f64>) {
        let at = 3 * which;
        (self.mean.fixed_rows::<3>(at).into_owned(), self.covariance.fixed_view::<3, 3>(at, at).into_owned())
    }

    /// The vector from the one to the other with its covariance.
    pub fn between(&self) -> (Vector3<f64>, Matrix3<f64>) {
        let ([p, q], c) = ([0, 1].map(|k| self.place(k)), self.covariance.fixed_view::<3, 3>(0, 3));
        (q.0 - p.0, p.1 + q.1 - c - c.transpose())
    }

    /// The middle of the two with its covariance.
    pub fn middle(&self) -> (Vector3<f64>, Matrix3<f64>) {
        let ([p, q], c) = ([0, 1].map(|k| self.place(k)), self.covariance.fixed_view::<3, 3>(0, 3));
        (0.5 * (p.0 + q.0), 0.25 * (p.1 + q.1 + c + c.transpose()))
    }

    /// Measurement update with a dot that stands where `by` of the pose's offset from `start` is (px); returns the squared
    /// error (in standard deviations) and the logarithm of the innovation's density (px⁻²).
    fn update(&mut self, (by, off): (&SMatrix<f64, 2, 6>, Vector2<f64>), sigma_px: f64) -> Option<(f64, f64)> {
        let weighed = self.covariance * by.transpose();
        let spread: Matrix2<f64> = by * weighed + Matrix2::identity() * (sigma_px * sigma_px);
        let inverse = spread.try_inverse()?;
        let squared = off.dot(&(inverse * off));
        let gain = weighed * inverse;
        self.mean += gain * off;
        let after = self.covariance - gain * weighed.transpose();
        self.covariance = 0.5 * (after + after.transpose());
        Some((squared, -0.5 * squared - 0.5 * spread.determinant().ln() - std::f64::consts::TAU.ln()))
    }
}

#[derive(Clone)]
struct Hypothesis {
    pose: Pose,
    /// Logarithm of its probability, up to a constant.
    likely: f64,
    choices: Vec<Choice>,
}

/// The likeliest explanation of the views. `merging_px`: the distance in an image at which two dots become one.
pub fn fit(prior: &Pose, views: &[View], merging_px: f64) -> Fitted {
    let mut order: Vec<usize> = (0..views.len()).collect();
    // Dots that are apart tell most.
    order.sort_by_key(|&v| (std::cmp::Reverse(views[v].candidates.len()), v));
    let nothing = vec![Choice::default(); views.len()];
    let mut kept = vec![Hypothesis { pose: prior.clone(), likely: 0.0, choices: nothing }];
    for v in order {
        let mut next: Vec<Hypothesis> =
            kept.iter().flat_map(|h| explained(h, v, &views[v], prior, merging_px)).collect();
        next.sort_by(|a, b| b.likely.total_cmp(&a.likely));
        next.truncate(BEAM);
        kept = next;
    }
    let best = kept.swap_remove(0);
    Fitted { pose: best.pose, choices: best.choices }
}

/// All ways to explain one camera's dots.
fn explained(before: &Hypothesis, index: usize, view: &View, start: &Pose, merging_px: f64) -> Vec<Hypothesis> {
    let n = view.candidates.len();
    let merged = chance_of_merging(&before.pose, view, start, merging_px);
    let [both, one, other, neither] = view.seen;
    let mut found = Vec::with_capacity(1 + 3 * n + n * n);
    let mut consider = |of: [Option<usize>; 2], chance: f64| {
        let choice = Choice { of };
        if let Some((pose, likely)) = chosen(&before.pose, choice, view, start) {
            let mut choices = before.choices.clone();
            choices[index] = choice;
            found.push(Hypothesis { pose, likely: before.likely + likely + chance.max(1e-12).ln(), choices });
        }
    };
    consider([None, None], neither);
    for k in 0..n {
        consider([Some(k), None], one);
        consider([None, Some(k)], other);
        consider([Some(k), Some(k)], both * merged);
        for l in (0..n).filter(|&l| l != k) {
            consider([Some(k), Some(l)], both * (1.0 - merged));
        }
    }
    found
}

/// A pose with one choice of dots taken in, and the logarithm of how much likelier the dots are than dots of nobody.
fn chosen(before: &Pose, choice: Choice, view: &View, start: &Pose) -> Option<(Pose, f64)> {
    let mut pose = before.clone();
    let mut likely = 0.0;
    let mut take = |candidate: &Candidate, share: [f64; 2], sigma_px: f64| {
        let (by, at) = image(view, share);
        let off = candidate.pixel - at - by * (pose.mean - start.mean);
        let (squared, ln_density) = pose.update((&by, off), sigma_px)?;
        likely += ln_density - candidate.ln_alone;
        (squared < GATE).then_some(())
    };
    match choice.of {
        [Some(k), Some(l)] if k == l => {
            let apart = separation(before, view, start).0;
            let candidate = &view.candidates[k];
            take(candidate, [0.5, 0.5], candidate.sigma_px.hypot(BLOB * apart))?;
        }
        of => {
            for (which, k) in of.into_iter().enumerate() {
                let Some(k) = k else { continue };
                let candidate = &view.candidates[k];
                take(
                    candidate,
                    [f64::from(u8::from(which == 0)), f64::from(u8::from(which == 1))],
                    candidate.sigma_px,
                )?;
            }
        }
    }
    Some((pose, likely))
}

/// The image of a weighted mean of both: its derivative by the pose, and where it is at the start (px).
fn image(view: &View, share: [f64; 2]) -> (SMatrix<f64, 2, 6>, Vector2<f64>) {
    let mut by = SMatrix::<f64, 2, 6>::zeros();
    let [p, q] = &view.expected;
    by.fixed_columns_mut::<3>(0).copy_from(&(share[0] * p.1));
    by.fixed_columns_mut::<3>(3).copy_from(&(share[1] * q.1));
    (by, share[0] * p.0 + share[1] * q.0)
}

/// Distance of the two images with its spread (px).
fn separation(pose: &Pose, view: &View, start: &Pose) -> (f64, f64) {
    let (by, at) = image(view, [-1.0, 1.0]);
    let apart = at + by * (pose.mean - start.mean);
    (apart.norm(), (0.5 * (by * pose.covariance * by.transpose()).trace()).max(0.0).sqrt())
}

/// How likely the two are one dot if both are seen.
fn chance_of_merging(pose: &Pose, view: &View, start: &Pose, merging_px: f64) -> f64 {
    let (apart, spread) = separation(pose, view, start);
    // A logistic curve with the spread of a normal distribution.
    let width = 0.55 * spread.hypot(SOFT * merging_px);
    (1.0 / (1.0 + ((apart - merging_px) / width).clamp(-30.0, 30.0).exp())).clamp(MERGED[0], MERGED[1])
}

/// What a camera sees in the frame beside one in which it saw this.
pub fn remembered(choice: Choice) -> Seen {
    let saw = match choice.of {
        [Some(_), Some(_)] => 0,
        [Some(_), None] => 1,
        [None, Some(_)] => 2,
        [None, None] => 3,
    };
    std::array::from_fn(|k| ANEW * USUAL[k] + if k == saw { 1.0 - ANEW } else { 0.0 })
}

/// What a camera sees where nothing is known of the frames beside.
pub fn usual() -> Seen {
    USUAL
}

/// What the frames on both sides say together.
pub fn both_sides(before: &Seen, after: &Seen) -> Seen {
    let product: Seen = std::array::from_fn(|k| before[k] * after[k] / USUAL[k]);
    let sum: f64 = product.iter().sum();
    product.map(|p| p / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Rig;
    use crate::synth::rigs::ring;

    const MERGING_PX: f64 = 3.0;

    fn rig() -> Rig {
        // 10 mm at 3 m are 3.3 px across.
        ring(4, 3.0, 20.0, 0.0, [1000.0, 1000.0], 1000.0)
    }

    /// What the four cameras make of the two: merged where their images are nearer than that; a hidden one has no dot.
    fn seen(rig: &Rig, places: [Vector3<f64>; 2], hidden: Option<usize>) -> Vec<Vec<Candidate>> {
        let dot = |dot: u32, pixel| Candidate { dot, pixel, sigma_px: 0.3, ln_alone: -12.0 };
        let view = |camera: &crate::camera::Camera| {
            let [p, q] = places.map(|x| camera.project_linear(&x).unwrap().0);
            match hidden {
                Some(k) => vec![dot(0, if k == 0 { q } else { p })],
                None if (q - p).norm() < MERGING_PX => vec![dot(0, 0.5 * (p + q))],
                None => vec![dot(0, q), dot(1, p)],
            }
        };
        rig.cameras.iter().map(view).collect()
    }

    fn found(rig: &Rig, prior: &Pose, dots: &[Vec<Candidate>], seen: Seen) -> Fitted {
        let view = |camera: usize| {
            let expected = [0, 1].map(|k| rig.cameras[camera].project_linear(&prior.place(k).0).unwrap());
            View { camera, candidates: &dots[camera], expected, seen }
        };
        let views: Vec<View> = (0..dots.len()).map(view).collect();
        fit(prior, &views, MERGING_PX)
    }

    fn prior(places: [Vector3<f64>; 2], off: Vector3<f64>) -> Pose {
        let [p, q] = places;
        let (middle, between) = (0.5 * (p + q) + off, q - p + 0.3 * off);
        Pose::new((&middle, &(Matrix3::identity() * 2.5e-5)), (&between, &(Matrix3::identity() * 4e-6)))
    }

    #[test]
    fn dots_apart_and_dots_of_both_are_shared_out() {
        let rig = rig();
        let places = [Vector3::new(0.0, 0.0, 0.0), Vector3::new(0.0, 0.011, 0.0)];
        let dots = seen(&rig, places, None);
        let merged: Vec<bool> = dots.iter().map(|d| d.len() == 1).collect();
        assert!(merged.contains(&true) && merged.contains(&false));
        let fitted = found(&rig, &prior(places, Vector3::new(0.004, -0.003, 0.002)), &dots, usual());
        for (choice, merged) in fitted.choices.iter().zip(merged) {
            assert_eq!(choice.of, if merged { [Some(0), Some(0)] } else { [Some(1), Some(0)] });
        }
        for (k, place) in places.iter().enumerate() {
            let (point, covariance) = fitted.pose.place(k);
            assert!((point - place).norm() < 5e-4 && covariance.trace().sqrt() < 3e-3);
        }
    }

    #[test]
    fn a_lone_marker_is_the_one_whose_place_it_has() {
        let rig = rig();
        let places = [Vector3::new(0.0, 0.0, 0.0), Vector3::new(0.006, 0.012, 0.003)];
        for hidden in 0..2 {
            let dots = seen(&rig, places, Some(hidden));
            let fitted = found(&rig, &prior(places, Vector3::new(0.001, 0.0, -0.001)), &dots, usual());
            let own = |k: usize| fitted.choices.iter().filter(|c| c.of[k].is_some()).count();
            assert_eq!((own(hidden), own(1 - hidden)), (0, 4));
        }
    }

    #[test]
    fn what_a_camera_saw_before_makes_it_likelier() {
        assert!(remembered(Choice { of: [Some(2), Some(2)] })[0] > 0.9);
        let one = remembered(Choice { of: [Some(0), None] });
        assert!(one[1] > 0.8 && (one.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(both_sides(&one, &one)[1] > one[1]);
    }
}
