//! A hidden marker's place from its most reliable neighbours: a rigid frame, and what history says beyond rigidity.
//!
//! The neighbours' places at a moment are turned onto a reference (`rotation.rs`): in that local frame a rigidly placed
//! marker stands still. How it departs from that is predicted from how the neighbours depart, by ridge regression on the
//! history; how strong the ridge is, and how honest the outcome, is decided by leaving out stretches of the history.
//! What the marker was off when last seen fades as such errors do (`fading.rs`; cf. Piazza et al. 2009; Gløersen &
//! Federolf 2016 for the use of all markers' correlations).

use super::fading::Fading;
use super::moments::{Features, Moments, NEIGHBOURS, Regression, Sample};
use super::rotation::align;
use super::{Carried, SeenAt, Snapshot};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Fewer make no frame.
const FEWEST: usize = 3;
/// Smallest area of the triangle of the first three neighbours' spread (m²): below it the frame's turn is a guess.
const SMALLEST_SPREAD: f64 = 0.02;
/// Ridges tried, relative to the mean variance of the features; the last means "rigid".
const RIDGES: [f64; 4] = [0.05, 0.5, 5.0, f64::INFINITY];
/// Stretches of the history that are left out in turn.
const FOLDS: usize = 5;
/// Snapshots below which the history says nothing.
const FEW_SNAPSHOTS: usize = 8;
/// Error per axis of an untried frame: at least (m), by distance, and by how far the marker moved in the frame so far;
/// and how many independent snapshots that belief is worth.
const UNTRIED_ERROR: f64 = 0.010;
const UNTRIED_BY_DISTANCE: f64 = 0.05;
const UNTRIED_BY_MOTION: f64 = 0.5;
const UNTRIED_WORTH: f64 = 5.0;
/// Correlations of the errors of neighbouring snapshots that are believed.
const LAGS: [f64; 2] = [0.2, 0.97];
/// Correlation length of an untried frame's errors (s).
const UNTRIED_LENGTH_S: f64 = 0.15;
/// The last motion is taken from moments within this time (s).
const LAST_MOTION_S: f64 = 0.05;
/// What errors vary by smoothly is this part of their variance at least, however noisy the markers are.
const SMOOTH: f64 = 0.1;
/// Largest factor on the variance for poses unlike those of the history.
const LARGEST_LEVERAGE: f64 = 30.0;
/// Error that never fades, beside measurement: skin (m).
const LEAST_ERROR: f64 = 0.000_7;

/// A fitted frame for one hidden marker.
#[derive(Clone, Debug)]
pub struct Fit {
    neighbours: Vec<usize>,
    reference: Vec<Vector3<f64>>,
    rotation: Rotation3<f64>,
    mean_features: Features,
    mean_place: Vector3<f64>,
    /// Place by features; none when rigid.
    regression: Option<Regression>,
    /// Error per axis that varies smoothly (m²), and its correlation length (s).
    variance: f64,
    length_s: f64,
    /// What the neighbours' noise makes of the place (local frame, m²).
    noise: Matrix3<f64>,
    /// How far off the prediction was when the marker was seen.
    off: Fading,
}

impl Fit {
    /// A frame of the neighbours for the marker in `slot`; `None` if the neighbours do not span a frame.
    ///
    /// `lost`: the last moments in which it was seen, newest first, with their times (s): they are held for exact, because a
    /// marker that is searched for more widely takes others' dots. `spacing_s`: time between two snapshots of the history.
    pub fn new(
        slot: usize,
        neighbours: &[usize],
        history: &[&Snapshot],
        lost: &[(f64, Snapshot)],
        spacing_s: f64,
    ) -> Option<Self> {
        let (lost_s, newest) = lost.first()?;
        let mut fit = Self::frame(neighbours, history, newest)?;
        let samples = fit.samples(slot, history);
        let last: Vec<(f64, Sample)> = lost
            .iter()
            .take_while(|(at, _)| lost_s - at < LAST_MOTION_S)
            .map_while(|(at, s)| fit.local(slot, s, Rotation3::identity()).map(|(sample, _)| (*at, sample)))
            .collect();
        fit.learn(&samples, last.first().map(|(_, s)| s), None, spacing_s)?;
        let off = last.iter().map(|(at, s)| (*at, fit.off_by(s)));
        fit.off = Fading::onward(off, fit.variance, fit.length_s);
        Some(fit)
    }

    /// The same within a recorded take, where it is known when the marker comes back and how noisy everything is.
    ///
    /// `seen`: moments in which it was seen, before and after, the last one before it got lost first; `noise`: usual variance
    /// per axis of what is measured, by slot (m²).
    pub fn between(
        slot: usize,
        neighbours: &[usize],
        noise: &[f64],
        history: &[&Snapshot],
        seen: &[SeenAt],
        spacing_s: f64,
    ) -> Option<Self> {
        let mut fit = Self::frame(neighbours, history, &seen.first()?.places)?;
        let samples = fit.samples(slot, history);
        let local = |s: &SeenAt| fit.local(slot, &s.places, Rotation3::identity());
        let known: Vec<(&SeenAt, Sample, Rotation3<f64>)> =
            seen.iter().filter_map(|s| local(s).map(|(sample, turn)| (s, sample, turn))).collect();
        fit.learn(&samples, known.first().map(|(_, sample, _)| sample), Some((noise, slot)), spacing_s)?;
        let off = known
            .iter()
            .map(|(s, sample, turn)| (s.time_s, fit.off_by(sample), turn * s.covariance * turn.inverse() + fit.noise));
        fit.off = Fading::around(off, fit.variance, fit.length_s);
        Some(fit)
    }

    /// The history in the local frame.
    fn samples(&self, slot: usize, history: &[&Snapshot]) -> Vec<Sample> {
        let mut guess = Rotation3::identity();
        let mut samples = Vec::with_capacity(history.len());
        for snapshot in history {
            if let Some((sample, rotation)) = self.local(slot, snapshot, guess) {
                guess = rotation;
                samples.push(sample);
            }
        }
        samples
    }

    /// How far off the prediction is of a sample.
    fn off_by(&self, sample: &Sample) -> Vector3<f64> {
        sample.place - self.place_of(&sample.features)
    }

    /// The reference: the neighbours as they stood when the marker was lost, or else as lately as all were seen.
    fn frame(neighbours: &[usize], history: &[&Snapshot], lost: &Snapshot) -> Option<Self> {
        if neighbours.len() < FEWEST {
            return None;
        }
        let places = |s: &Snapshot| -> Option<Vec<Vector3<f64>>> {
            neighbours.iter().map(|&n| s.get(n).copied().flatten()).collect()
        };
        let points = places(lost).or_else(|| history.iter().find_map(|s| places(s)))?;
        let reference = centered(&points).1;
        (spread(&reference) > SMALLEST_SPREAD).then(|| Self {
            neighbours: neighbours.to_vec(),
            rotation: Rotation3::identity(),
            mean_features: Features::zeros(),
            reference,
            mean_place: Vector3::zeros(),
            regression: None,
            variance: 0.0,
            length_s: UNTRIED_LENGTH_S,
            noise: Matrix3::zeros(),
            off: Fading::default(),
        })
    }

    /// Whether the frame leans on a slot.
    pub fn uses(&self, slot: usize) -> bool {
        self.neighbours.contains(&slot)
    }

    /// Whether all neighbours are known.
    pub fn can_use(&self, now: &[Option<Vector3<f64>>]) -> bool {
        self.neighbours.iter().all(|&n| now.get(n).is_some_and(Option::is_some))
    }

    /// Features of a snapshot, and the rotation from the world into the local frame with the neighbours' centroid.
    fn features(
        &self,
        now: &[Option<Vector3<f64>>],
        guess: Rotation3<f64>,
    ) -> Option<(Features, Rotation3<f64>, Vector3<f64>)> {
        let mut points = [Vector3::zeros(); NEIGHBOURS];
        let points = &mut points[..self.neighbours.len()];
        for (point, &n) in points.iter_mut().zip(&self.neighbours) {
            *point = now.get(n).copied().flatten()?;
        }
        Some(self.features_of(points, guess))
    }

    /// The same of the neighbours' places, which are moved to their centroid.
    fn features_of(
        &self,
        points: &mut [Vector3<f64>],
        guess: Rotation3<f64>,
    ) -> (Features, Rotation3<f64>, Vector3<f64>) {
        let center = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        points.iter_mut().for_each(|p| *p -= center);
        let rotation = align(points, &self.reference, &[1.0; NEIGHBOURS], guess);
        let mut features = Features::zeros();
        for (i, (point, reference)) in points.iter().zip(&self.reference).enumerate() {
            features.fixed_rows_mut::<3>(3 * i).copy_from(&(rotation * point - reference));
        }
        (features, rotation, center)
    }

    fn local(&self, slot: usize, snapshot: &Snapshot, guess: Rotation3<f64>) -> Option<(Sample, Rotation3<f64>)> {
        let marker = snapshot.get(slot).copied().flatten()?;
        let (features, rotation, center) = self.features(snapshot, guess)?;
        Some((Sample { features, place: rotation * (marker - center) }, rotation))
    }

    fn place_of(&self, features: &Features) -> Vector3<f64> {
        let departure = self.regression.as_ref().map(|r| r.coefficients * (features - self.mean_features));
        self.mean_place + departure.unwrap_or_default()
    }

    /// Mean place, regression and error from the samples (newest first), and from the noise of all and the marker's slot.
    fn learn(
        &mut self,
        samples: &[Sample],
        last: Option<&Sample>,
        noise: Option<(&[f64], usize)>,
        spacing_s: f64,
    ) -> Option<()> {
        if samples.len() < FEW_SNAPSHOTS {
            let all = samples.iter().chain(last);
            let n = all.clone().count();
            if n == 0 {
                return None;
            }
            self.mean_place = all.map(|s| s.place).sum::<Vector3<f64>>() / n as f64;
            self.noise = noise.map_or(self.noise, |(of_all, _)| self.noise_by_neighbours(of_all));
            self.variance = self.untried_variance(samples);
            return Some(());
        }
        let folds: [Moments; FOLDS] = std::array::from_fn(|f| Moments::of(fold(samples, f)));
        let moments = folds[1..].iter().fold(folds[0].clone(), Moments::with);
        let (all, neighbours) = (moments.centred(), self.neighbours.len());
        let ridges = RIDGES.map(|r| r * all.mean_variance(neighbours));
        let errors = left_out_errors(&moments, &folds, neighbours, &ridges);
        let (ridge, error) = ridges.into_iter().zip(errors).min_by(|a, b| a.1.total_cmp(&b.1))?;
        (self.mean_features, self.mean_place) = (all.features, all.place);
        self.regression = all.regression(neighbours, ridge);
        let own = (error / (3.0 * samples.len() as f64)).max(1e-12);
        let mut smooth = own;
        if let Some((of_all, slot)) = noise {
            self.noise = self.noise_by_neighbours(of_all);
            smooth = (own - of_all[slot] - self.noise.trace() / 3.0).max(SMOOTH * own);
        }
        let lag = (self.lag_correlation(samples) * (own / smooth)).clamp(LAGS[0], LAGS[1]);
        self.length_s = length_of(lag, spacing_s);
        let worth = samples.len() as f64 * (1.0 - lag) / (1.0 + lag);
        self.variance = (UNTRIED_WORTH * self.untried_variance(samples) + worth * smooth) / (UNTRIED_WORTH + worth);
        Some(())
    }

    /// What the usual noise of the neighbours makes of the place (local frame, m²), to the first order.
    fn noise_by_neighbours(&self, noise: &[f64]) -> Matrix3<f64> {
        const SHIFT: f64 = 1e-4;
        let place = |shifted: usize, shift: Vector3<f64>| {
            let mut points = self.reference.clone();
            points[shifted] += shift;
            let (features, rotation, center) = self.features_of(&mut points, Rotation3::identity());
            center + rotation.inverse() * self.place_of(&features)
        };
        let mut sum = Matrix3::zeros();
        for (n, slot) in self.neighbours.iter().enumerate() {
            for axis in 0..3 {
                let shift = Vector3::ith(axis, SHIFT);
                let by = (place(n, shift) - place(n, -shift)) / (2.0 * SHIFT);
                sum += by * by.transpose() * noise[*slot];
            }
        }
        sum
    }

    /// What the error per axis may be where nothing proves otherwise (m²).
    fn untried_variance(&self, samples: &[Sample]) -> f64 {
        let n = samples.len().max(1) as f64;
        let mean = samples.iter().map(|s| s.place).sum::<Vector3<f64>>() / n;
        let moved = samples.iter().map(|s| (s.place - mean).norm_squared()).sum::<f64>() / (3.0 * n);
        let distance = self.mean_place.norm();
        UNTRIED_ERROR.powi(2) + (UNTRIED_BY_DISTANCE * distance).powi(2) + UNTRIED_BY_MOTION.powi(2) * moved
    }

    /// Correlation of the errors of neighbouring snapshots.
    fn lag_correlation(&self, samples: &[Sample]) -> f64 {
        let errors: Vec<Vector3<f64>> = samples.iter().map(|s| s.place - self.place_of(&s.features)).collect();
        let (mut lagged, mut squared) = (0.0, 1e-12);
        for pair in errors.windows(2) {
            lagged += pair[0].dot(&pair[1]);
            squared += 0.5 * (pair[0].norm_squared() + pair[1].norm_squared());
        }
        lagged / squared
    }

    /// The marker's place at a moment.
    pub fn predict(&mut self, now: &[Option<Vector3<f64>>], time_s: f64) -> Option<Carried> {
        let (features, rotation, center) = self.features(now, self.rotation)?;
        self.rotation = rotation;
        let (off, left) = self.off.at(time_s);
        let place = self.place_of(&features) + off;
        let leverage = self.regression.as_ref().map_or(0.0, |r| r.leverage(&(features - self.mean_features)));
        let leverage = leverage.min(LARGEST_LEVERAGE);
        let covariance = left * (1.0 + leverage) + self.noise + Matrix3::identity() * LEAST_ERROR.powi(2);
        let point = center + rotation.inverse() * place;
        Some(Carried { point, covariance: rotation.inverse() * covariance * rotation })
    }
}

/// Length of a Matérn 3/2 process whose correlation after `spacing_s` is `correlation`: (1 + x) e⁻ˣ, by bisection.
fn length_of(correlation: f64, spacing_s: f64) -> f64 {
    let (mut low, mut high) = (0.01, 20.0);
    for _ in 0..50 {
        let x: f64 = 0.5 * (low + high);
        if (1.0 + x) * (-x).exp() > correlation { low = x } else { high = x }
    }
    spacing_s / low
}

/// The centroid of points, and the points from there.
pub fn centered(points: &[Vector3<f64>]) -> (Vector3<f64>, Vec<Vector3<f64>>) {
    let center = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    (center, points.iter().map(|p| p - center).collect())
}

/// Spread of centred points along their second axis (m): how well they fix a frame.
fn spread(points: &[Vector3<f64>]) -> f64 {
    let moments = points.iter().fold(Matrix3::zeros(), |m, p| m + p * p.transpose());
    let mut values: [f64; 3] = moments.symmetric_eigenvalues().into();
    values.sort_unstable_by(f64::total_cmp);
    (values[1].max(0.0) / points.len() as f64).sqrt()
}

fn fold(samples: &[Sample], fold: usize) -> &[Sample] {
    &samples[fold * samples.len() / FOLDS..(fold + 1) * samples.len() / FOLDS]
}

/// By ridge, the sum of squared errors of stretches predicted from the rest (m²).
fn left_out_errors<const N: usize>(all: &Moments, folds: &[Moments], neighbours: usize, ridges: &[f64; N]) -> [f64; N] {
    let mut errors = [0.0; N];
    for fold in folds {
        let (own, rest) = (fold.centred(), all.without(fold).centred());
        for (error, ridge) in errors.iter_mut().zip(ridges) {
            *error += own.error_by(&rest, rest.regression(neighbours, *ridge).as_ref());
        }
    }
    errors
}
