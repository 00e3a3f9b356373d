//! First and second moments of poses, and ridge regression from them: a marker's place by how its neighbours depart
//! (Hoerl & Kennard 1970). Errors of stretches that were left out come from moments alone, too.

use nalgebra::{SMatrix, SVector, Vector3};

/// Neighbours at most.
pub const NEIGHBOURS: usize = 5;
/// Features of a pose: how each neighbour departs from the reference; those of neighbours that there are not are 0.
pub const WIDTH: usize = 3 * NEIGHBOURS;
pub type Features = SVector<f64, WIDTH>;
pub type OfFeatures = SMatrix<f64, WIDTH, WIDTH>;
pub type PlaceByFeatures = SMatrix<f64, 3, WIDTH>;

/// Neighbours' departures and the marker's place in the local frame, for one snapshot (m).
pub struct Sample {
    pub features: Features,
    pub place: Vector3<f64>,
}

/// Sums over samples of features, places and their products.
#[derive(Clone)]
pub struct Moments {
    count: f64,
    features: Features,
    place: Vector3<f64>,
    features2: OfFeatures,
    place_features: PlaceByFeatures,
    place2: f64,
}

impl Moments {
    /// Those of some samples.
    pub fn of(samples: &[Sample]) -> Self {
        let mut m = Self {
            count: samples.len() as f64,
            features: Features::zeros(),
            place: Vector3::zeros(),
            features2: OfFeatures::zeros(),
            place_features: PlaceByFeatures::zeros(),
            place2: 0.0,
        };
        for s in samples {
            m.features += s.features;
            m.place += s.place;
            m.place2 += s.place.norm_squared();
            m.place_features.ger(1.0, &s.place, &s.features, 1.0);
            // One half will do.
            for column in 0..WIDTH {
                let own = s.features[column];
                for row in column..WIDTH {
                    m.features2[(row, column)] += own * s.features[row];
                }
            }
        }
        m.features2.fill_upper_triangle_with_lower_triangle();
        m
    }

    /// Those of these and other samples.
    pub fn with(self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            features: self.features + other.features,
            place: self.place + other.place,
            features2: self.features2 + other.features2,
            place_features: self.place_features + other.place_features,
            place2: self.place2 + other.place2,
        }
    }

    /// Those of these samples but for others among them.
    pub fn without(&self, other: &Self) -> Self {
        Self {
            count: self.count - other.count,
            features: self.features - other.features,
            place: self.place - other.place,
            features2: self.features2 - other.features2,
            place_features: self.place_features - other.place_features,
            place2: self.place2 - other.place2,
        }
    }

    /// The same about the means.
    pub fn centred(&self) -> Centred {
        let (features, place) = (self.features / self.count, self.place / self.count);
        Centred {
            count: self.count,
            features2: self.features2 - self.features * features.transpose(),
            place_features: self.place_features - self.place * features.transpose(),
            place2: self.place2 - self.place.dot(&place),
            features,
            place,
        }
    }
}

/// Means, and sums of products of departures from them.
pub struct Centred {
    count: f64,
    pub features: Features,
    pub place: Vector3<f64>,
    features2: OfFeatures,
    place_features: PlaceByFeatures,
    place2: f64,
}

impl Centred {
    /// Mean over the features of `neighbours` of their summed squares (m²).
    pub fn mean_variance(&self, neighbours: usize) -> f64 {
        self.features2.trace().max(1e-12) / (3 * neighbours) as f64
    }

    /// The regression with a ridge (m²) on the features of `neighbours`; `None` for an infinite ridge: places stand still.
    pub fn regression(&self, neighbours: usize, ridge: f64) -> Option<Regression> {
        let factor = Factor::of(&self.features2, 3 * neighbours, ridge)?;
        Some(Regression { coefficients: factor.solve(&self.place_features), factor })
    }

    /// Sum of squared errors of these samples (m²) where others with these means and this regression predict them.
    pub fn error_by(&self, others: &Self, regression: Option<&Regression>) -> f64 {
        let off = self.place - others.place;
        let Some(Regression { coefficients, .. }) = regression else {
            return self.place2 + self.count * off.norm_squared();
        };
        let off = off - coefficients * (self.features - others.features);
        let explained = (coefficients * self.features2 - self.place_features * 2.0).dot(coefficients);
        self.place2 + explained + self.count * off.norm_squared()
    }
}

/// Coefficients of the place by the features, and what they rest on.
#[derive(Clone, Debug)]
pub struct Regression {
    pub coefficients: PlaceByFeatures,
    factor: Factor,
}

impl Regression {
    /// How far a pose's departure (m) is from what was seen: 0 at the mean, 1/n for the typical one of n samples.
    pub fn leverage(&self, departure: &Features) -> f64 {
        self.factor.squared(departure)
    }
}

/// L of ridged second moments L Lᵀ, as far as there are features.
#[derive(Clone, Debug)]
struct Factor {
    lower: OfFeatures,
    width: usize,
}

impl Factor {
    /// Cholesky's factor, column by column; `None` if a pivot is not positive and finite.
    fn of(moments: &OfFeatures, width: usize, ridge: f64) -> Option<Self> {
        let mut lower = *moments;
        for j in 0..width {
            let (done, rest) = lower.as_mut_slice().split_at_mut(j * WIDTH);
            let own = &mut rest[j..width];
            own[0] += ridge;
            for column in done.chunks_exact(WIDTH) {
                let by = column[j];
                own.iter_mut().zip(&column[j..width]).for_each(|(own, other)| *own -= by * other);
            }
            let pivot = own[0].sqrt();
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            own.iter_mut().for_each(|own| *own /= pivot);
        }
        Some(Self { lower, width })
    }

    /// Column j of L from the diagonal on.
    fn column(&self, j: usize) -> &[f64] {
        &self.lower.as_slice()[j * WIDTH..][j..self.width]
    }

    /// X with X (L Lᵀ) = B.
    fn solve(&self, b: &PlaceByFeatures) -> PlaceByFeatures {
        let mut x = b.transpose();
        for mut row in x.column_iter_mut() {
            let x = row.as_mut_slice();
            self.forward(x);
            for j in (0..self.width).rev() {
                let (own, rest) = x[j..self.width].split_at_mut(1);
                let [pivot, below @ ..] = self.column(j) else { continue };
                let known: f64 = below.iter().zip(rest).map(|(l, x)| l * *x).sum();
                own[0] = (own[0] - known) / pivot;
            }
        }
        x.transpose()
    }

    /// Turns v into L⁻¹ v.
    fn forward(&self, v: &mut [f64]) {
        for j in 0..self.width {
            let (own, rest) = v[j..self.width].split_at_mut(1);
            let [pivot, below @ ..] = self.column(j) else { continue };
            own[0] /= pivot;
            rest.iter_mut().zip(below).for_each(|(v, l)| *v -= l * own[0]);
        }
    }

    /// vᵀ (L Lᵀ)⁻¹ v.
    fn squared(&self, v: &Features) -> f64 {
        let mut v = *v;
        self.forward(v.as_mut_slice());
        v.as_slice()[..self.width].iter().map(|v| v * v).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;
    use approx::assert_relative_eq;

    /// Samples of three neighbours, the place led by two of their features.
    fn samples(count: usize) -> Vec<Sample> {
        let mut random = Random::new(11, 0);
        let one = |_| {
            let mut features = Features::zeros();
            for i in 0..3 {
                features.fixed_rows_mut::<3>(3 * i).copy_from(&random.in_box(&Vector3::repeat(0.02)));
            }
            let noise = random.in_box(&Vector3::repeat(0.001));
            let place = Vector3::new(0.1 + features[4], 0.2 - 0.5 * features[0], 0.3) + noise;
            Sample { features, place }
        };
        (0..count).map(one).collect()
    }

    /// nalgebra's solution of the normal equations is the oracle.
    #[test]
    fn the_regression_solves_the_normal_equations() {
        let centred = Moments::of(&samples(40)).centred();
        let regression = centred.regression(3, 1e-4).expect("it is regular");
        let ridged = centred.features2 + OfFeatures::identity() * 1e-4;
        let inverse = ridged.try_inverse().expect("it is regular");
        assert_relative_eq!(regression.coefficients, centred.place_features * inverse, epsilon = 1e-9);
        let departure = samples(1).remove(0).features;
        let leverage = departure.dot(&(inverse * departure));
        assert_relative_eq!(regression.leverage(&departure), leverage, max_relative = 1e-9);
    }

    /// Predicting each sample that was left out is the oracle.
    #[test]
    fn errors_from_moments_are_those_of_the_samples() {
        let samples = samples(60);
        let (out, rest) = samples.split_at(20);
        let own = Moments::of(out);
        let all = Moments::of(rest).with(&own);
        let others = all.without(&own).centred();
        for ridge in [1e-5, f64::INFINITY] {
            let regression = others.regression(3, ridge);
            assert_eq!(regression.is_some(), ridge.is_finite());
            let by = regression.as_ref().map_or(PlaceByFeatures::zeros(), |r| r.coefficients);
            let off = |s: &Sample| s.place - others.place - by * (s.features - others.features);
            let sum: f64 = out.iter().map(|s| off(s).norm_squared()).sum();
            assert_relative_eq!(own.centred().error_by(&others, regression.as_ref()), sum, max_relative = 1e-9);
        }
    }

    #[test]
    fn moments_without_a_spread_have_no_regression() {
        let centred = Moments::of(&[]).centred();
        assert!(centred.regression(3, 0.1).is_none());
        let still = Moments::of(&samples(1)).centred();
        assert!(still.regression(3, 0.0).is_none());
    }
}
