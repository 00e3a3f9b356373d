//! What is known of one or several subjects: distances, heights over triangles, and the order to look for markers.

use nalgebra::Vector3;

/// Most that is trusted in a length, and so the least evidence of a term, the logarithm of the rest: one wrong neighbour
/// must not outvote all others.
pub const MOST_TRUST: f64 = 0.998;
/// Neighbours that speak for a marker at most, and how many count in full: further ones say little that is new.
pub const NEIGHBOURS: usize = 6;
const IN_FULL: f64 = 4.0;
/// What a neighbour counts that is not rigidly joined: several of them change together when a joint bends.
const SOFT_WEIGHT: f64 = 0.4;
/// Evidence of the two most rigid neighbours after which no further one is asked.
const HOPELESS: f64 = -9.0;
/// Heights over triangles that speak for a marker at most.
const HEIGHTS: usize = 2;

/// The distance of two markers, or a height over a triangle: a mean and a spread (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Length {
    /// Mean (m).
    pub mean: f64,
    /// Standard deviation (m), the noise of the points included.
    pub sd: f64,
    /// Probability that mean and spread hold at all: that the frames they were learned from showed enough.
    pub trust: f64,
}

/// The signed height of a marker over the plane of three others, (b − a) × (c − a) being up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Height {
    /// The three others.
    pub base: [usize; 3],
    /// The height (m).
    pub length: Length,
}

/// A term ready for use: Student's t with three degrees of freedom, against a uniform density over the reach.
#[derive(Clone, Copy, Debug)]
struct Term {
    mean: f64,
    inverse_sd: f64,
    peak: f64,
    /// Evidence of a length that does not fit, and the square of the deviation, in spreads, where it begins.
    floor: f64,
    hopeless: f64,
    weight: f64,
}

impl Term {
    fn new(length: &Length, reach: f64) -> Self {
        // Density at the mean: 2 / (π √3 sd).
        let peak = (reach * 2.0 / (std::f64::consts::PI * 3.0_f64.sqrt() * length.sd)).ln();
        let floor = (1.0 - length.trust.clamp(0.0, MOST_TRUST)).ln().min(peak);
        let hopeless = 3.0 * ((0.5 * (peak - floor)).exp() - 1.0);
        let weight = if length.trust >= 1.0 { 1.0 } else { SOFT_WEIGHT };
        Self { mean: length.mean, inverse_sd: 1.0 / length.sd, peak, floor, hopeless, weight }
    }

    fn evidence(&self, value: f64) -> f64 {
        let z = (value - self.mean) * self.inverse_sd;
        if z * z >= self.hopeless { self.floor } else { self.peak - 2.0 * (1.0 + z * z / 3.0).ln() }
    }
}

/// One or several subjects.
#[derive(Clone, Debug)]
pub struct Model {
    markers: usize,
    /// Whose each marker is.
    subject: Vec<usize>,
    terms: Vec<Option<Term>>,
    /// Of each marker: the others of its subject, the most rigid first.
    near: Vec<Vec<usize>>,
    heights: Vec<Vec<(Height, Term)>>,
    /// Largest distance within a subject (m).
    reach: f64,
}

impl Model {
    /// A model of markers. `distances`: row by row, n × n, `None` where nothing is known (as between subjects).
    pub fn new(subject: Vec<usize>, distances: &[Option<Length>], heights: &[Vec<Height>]) -> Self {
        let n = subject.len();
        let farthest = distances.iter().flatten().map(|l| l.mean + 2.0 * l.sd).fold(0.0, f64::max);
        let reach = if farthest > 0.0 { farthest } else { 1.0 };
        let terms: Vec<Option<Term>> = distances.iter().map(|d| d.as_ref().map(|l| Term::new(l, reach))).collect();
        let near = (0..n)
            .map(|m| {
                let mut others: Vec<usize> = (0..n).filter(|&o| o != m && terms[m * n + o].is_some()).collect();
                let sharpness = |o: usize| terms[m * n + o].map_or(f64::NEG_INFINITY, |t| t.peak);
                others.sort_by(|&a, &b| sharpness(b).total_cmp(&sharpness(a)).then(a.cmp(&b)));
                others
            })
            .collect();
        let ready = |h: &Height| (*h, Term::new(&h.length, reach));
        let heights = heights.iter().map(|own| own.iter().map(ready).collect()).collect();
        Self { markers: n, subject, terms, near, heights, reach }
    }

    /// Number of markers.
    pub fn len(&self) -> usize {
        self.markers
    }

    /// Whether there is no marker at all.
    pub fn is_empty(&self) -> bool {
        self.markers == 0
    }

    /// Number of subjects.
    pub fn subjects(&self) -> usize {
        self.subject.iter().max().map_or(0, |m| m + 1)
    }

    /// The markers of a subject.
    pub fn of_subject(&self, subject: usize) -> Vec<usize> {
        (0..self.markers).filter(|&m| self.subject[m] == subject).collect()
    }

    /// The most rigid neighbours of a marker first.
    pub fn near(&self, marker: usize) -> &[usize] {
        &self.near[marker]
    }

    /// Largest distance between two markers of a subject (m).
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// The distance of two markers, where it is known.
    pub fn distance(&self, a: usize, b: usize) -> Option<Length> {
        self.terms[a * self.markers + b].map(|t| Length {
            mean: t.mean,
            sd: 1.0 / t.inverse_sd,
            trust: 1.0 - t.floor.exp(),
        })
    }

    /// Largest evidence that the distance of two markers can give.
    pub fn peak(&self, a: usize, b: usize) -> f64 {
        self.terms[a * self.markers + b].map_or(0.0, |t| t.peak)
    }

    /// Evidence of a distance between two markers.
    pub fn of_distance(&self, a: usize, b: usize, distance: f64) -> f64 {
        self.terms[a * self.markers + b].map_or(0.0, |t| t.evidence(distance))
    }

    /// What is known of a marker's place, given at which points of a frame the others are.
    pub fn around<'a>(
        &'a self,
        marker: usize,
        points: &'a [Vector3<f64>],
        point_of: impl Fn(usize) -> Option<usize>,
    ) -> Around {
        let known = self.near[marker].iter().filter_map(|&other| {
            let term = self.terms[marker * self.markers + other]?;
            Some((term, point_of(other)?))
        });
        let plane = |&(height, term): &(Height, Term)| {
            let [Some(a), Some(b), Some(c)] = height.base.map(&point_of) else { return None };
            let normal = (points[b] - points[a]).cross(&(points[c] - points[a])).try_normalize(1e-6)?;
            Some(Plane { term, base: [a, b, c], normal, offset: normal.dot(&points[a]) })
        };
        // One more each than is used: the marker that is thought to be at the point itself does not speak.
        Around {
            lengths: known.take(NEIGHBOURS + 1).collect(),
            planes: self.heights[marker].iter().filter_map(plane).take(HEIGHTS + 1).collect(),
        }
    }

    /// What would speak for a marker that stood where it should, given which others are known.
    pub fn potential(&self, marker: usize, known: impl Fn(usize) -> bool) -> f64 {
        let near = self.near[marker].iter().filter(|&&o| known(o)).take(NEIGHBOURS);
        let terms = near.filter_map(|&o| self.terms[marker * self.markers + o]);
        let (sum, weight) = terms.fold((0.0, 0.0), |(s, w), t| (s + t.weight * t.peak, w + t.weight));
        if weight > IN_FULL { sum * IN_FULL / weight } else { sum }
    }

    /// Whether a marker stands on its side of the first triangle that is known; `None` without one.
    pub fn is_on_its_side(
        &self,
        marker: usize,
        at: &Vector3<f64>,
        place: impl Fn(usize) -> Option<Vector3<f64>>,
    ) -> Option<bool> {
        self.heights[marker].iter().find_map(|(height, _)| {
            let [Some(a), Some(b), Some(c)] = height.base.map(&place) else { return None };
            height_over(&a, &b, &c, at).map(|h| (h > 0.0) == (height.length.mean > 0.0))
        })
    }
}

struct Plane {
    term: Term,
    base: [usize; 3],
    normal: Vector3<f64>,
    offset: f64,
}

/// What is known of a marker's place: its distances from points, and its heights over planes of points.
pub struct Around {
    lengths: Vec<(Term, usize)>,
    planes: Vec<Plane>,
}

impl Around {
    /// What speaks for the marker at a point: a logarithm of a likelihood ratio. `distance(q)` is how far it is from
    /// another point.
    pub fn evidence(&self, point: usize, at: &Vector3<f64>, distance: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut weight, mut count) = (0.0, 0.0, 0);
        for (term, other) in &self.lengths {
            if *other == point {
                continue;
            }
            sum += term.weight * term.evidence(distance(*other));
            weight += term.weight;
            count += 1;
            if count == NEIGHBOURS || (count == 2 && sum <= HOPELESS) {
                break;
            }
        }
        let counted = if weight > IN_FULL { sum * IN_FULL / weight } else { sum };
        if counted <= 0.0 {
            return counted;
        }
        let over = self.planes.iter().filter(|p| !p.base.contains(&point)).take(HEIGHTS);
        // The right side is no evidence by itself, or markers with triangles would have more of it than others.
        let told = over.map(|p| (p.term.evidence(p.normal.dot(at) - p.offset) - p.term.peak).max(p.term.floor));
        let (sum, count) = told.fold((0.0, 0.0), |(s, n), v| (s + v, n + 1.0));
        if count > 0.0 { counted + sum / count } else { counted }
    }
}

/// Signed height over the plane of three points (m); `None` where they make no plane.
pub fn height_over(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>, at: &Vector3<f64>) -> Option<f64> {
    let normal = (b - a).cross(&(c - a));
    let length = normal.norm();
    (length > 1e-6).then(|| normal.dot(&(at - a)) / length)
}
