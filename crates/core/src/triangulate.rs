//! One 3D point from the rays of several cameras.
//!
//! Base case: the point halfway between the two nearest points of two rays, whose distance (the *gap*) is the lecture
//! notes' own test of correspondence (§6.4, eqs. 6.3–6.4; the same as Hartley & Sturm 1997, "Triangulation", mid-point
//! method). General case: the point that minimises the whitened reprojection error over all rays (Gauss–Newton from
//! the base case), with covariance, able to leave out one bad view. A result is a point or the reason why there is none.

use crate::chi2;
use crate::sight::{Normal, Sight};
use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

/// Why rays do not give a point.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoPoint {
    /// Fewer than two rays.
    #[error("{0} ray(s) where at least 2 are needed")]
    TooFewRays(usize),
    /// All rays run (nearly) in one direction: the depth is undetermined.
    #[error("rays meet at {angle_deg:.3} degrees: too parallel to give a depth")]
    Parallel {
        /// Largest angle between two rays, folded into 0–90°.
        angle_deg: f64,
    },
    /// The point lies behind the camera with this index.
    #[error("the rays meet behind camera {0}")]
    BehindCamera(usize),
    /// The rays do not meet within their noise, whichever one is left out.
    #[error("the rays miss each other: squared error {rss:.1} against at most {gate:.1}")]
    Outlier {
        /// Squared whitened error of the best attempt.
        rss: f64,
        /// Largest acceptable value.
        gate: f64,
    },
}

/// Nearest points of two rays.
#[derive(Clone, Copy, Debug)]
pub struct RayMeeting {
    /// Halfway between the nearest points (m, world).
    pub midpoint: Vector3<f64>,
    /// Distance between the nearest points (m).
    pub gap_m: f64,
    /// Distance of the nearest point along the first and second ray (m).
    pub along_m: [f64; 2],
}

/// Nearest points of two rays with unit directions (lecture notes §6.4).
pub fn two_rays(origins: [&Vector3<f64>; 2], directions: [&Vector3<f64>; 2]) -> Result<RayMeeting, NoPoint> {
    let [o1, o2] = origins;
    let [d1, d2] = directions;
    let between = o2 - o1;
    let cosine = d1.dot(d2);
    // sin² through the cross product: 1 − cos² loses all digits for nearly parallel rays.
    let sine2 = d1.cross(d2).norm_squared();
    if sine2 < 1e-14 {
        return Err(NoPoint::Parallel { angle_deg: sine2.sqrt().to_degrees() });
    }
    let (b1, b2) = (between.dot(d1), between.dot(d2));
    let s1 = (b1 - cosine * b2) / sine2;
    let s2 = (cosine * b1 - b2) / sine2;
    let (p1, p2) = (o1 + d1 * s1, o2 + d2 * s2);
    Ok(RayMeeting { midpoint: 0.5 * (p1 + p2), gap_m: (p2 - p1).norm(), along_m: [s1, s2] })
}

/// How strict a triangulation is.
#[derive(Clone, Copy, Debug)]
pub struct TriangulateOptions {
    /// Smallest angle between the two most different rays (degrees, folded into 0–90). Below it the depth is a guess:
    /// too small gives points metres off, too large loses markers that only neighbouring cameras see.
    pub min_angle_deg: f64,
    /// Probability with which a correct set of rays is refused because of its residual. `0` never refuses.
    pub refuse_probability: f64,
}

impl Default for TriangulateOptions {
    fn default() -> Self {
        Self { min_angle_deg: 0.5, refuse_probability: 1e-6 }
    }
}

/// A triangulated point.
#[derive(Clone, Debug)]
pub struct Triangulated {
    /// Position (m, world).
    pub point: Vector3<f64>,
    /// Its covariance (m²), from the sights' noise.
    pub covariance: Matrix3<f64>,
    /// Squared whitened error of the rays used.
    pub rss: f64,
    /// Index of a view that was left out because it disagrees with all others.
    pub left_out: Option<usize>,
}

/// The point that best explains all sights; leaves out at most one that disagrees (needs three others or more).
pub fn triangulate(sights: &[&Sight], options: &TriangulateOptions) -> Result<Triangulated, NoPoint> {
    let all = least_squares(sights, options)?;
    let gate = |n: usize| chi2::quantile(options.refuse_probability, (2 * n - 3) as f64);
    if options.refuse_probability <= 0.0 || all.rss <= gate(sights.len()) {
        return Ok(all);
    }
    let refused = NoPoint::Outlier { rss: all.rss, gate: gate(sights.len()) };
    if sights.len() < 4 {
        return Err(refused); // Of three rays that disagree, no one can tell which is wrong.
    }
    let mut best: Option<Triangulated> = None;
    for out in 0..sights.len() {
        let rest: Vec<&Sight> = sights.iter().enumerate().filter(|(i, _)| *i != out).map(|(_, s)| *s).collect();
        if let Ok(found) = least_squares(&rest, options)
            && best.as_ref().is_none_or(|b| found.rss < b.rss)
        {
            best = Some(Triangulated { left_out: Some(out), ..found });
        }
    }
    best.filter(|b| b.rss <= gate(sights.len() - 1)).ok_or(refused)
}

/// Largest angle between two of the rays, folded into 0–90° (degrees).
pub fn widest_angle_deg(sights: &[&Sight]) -> f64 {
    let mut widest: f64 = 0.0;
    for (i, a) in sights.iter().enumerate() {
        for b in &sights[i + 1..] {
            widest = widest.max(a.direction.cross(&b.direction).norm());
        }
    }
    widest.min(1.0).asin().to_degrees()
}

fn least_squares(sights: &[&Sight], options: &TriangulateOptions) -> Result<Triangulated, NoPoint> {
    if sights.len() < 2 {
        return Err(NoPoint::TooFewRays(sights.len()));
    }
    let angle_deg = widest_angle_deg(sights);
    if angle_deg < options.min_angle_deg {
        return Err(NoPoint::Parallel { angle_deg });
    }
    let point = nearest_to_all_rays(sights).ok_or(NoPoint::Parallel { angle_deg })?;
    let behind = |p: &Vector3<f64>| sights.iter().find(|s| s.depth(p) <= 1e-6).map(|s| s.camera);
    if let Some(camera) = behind(&point) {
        return Err(NoPoint::BehindCamera(camera));
    }
    let (point, normal) = refine(sights, point, |_| 1.0).ok_or(NoPoint::Parallel { angle_deg })?;
    if let Some(camera) = behind(&point) {
        return Err(NoPoint::BehindCamera(camera));
    }
    let covariance = normal.information().try_inverse().ok_or(NoPoint::Parallel { angle_deg })?;
    let rss = sights.iter().map(|s| s.linearise(&point).error.norm_squared()).sum();
    Ok(Triangulated { point, covariance, rss, left_out: None })
}

/// The point with the least summed squared distance from all rays: the start for [`refine`].
fn nearest_to_all_rays(sights: &[&Sight]) -> Option<Vector3<f64>> {
    let mut matrix = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for sight in sights {
        let across = Matrix3::identity() - sight.direction * sight.direction.transpose();
        matrix += across;
        right += across * sight.origin;
    }
    matrix.try_inverse().map(|inverse| inverse * right)
}

/// Gauss–Newton on the whitened reprojection error with a weight per squared error (1 = least squares). Returns the
/// point and the normal equations at it; `None` if the geometry is degenerate.
pub fn refine(
    sights: &[&Sight],
    start: Vector3<f64>,
    weight_of_squared_error: impl Fn(f64) -> f64,
) -> Option<(Vector3<f64>, Normal)> {
    let mut point = start;
    let mut normal = Normal::default();
    for _ in 0..25 {
        normal = Normal::default();
        for sight in sights {
            let linear = sight.linearise(&point);
            normal = normal.plus(&Normal::of(&linear, weight_of_squared_error(linear.error.norm_squared())));
        }
        let step = normal.minimum()?.step;
        point += step;
        if step.norm() < 1e-10 * (1.0 + point.norm()) {
            break;
        }
    }
    Some((point, normal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::rigs;
    use approx::assert_relative_eq;
    use nalgebra::Vector2;

    fn sights_of(point: Vector3<f64>, noise: &[[f64; 2]]) -> Vec<Sight> {
        let rig = rigs::ring(noise.len(), 4.0, 30.0, 0.0, [1000.0, 800.0], 900.0);
        let see = |(i, n): (usize, &[f64; 2])| {
            let pixel = rig.cameras[i].project(&point).unwrap() + Vector2::from(*n);
            Sight::new(&rig.cameras[i], i, pixel, 1.0).unwrap()
        };
        noise.iter().enumerate().map(see).collect()
    }

    fn solve(sights: &[Sight]) -> Result<Triangulated, NoPoint> {
        triangulate(&sights.iter().collect::<Vec<_>>(), &TriangulateOptions::default())
    }

    const POINT: Vector3<f64> = Vector3::new(0.2, -0.3, 0.4);

    #[test]
    fn two_rays_meet_halfway_and_report_their_gap() {
        let (o1, d1) = (Vector3::zeros(), Vector3::x());
        let (o2, d2) = (Vector3::new(2.0, -3.0, 0.5), Vector3::y());
        let meeting = two_rays([&o1, &o2], [&d1, &d2]).unwrap();
        assert_relative_eq!(meeting.midpoint, Vector3::new(2.0, 0.0, 0.25), epsilon = 1e-12);
        assert_relative_eq!(meeting.gap_m, 0.5, epsilon = 1e-12);
        assert_relative_eq!(meeting.along_m[1], 3.0, epsilon = 1e-12);
    }

    #[test]
    fn exact_without_noise_for_two_to_eight_views() {
        for n in 2..=8 {
            let found = solve(&sights_of(POINT, &vec![[0.0; 2]; n])).unwrap();
            assert_relative_eq!(found.point, POINT, epsilon = 1e-10);
            assert!(found.rss < 1e-12);
        }
    }

    #[test]
    fn covariance_predicts_the_spread_of_the_error() {
        let mut random = crate::synth::random::Random::new(7, 0);
        let (mut ratio, n) = (0.0, 2000);
        for _ in 0..n {
            let noise: Vec<[f64; 2]> = (0..4).map(|_| [random.normal(), random.normal()]).collect();
            let found = solve(&sights_of(POINT, &noise)).unwrap();
            let error = found.point - POINT;
            ratio += error.dot(&(found.covariance.try_inverse().unwrap() * error)) / 3.0;
        }
        assert_relative_eq!(ratio / f64::from(n), 1.0, epsilon = 0.06);
    }

    #[test]
    fn one_bad_view_of_five_is_left_out() {
        let mut noise = vec![[0.0; 2]; 5];
        noise[3] = [40.0, -25.0];
        let found = solve(&sights_of(POINT, &noise)).unwrap();
        assert_eq!(found.left_out, Some(3));
        assert_relative_eq!(found.point, POINT, epsilon = 1e-9);
    }

    #[test]
    fn each_degeneracy_has_its_reason() {
        let sights = sights_of(POINT, &[[0.0; 2]; 3]);
        assert_eq!(solve(&sights[..1]).unwrap_err(), NoPoint::TooFewRays(1));
        assert!(matches!(solve(&[sights[0].clone(), sights[0].clone()]).unwrap_err(), NoPoint::Parallel { .. }));
        let far = sights_of(POINT, &[[200.0, 0.0], [-200.0, 150.0], [0.0, -180.0]]);
        assert!(matches!(solve(&far).unwrap_err(), NoPoint::Outlier { .. }));
        let mut behind = sights.clone();
        for sight in &mut behind {
            sight.direction = -sight.direction;
            sight.axis = -sight.axis;
        }
        assert!(matches!(solve(&behind).unwrap_err(), NoPoint::BehindCamera(_)));
    }
}
