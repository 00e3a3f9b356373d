//! Joint centres as markers that no camera sees.
//!
//! A marker on the upper arm turns about a point that stands still in the thorax: in the frame of three or more rigidly
//! linked markers its places lie on a sphere (Gamage & Lasenby 2002, algebraic fit; about a hinge any point of the axis
//! will do). The centre is rigidly linked to both parts, so it tells the markers of a limb apart where no visible marker
//! can; and with a segment's two markers it makes a frame for the next joint.

use crate::track::body::rotation::align;
use nalgebra::{Matrix4, Rotation3, Vector3, Vector4};

/// Positions of one marker by frame.
pub type Path = Vec<Option<Vector3<f64>>>;

/// Frames from which shapes and spheres are fitted.
const FRAMES: usize = 400;
/// Frames that two markers must share to be compared.
const SHARED: usize = 40;
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
/// Chains of joints that are followed: shoulder, elbow, wrist.
const LEVELS: usize = 3;

/// Paths of joint centres. `noise_m`: standard deviation of each marker's places per axis.
pub fn joint_centers(markers: &[Path], noise_m: &[f64]) -> Vec<Path> {
    let mut paths: Vec<Path> = markers.to_vec();
    let mut noise = noise_m.to_vec();
    let mut used_frames: Vec<Vec<usize>> = Vec::new();
    for _ in 0..LEVELS {
        let known = paths.len();
        for members in frames_of_reference(&paths, &noise) {
            if used_frames.contains(&members) {
                continue;
            }
            let centers = centers_about(&paths, &noise, &members, known);
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

/// Pose of a frame of reference: rotation from world to local, and the centroid.
type Pose = (Rotation3<f64>, Vector3<f64>);

/// The members' mean shape and their pose in each frame in which all are seen.
fn poses(paths: &[Path], members: &[usize]) -> Option<Vec<Option<Pose>>> {
    let frames = paths[members[0]].len();
    let at = |f: usize| -> Option<(Vector3<f64>, Vec<Vector3<f64>>)> {
        let points: Vec<Vector3<f64>> = members.iter().map(|&m| paths[m][f]).collect::<Option<_>>()?;
        let center = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        Some((center, points.iter().map(|p| p - center).collect()))
    };
    let weights = vec![1.0; members.len()];
    let mut shape = (0..frames).find_map(at)?.1;
    for _ in 0..2 {
        let mut sum = vec![Vector3::zeros(); members.len()];
        let (mut count, mut guess) = (0.0, Rotation3::identity());
        for (_, points) in sample(frames).filter_map(at) {
            guess = align(&points, &shape, &weights, guess);
            sum.iter_mut().zip(&points).for_each(|(s, p)| *s += guess * p);
            count += 1.0;
        }
        shape = sum.into_iter().map(|s| s / count).collect();
    }
    let second = second_extent(&shape);
    if second < SMALLEST_FRAME {
        return None;
    }
    let mut guess = Rotation3::identity();
    let pose = |f: usize| {
        let (center, points) = at(f)?;
        guess = align(&points, &shape, &weights, guess);
        Some((guess, center))
    };
    Some((0..frames).map(pose).collect())
}

/// Second largest extent of points about their mean (m, standard deviation).
fn second_extent(points: &[Vector3<f64>]) -> f64 {
    let n = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / n;
    let moments = points.iter().fold(nalgebra::Matrix3::zeros(), |m, p| m + (p - mean) * (p - mean).transpose());
    let mut values: [f64; 3] = moments.symmetric_eigenvalues().into();
    values.sort_unstable_by(f64::total_cmp);
    (values[1].max(0.0) / n).sqrt()
}

/// Joint centres of the markers that turn about this frame of reference.
fn centers_about(paths: &[Path], noise: &[f64], members: &[usize], known: usize) -> Vec<Path> {
    let Some(poses) = poses(paths, members) else { return Vec::new() };
    let mut centers: Vec<(Vector3<f64>, f64)> = Vec::new();
    for marker in (0..known).filter(|m| !members.contains(m)) {
        let local: Vec<Vector3<f64>> = sample(poses.len())
            .filter_map(|f| poses[f].and_then(|(turn, center)| paths[marker][f].map(|p| turn * (p - center))))
            .collect();
        if local.len() >= SHARED
            && second_extent(&local) > SMALLEST_ARC
            && let Some(center) = sphere(&local, 2.0 * RIGID + 2.0 * noise[marker])
        {
            let weight = local.len() as f64 * second_extent(&local);
            match centers.iter_mut().find(|(c, _)| (*c - center).norm() < SAME_JOINT) {
                Some((c, w)) => {
                    *c += (center - *c) * (weight / (*w + weight));
                    *w += weight;
                }
                None => centers.push((center, weight)),
            }
        }
    }
    let path = |(center, _): &(Vector3<f64>, f64)| {
        poses.iter().map(|p| p.map(|(turn, origin)| origin + turn.inverse() * center)).collect()
    };
    centers.iter().map(path).collect()
}

/// Centre of the sphere on which places lie; `None` if too many lie off it. Places off it are left out of a second fit.
fn sphere(places: &[Vector3<f64>], tolerance_m: f64) -> Option<Vector3<f64>> {
    let mut center = algebraic(places)?;
    for _ in 0..3 {
        let mut radii: Vec<f64> = places.iter().map(|p| (p - center).norm()).collect();
        radii.sort_unstable_by(f64::total_cmp);
        let radius = radii[radii.len() / 2];
        let on: Vec<Vector3<f64>> =
            places.iter().filter(|p| ((*p - center).norm() - radius).abs() < 3.0 * tolerance_m).copied().collect();
        if (on.len() as f64) < 0.6 * places.len() as f64 {
            return None;
        }
        center = algebraic(&on)?;
    }
    let mut radii: Vec<f64> = places.iter().map(|p| (p - center).norm()).collect();
    radii.sort_unstable_by(f64::total_cmp);
    let radius = radii[radii.len() / 2];
    let on = radii.iter().filter(|r| (*r - radius).abs() < tolerance_m).count();
    (radius < LARGEST_RADIUS && on as f64 > ON_SPHERE * places.len() as f64).then_some(center)
}

/// |p|² = 2 c·p + k about the mean, with a hair of damping along directions in which the places do not move.
fn algebraic(places: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let n = places.len() as f64;
    let mean = places.iter().sum::<Vector3<f64>>() / n;
    let mut matrix = Matrix4::zeros();
    let mut right = Vector4::zeros();
    for p in places {
        let d = p - mean;
        let row = Vector4::new(2.0 * d.x, 2.0 * d.y, 2.0 * d.z, 1.0);
        matrix += row * row.transpose();
        right += row * d.norm_squared();
    }
    let damping = 1e-5 * n;
    for i in 0..3 {
        matrix[(i, i)] += damping;
    }
    let solved = matrix.try_inverse()? * right;
    Some(mean + solved.xyz())
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
        for (noise_m, tolerance) in [(0.0, 1e-4), (0.0005, 0.005)] {
            let (paths, truth) = ball_joint(noise_m);
            let found = joint_centers(&paths, &[noise_m; 5]);
            let off = |path: &Path| {
                path.iter().zip(&truth).map(|(p, t)| p.map_or(1.0, |p| (p - t).norm())).fold(0.0, f64::max)
            };
            let best = found.iter().map(off).fold(f64::INFINITY, f64::min);
            assert!(best < tolerance, "{best} m off with noise {noise_m}");
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
        assert!(joint_centers(&paths, &[0.0; 4]).is_empty());
    }
}
