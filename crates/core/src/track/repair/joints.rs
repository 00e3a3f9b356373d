//! Joint centres as markers that no camera sees.
//!
//! A marker on the upper arm turns about a point that stands still in the thorax: in the frame of three or more rigidly
//! linked markers its places lie on a sphere (Gamage & Lasenby 2002, algebraic fit; about a hinge any point of the axis
//! will do). The centre is rigidly linked to both parts, so it tells the markers of a limb apart where no visible marker
//! can; and with a segment's two markers it makes a frame for the next joint.

use crate::track::body::rotation::align;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Positions of one marker by frame.
pub type Path = Vec<Option<Vector3<f64>>>;

/// Frames from which shapes and spheres are fitted.
const FRAMES: usize = 900;
/// Frames that two markers must share to be compared.
const SHARED: usize = 15;
/// Spread of a distance that is rigid, beyond noise (m).
const RIGID: f64 = 0.002;
/// Longest distance within a part of the body (m).
const LONGEST: f64 = 0.6;
/// Members of a frame at most.
const MEMBERS: usize = 5;
/// Smallest second extent of the members, of the arc that a marker must have moved, and the largest radius (m).
const SMALLEST_FRAME: f64 = 0.015;
const SMALLEST_ARC: f64 = 0.025;
const LARGEST_RADIUS: f64 = 0.6;
/// Share of places that must lie on the sphere.
const ON_SPHERE: f64 = 0.85;
/// Centres nearer to each other than this are one joint (m).
const SAME_JOINT: f64 = 0.02;
/// Standard deviation in its least certain direction that a centre may have (m), and how many neighbouring places say the
/// same.
const UNCERTAIN: f64 = 0.006;
const REPEATS: f64 = 5.0;
/// Chains of joints that are followed: shoulder, elbow, wrist.
const LEVELS: usize = 3;

/// Paths of joint centres. `markers` make the frames of reference; `pieces` are what turns about their joints: parts of
/// paths, each beyond doubt of one marker, whichever that is. `noise_m`, `pieces_noise_m`: standard deviations per axis.
pub fn joint_centers(markers: &[Path], noise_m: &[f64], pieces: &[Path], pieces_noise_m: &[f64]) -> Vec<Path> {
    let mut paths: Vec<Path> = markers.to_vec();
    let mut noise = noise_m.to_vec();
    let mut used_frames: Vec<Vec<usize>> = Vec::new();
    for _ in 0..LEVELS {
        let known = paths.len();
        for members in frames_of_reference(&paths, &noise) {
            if used_frames.contains(&members) {
                continue;
            }
            let joints = (markers.len()..known).filter(|j| !members.contains(j)).map(|j| (&paths[j], noise[j]));
            let turning = pieces.iter().zip(pieces_noise_m.iter().copied()).chain(joints);
            let centers = centers_about(&paths, &members, turning);
            used_frames.push(members);
            for center in centers {
                if !paths[markers.len()..].iter().any(|known| same(known, &center)) {
                    paths.push(center);
                    noise.push(RIGID);
                }
            }
        }
        if paths.len() == known {
            break;
        }
    }
    paths.split_off(markers.len())
}

/// Whether two centres are one: near each other in most of the frames that they share.
fn same(a: &Path, b: &Path) -> bool {
    let apart: Vec<f64> = sample(a.len()).filter_map(|f| Some((a[f]? - b[f]?).norm())).collect();
    let near = apart.iter().filter(|d| **d < SAME_JOINT).count();
    2 * near > apart.len()
}

fn sample(frames: usize) -> impl Iterator<Item = usize> {
    let step = frames.div_ceil(FRAMES).max(1);
    (0..frames).step_by(step)
}

/// Median and spread (from the median deviation) of a distance; `None` with too few common frames.
fn distance(a: &Path, b: &Path) -> Option<(f64, f64)> {
    let mut found: Vec<f64> = sample(a.len()).filter_map(|f| Some((a[f]? - b[f]?).norm())).collect();
    if found.len() < SHARED {
        return None;
    }
    found.sort_unstable_by(f64::total_cmp);
    let median = found[found.len() / 2];
    let mut off: Vec<f64> = found.iter().map(|d| (d - median).abs()).collect();
    off.sort_unstable_by(f64::total_cmp);
    Some((median, 1.48 * off[off.len() / 2]))
}

/// Sets of mutually rigid paths, each path in at most two sets: as the part it is on, and as the joint it turns about.
fn frames_of_reference(paths: &[Path], noise: &[f64]) -> Vec<Vec<usize>> {
    let n = paths.len();
    let mut rigid = vec![false; n * n];
    for a in 0..n {
        for b in a + 1..n {
            if let Some((length, spread)) = distance(&paths[a], &paths[b]) {
                let least = (RIGID * RIGID + 2.0 * (noise[a].powi(2) + noise[b].powi(2))).sqrt();
                rigid[a * n + b] = length < LONGEST && length > 0.01 && spread < least;
                rigid[b * n + a] = rigid[a * n + b];
            }
        }
    }
    let presence = |a: &usize| paths[*a].iter().flatten().count();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_key(|a| (std::cmp::Reverse(presence(a)), *a));
    let mut sets: Vec<Vec<usize>> = Vec::new();
    for &a in &order {
        let mut set = vec![a];
        for &b in &order {
            if set.len() < MEMBERS && b != a && set.iter().all(|&m| rigid[m * n + b]) {
                set.push(b);
            }
        }
        set.sort_unstable();
        if set.len() >= 3 && !sets.contains(&set) {
            sets.push(set);
        }
    }
    sets
}

/// Pose of a frame of reference: rotation from world to local, and its origin in the world.
type Pose = (Rotation3<f64>, Vector3<f64>);

/// The pose of the members in each frame in which three or more are seen, by their mean shape.
fn poses(paths: &[Path], members: &[usize]) -> Option<Vec<Option<Pose>>> {
    let frames = paths[members[0]].len();
    let weights = vec![1.0; members.len()];
    let seen = |f: usize| -> Vec<(usize, Vector3<f64>)> {
        members.iter().enumerate().filter_map(|(i, &m)| paths[m][f].map(|p| (i, p))).collect()
    };
    let all = |f: usize| -> Option<Vec<Vector3<f64>>> {
        (seen(f).len() == members.len()).then(|| seen(f).into_iter().map(|(_, p)| p).collect())
    };
    let mut shape: Vec<Vector3<f64>> = about_mean(&(0..frames).find_map(all)?).1;
    for _ in 0..2 {
        let mut sum = vec![Vector3::zeros(); members.len()];
        let (mut count, mut guess) = (0.0, Rotation3::identity());
        for points in sample(frames).filter_map(all) {
            let (_, points) = about_mean(&points);
            guess = align(&points, &shape, &weights, guess);
            sum.iter_mut().zip(&points).for_each(|(s, p)| *s += guess * p);
            count += 1.0;
        }
        shape = sum.into_iter().map(|s| s / f64::max(count, 1.0)).collect();
    }
    if second_extent(&shape) < SMALLEST_FRAME {
        return None;
    }
    let mut guess = Rotation3::identity();
    let pose = |f: usize| {
        let (own, points): (Vec<usize>, Vec<Vector3<f64>>) = seen(f).into_iter().unzip();
        if points.len() < 3 {
            return None;
        }
        let (center, points) = about_mean(&points);
        let (offset, part) = about_mean(&own.iter().map(|&i| shape[i]).collect::<Vec<_>>());
        if second_extent(&part) < SMALLEST_FRAME {
            return None;
        }
        guess = align(&points, &part, &weights[..points.len()], guess);
        Some((guess, center - guess.inverse() * offset))
    };
    Some((0..frames).map(pose).collect())
}

/// The mean of points, and the points relative to it.
fn about_mean(points: &[Vector3<f64>]) -> (Vector3<f64>, Vec<Vector3<f64>>) {
    let mean = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    (mean, points.iter().map(|p| p - mean).collect())
}

/// Second largest extent of points about their mean (m, standard deviation).
fn second_extent(points: &[Vector3<f64>]) -> f64 {
    let n = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / n;
    let moments = points.iter().fold(Matrix3::zeros(), |m, p| m + (p - mean) * (p - mean).transpose());
    let mut values: [f64; 3] = moments.symmetric_eigenvalues().into();
    values.sort_unstable_by(f64::total_cmp);
    (values[1].max(0.0) / n).sqrt()
}

/// Joint centres of what turns about this frame of reference (paths with their noise). The arcs that turn about one centre
/// are fitted together.
fn centers_about<'a>(paths: &[Path], members: &[usize], turning: impl Iterator<Item = (&'a Path, f64)>) -> Vec<Path> {
    let Some(poses) = poses(paths, members) else { return Vec::new() };
    let mut arcs: Vec<Arc> = Vec::new();
    for (path, noise) in turning {
        let places: Vec<Vector3<f64>> = sample(poses.len())
            .filter_map(|f| poses[f].and_then(|(turn, center)| path[f].map(|p| turn * (p - center))))
            .collect();
        let arc = Arc { places, tolerance_m: 2.0 * RIGID + 2.0 * noise };
        if arc.places.len() < SHARED || second_extent(&arc.places) < SMALLEST_ARC {
            continue;
        }
        if fitted(&[&arc]).is_some_and(|fit| arc.lies_about(&fit.center)) {
            arcs.push(arc);
        }
    }
    let path =
        |center: Vector3<f64>| poses.iter().map(|p| p.map(|(turn, origin)| origin + turn.inverse() * center)).collect();
    agreed(arcs).into_iter().map(path).collect()
}

/// A marker's places in the frame of reference.
struct Arc {
    places: Vec<Vector3<f64>>,
    tolerance_m: f64,
}

impl Arc {
    /// Whether the places lie on a sphere about a centre.
    fn lies_about(&self, center: &Vector3<f64>) -> bool {
        let mut radii: Vec<f64> = self.places.iter().map(|p| (p - center).norm()).collect();
        radii.sort_unstable_by(f64::total_cmp);
        let radius = radii[radii.len() / 2];
        let on = radii.iter().filter(|r| (*r - radius).abs() < self.tolerance_m).count();
        radius < LARGEST_RADIUS && on as f64 > ON_SPHERE * self.places.len() as f64
    }
}

/// The centres on which arcs agree, from the best determined arc to the least.
fn agreed(mut arcs: Vec<Arc>) -> Vec<Vector3<f64>> {
    let uncertainty = |a: &Arc| fitted(&[a]).map_or(f64::INFINITY, |f| f.uncertainty_m);
    arcs.sort_by(|a, b| uncertainty(a).total_cmp(&uncertainty(b)));
    let mut centers = Vec::new();
    while !arcs.is_empty() {
        let Some(mut fit) = fitted(&[&arcs[0]]) else { break };
        let mut kept = vec![0];
        for i in 1..arcs.len() {
            if arcs[i].lies_about(&fit.center) || fit.uncertainty_m > UNCERTAIN {
                let with: Vec<&Arc> = kept.iter().chain([&i]).map(|&k| &arcs[k]).collect();
                if let Some(better) = fitted(&with).filter(|f| with.iter().all(|a| a.lies_about(&f.center))) {
                    fit = better;
                    kept.push(i);
                }
            }
        }
        if fit.uncertainty_m < UNCERTAIN {
            centers.push(fit.center);
        }
        let mut index = 0;
        arcs.retain(|_| {
            index += 1;
            !kept.contains(&(index - 1))
        });
    }
    centers
}

/// A fitted centre.
struct Center {
    center: Vector3<f64>,
    uncertainty_m: f64,
}

/// |p|² = 2 c·p + k with one c for all arcs and one k for each, taken out by centring; a hair of damping along
/// directions in which nothing moves. `None` without places.
fn fitted(arcs: &[&Arc]) -> Option<Center> {
    let mut matrix = Matrix3::zeros();
    let mut right = Vector3::zeros();
    let (mut sum, mut count): (Vector3<f64>, f64) = (Vector3::zeros(), 0.0);
    let mean_of = |a: &Arc| a.places.iter().sum::<Vector3<f64>>() / a.places.len() as f64;
    for arc in arcs {
        sum += arc.places.iter().sum::<Vector3<f64>>();
        count += arc.places.len() as f64;
    }
    let origin = sum / count.max(1.0);
    for arc in arcs {
        let mean = mean_of(arc) - origin;
        let n = arc.places.len() as f64;
        let mean_square = arc.places.iter().map(|p| (p - origin).norm_squared()).sum::<f64>() / n;
        for p in &arc.places {
            let d = p - origin;
            let off = d - mean;
            matrix += off * off.transpose() * 2.0;
            right += off * (d.norm_squared() - mean_square);
        }
    }
    matrix += Matrix3::identity() * (1e-8 * count);
    let inverse = (count > 0.0).then(|| matrix.try_inverse()).flatten()?;
    let center = origin + inverse * right;
    // d |p|² = 2 r dr: the residuals of the linear equations are 2 r times those of the radius.
    let noise: f64 = arcs.iter().map(|a| a.tolerance_m).fold(0.0, f64::max) * (mean_of(arcs[0]) - center).norm();
    let largest = inverse.symmetric_eigenvalues().max().max(0.0);
    Some(Center { center, uncertainty_m: (2.0 * noise * noise * largest * REPEATS).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::random::Random;

    fn ball_joint(noise_m: f64) -> (Vec<Path>, Vec<Vector3<f64>>) {
        let mut random = Random::new(5, 0);
        let trunk = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.25, 0.0]].map(Vector3::from);
        let arm = [[0.0, 0.05, -0.1], [0.03, -0.02, -0.2]].map(Vector3::from);
        let shoulder = Vector3::new(0.25, 0.1, 0.3);
        let mut paths = vec![Vec::new(); 5];
        let mut truth = Vec::new();
        for f in 0..300 {
            let t = f64::from(f) * 0.01;
            let body = Rotation3::from_euler_angles(0.2 * t, 0.3 * (2.0 * t).sin(), t);
            let turn = Rotation3::from_euler_angles((3.0 * t).sin(), 0.8 * (2.3 * t).cos(), 0.3 * t);
            let place = Vector3::new(t, 0.3 * t, 1.0);
            let mut see = |p: Vector3<f64>| {
                let n = Vector3::new(random.normal(), random.normal(), random.normal()) * noise_m;
                Some(place + body * p + n)
            };
            (0..3).for_each(|i| paths[i].push(see(trunk[i])));
            (0..2).for_each(|i| paths[3 + i].push(see(shoulder + turn * arm[i])));
            truth.push(place + body * shoulder);
        }
        (paths, truth)
    }

    #[test]
    fn a_shoulder_is_found_exactly_without_noise_and_well_with_it() {
        // With noise, the frame's turn alone moves a centre 0.35 m away by about 1.5 mm.
        for (noise_m, tolerance_m) in [(0.0, 1e-4), (0.0005, 0.003)] {
            let (paths, truth) = ball_joint(noise_m);
            let found = joint_centers(&paths, &[noise_m; 5], &paths, &[noise_m; 5]);
            let rms = |path: &Path| {
                let squares = path.iter().zip(&truth).map(|(p, t)| p.map_or(1.0, |p| (p - t).norm_squared()));
                (squares.sum::<f64>() / truth.len() as f64).sqrt()
            };
            let best = found.iter().map(rms).fold(f64::INFINITY, f64::min);
            assert!(best < tolerance_m, "{best} m off with noise {noise_m}");
        }
    }

    #[test]
    fn a_marker_that_moves_freely_gives_no_joint() {
        let (mut paths, _) = ball_joint(0.0);
        let mut random = Random::new(9, 0);
        paths.truncate(3);
        let mut at = Vector3::new(0.4, 0.0, 1.0);
        let free = (0..300).map(|_| {
            at += random.in_box(&Vector3::repeat(0.05));
            Some(at)
        });
        paths.push(free.collect());
        assert!(joint_centers(&paths, &[0.0; 4], &paths, &[0.0; 4]).is_empty());
    }
}
