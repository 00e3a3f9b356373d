//! What cameras see of markers: projections with everything that goes wrong in a real capture.

use super::body::Capsule;
use super::random::Random;
use crate::camera::Rig;
use nalgebra::Vector3;

/// How views of a marker are withheld beyond real occlusion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hide {
    /// No view is hidden.
    Nothing,
    /// Exactly one random view of each marker is hidden.
    One,
    /// Each view is hidden with this probability.
    Each(f64),
}

/// What is imperfect about the cameras.
#[derive(Clone, Debug)]
pub struct Imperfections {
    /// Standard deviation of the dots (px per axis).
    pub sigma_px: f64,
    /// Views withheld.
    pub hide: Hide,
    /// Dots nearer than this become one, at their mean (px). 0 merges nothing.
    pub merge_px: f64,
    /// False dots per camera and frame, anywhere in the image.
    pub clutter_per_frame: f64,
    /// Fixed reflections per camera.
    pub reflections: usize,
}

/// One simulated dot.
#[derive(Clone, Debug)]
pub struct SeenDot {
    /// Index of the camera.
    pub camera: usize,
    /// Measured pixel.
    pub pixel: [f64; 2],
    /// The markers it comes from: none for clutter, several for a merged blob.
    pub markers: Vec<usize>,
}

/// Dots of one frame in random order within each camera. `capsules` hide what is behind them.
pub fn observe(
    rig: &Rig,
    markers: &[Vector3<f64>],
    capsules: &[Capsule],
    what: &Imperfections,
    seed: u64,
    frame: usize,
) -> Vec<SeenDot> {
    let mut random = Random::new(seed, 2 * frame as u64 + 1);
    let seen: Vec<Vec<bool>> = markers.iter().map(|m| visible_in(rig, m, capsules, what.hide, &mut random)).collect();
    let mut dots = Vec::new();
    for camera in 0..rig.cameras.len() {
        let mut own = Vec::new();
        for (marker, (point, visible)) in markers.iter().zip(&seen).enumerate() {
            let noise = [random.normal(), random.normal()];
            if !visible[camera] {
                continue;
            }
            if let Some(pixel) = rig.cameras[camera].project(point) {
                let pixel = [pixel.x + what.sigma_px * noise[0], pixel.y + what.sigma_px * noise[1]];
                own.push(SeenDot { camera, pixel, markers: vec![marker] });
            }
        }
        merge(&mut own, what.merge_px);
        add_false_dots(rig, camera, what, seed, &mut random, &mut own);
        for i in (1..own.len()).rev() {
            own.swap(i, random.below(i + 1));
        }
        dots.extend(own);
    }
    dots
}

fn visible_in(rig: &Rig, marker: &Vector3<f64>, capsules: &[Capsule], hide: Hide, random: &mut Random) -> Vec<bool> {
    let cameras = rig.cameras.len();
    let hidden = match hide {
        Hide::One => Some(random.below(cameras)),
        Hide::Nothing | Hide::Each(_) => None,
    };
    let mut visible = Vec::with_capacity(cameras);
    for (i, camera) in rig.cameras.iter().enumerate() {
        let withheld = match hide {
            Hide::Each(p) => random.happens(p),
            Hide::Nothing | Hide::One => hidden == Some(i),
        };
        let occluded = || capsules.iter().any(|c| c.hides(marker, &camera.position_m));
        visible.push(!withheld && camera.sees(marker) && !occluded());
    }
    visible
}

/// Joins dots nearer than `merge_px`, chains included, at the mean of their markers' pixels.
fn merge(dots: &mut Vec<SeenDot>, merge_px: f64) {
    let mut i = 0;
    while i < dots.len() {
        let near = |a: &SeenDot, b: &SeenDot| (a.pixel[0] - b.pixel[0]).hypot(a.pixel[1] - b.pixel[1]) < merge_px;
        if let Some(j) = (i + 1..dots.len()).find(|&j| near(&dots[i], &dots[j])) {
            let other = dots.swap_remove(j);
            let (a, b) = (dots[i].markers.len() as f64, other.markers.len() as f64);
            for axis in 0..2 {
                dots[i].pixel[axis] = (a * dots[i].pixel[axis] + b * other.pixel[axis]) / (a + b);
            }
            dots[i].markers.extend(other.markers);
            dots[i].markers.sort_unstable();
        } else {
            i += 1;
        }
    }
}

fn add_false_dots(
    rig: &Rig,
    camera: usize,
    what: &Imperfections,
    seed: u64,
    random: &mut Random,
    dots: &mut Vec<SeenDot>,
) {
    let [width, height] = rig.cameras[camera].size_px;
    let mut place = Random::new(seed ^ 0x5eed_0f1a_0b00, camera as u64);
    for _ in 0..what.reflections {
        let fixed = [place.between(0.0, width - 1.0), place.between(0.0, height - 1.0)];
        let rate = place.between(0.7, 1.0);
        if random.happens(rate) {
            let pixel = fixed.map(|x| x + what.sigma_px * random.normal());
            dots.push(SeenDot { camera, pixel, markers: Vec::new() });
        }
    }
    if what.clutter_per_frame > 0.0 {
        for _ in 0..random.poisson(what.clutter_per_frame) {
            let pixel = [random.between(0.0, width - 1.0), random.between(0.0, height - 1.0)];
            dots.push(SeenDot { camera, pixel, markers: Vec::new() });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::{cloud, rigs};

    fn perfect() -> Imperfections {
        Imperfections { sigma_px: 0.0, hide: Hide::Nothing, merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 }
    }

    #[test]
    fn without_imperfections_every_dot_is_the_projection_of_its_marker() {
        let rig = rigs::ring(4, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0);
        let markers = cloud(1, 0, 20, &Vector3::new(0.5, 0.5, 0.5), &Vector3::zeros());
        let dots = observe(&rig, &markers, &[], &perfect(), 1, 0);
        assert_eq!(dots.len(), 80);
        for dot in dots {
            let pixel = rig.cameras[dot.camera].project(&markers[dot.markers[0]]).unwrap();
            assert!((pixel.x - dot.pixel[0]).abs() < 1e-12 && (pixel.y - dot.pixel[1]).abs() < 1e-12);
        }
    }

    #[test]
    fn one_hidden_view_leaves_exactly_three_of_four() {
        let rig = rigs::ring(4, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0);
        let markers = cloud(2, 0, 33, &Vector3::new(0.5, 0.5, 0.5), &Vector3::zeros());
        let dots = observe(&rig, &markers, &[], &Imperfections { hide: Hide::One, ..perfect() }, 2, 0);
        for marker in 0..33 {
            assert_eq!(dots.iter().filter(|d| d.markers == [marker]).count(), 3);
        }
    }

    #[test]
    fn merged_dots_name_all_their_markers() {
        let rig = rigs::ring(2, 2.0, 0.0, 0.0, [640.0, 480.0], 757.0);
        let close = [Vector3::zeros(), Vector3::new(0.0, 0.0, 0.001)];
        let dots = observe(&rig, &close, &[], &Imperfections { merge_px: 3.0, ..perfect() }, 3, 0);
        assert_eq!(dots.len(), 2);
        assert!(dots.iter().all(|d| d.markers == [0, 1]));
    }

    #[test]
    fn a_capsule_between_marker_and_camera_hides_it() {
        let rig = rigs::ring(2, 2.0, 0.0, 0.0, [640.0, 480.0], 757.0);
        let wall = Capsule { ends_m: [Vector3::new(0.5, 0.0, -0.5), Vector3::new(0.5, 0.0, 0.5)], radius_m: 0.1 };
        let dots = observe(&rig, &[Vector3::zeros()], &[wall], &perfect(), 4, 0);
        assert_eq!(dots.iter().map(|d| d.camera).collect::<Vec<_>>(), [1]);
    }
}
