//! Correspondence on simulated takes: exact without noise, the expected figures with noise, and the properties that
//! must hold whatever the scene.

use markerloom_core::camera::Rig;
use markerloom_core::correspond::enumerate::{Candidates, EnumerateOptions, enumerate};
use markerloom_core::correspond::frame::{Dot, PreparedFrame};
use markerloom_core::correspond::packing::pack;
use markerloom_core::correspond::pairs::PairGraph;
use markerloom_core::correspond::scene::{Scene, SceneModel};
use markerloom_core::correspond::{Correspondence, Method};
use markerloom_core::reconstruct::{ReconstructError, ReconstructOptions, estimate_model, reconstruct};
use markerloom_core::synth::observe::{Hide, Imperfections, SeenDot, observe};
use markerloom_core::synth::{cloud, rigs};
use nalgebra::{Rotation3, Vector3};
use proptest::prelude::*;

const BOX_M: Vector3<f64> = Vector3::new(0.497_843, 0.788_865, 0.748_485);

struct Take {
    rig: Rig,
    truth: Vec<Vec<Vector3<f64>>>,
    seen: Vec<Vec<SeenDot>>,
    dots: Vec<Vec<Dot>>,
}

fn simulate(rig: Rig, markers: usize, frames: usize, what: &Imperfections) -> Take {
    let truth: Vec<_> = (0..frames).map(|f| cloud(11, f, markers, &BOX_M, &Vector3::zeros())).collect();
    let seen: Vec<_> = truth.iter().enumerate().map(|(f, m)| observe(&rig, m, &[], what, 11, f)).collect();
    let dot = |d: &SeenDot| Dot { camera: d.camera, pixel: d.pixel, sigma: 1.0, hardware: None };
    let dots = seen.iter().map(|f| f.iter().map(dot).collect()).collect();
    Take { rig, truth, seen, dots }
}

fn exp61(frames: usize, sigma_px: f64, hide: Hide) -> Take {
    let what = Imperfections { sigma_px, hide, merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 };
    simulate(rigs::ring(4, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0), 33, frames, &what)
}

impl Take {
    fn views(&self) -> Vec<&[Dot]> {
        self.dots.iter().map(Vec::as_slice).collect()
    }

    fn model(&self) -> SceneModel {
        estimate_model(&self.rig, &self.views(), &ReconstructOptions::default()).unwrap()
    }

    fn solve(&self, method: Method) -> Vec<Correspondence> {
        let options = ReconstructOptions { method, ..ReconstructOptions::default() };
        reconstruct(&self.rig, &self.views(), &self.model(), &options)
    }

    /// Shares of markers with a point within a distance, and of points without a marker.
    fn score(&self, solved: &[Correspondence], within_m: f64) -> (f64, f64) {
        let (mut markers, mut found, mut points, mut ghosts) = (0.0, 0.0, 0.0, 0.0);
        for (one, truth) in solved.iter().zip(&self.truth) {
            let near = |a: &Vector3<f64>, b: &Vector3<f64>| (a - b).norm() <= within_m;
            markers += truth.len() as f64;
            found += truth.iter().filter(|m| one.groups.iter().any(|g| near(m, &g.point))).count() as f64;
            points += one.groups.len() as f64;
            ghosts += one.groups.iter().filter(|g| !truth.iter().any(|m| near(m, &g.point))).count() as f64;
        }
        (found / markers, ghosts / points)
    }
}

#[test]
fn without_noise_every_group_is_exactly_one_marker() {
    let take = exp61(5, 0.0, Hide::One);
    for (one, seen) in take.solve(Method::Optimal).iter().zip(&take.seen) {
        assert!(one.certified);
        assert_eq!(one.groups.len(), 33);
        for group in &one.groups {
            assert_eq!(group.dots.len(), 3);
            assert!(group.dots.iter().all(|&d| seen[d].markers == seen[group.dots[0]].markers));
        }
    }
    let (found, ghosts) = take.score(&take.solve(Method::Optimal), 1e-6);
    assert_eq!((found, ghosts), (1.0, 0.0));
}

#[test]
fn the_papers_experiment_is_solved_and_certified() {
    let take = exp61(60, 2.0, Hide::One);
    let solved = take.solve(Method::Optimal);
    let (found, ghosts) = take.score(&solved, 0.03);
    assert!(found >= 0.998, "{found}");
    assert!(ghosts <= 0.001, "{ghosts}");
    assert!(solved.iter().all(|s| s.certified));
}

#[test]
fn relaxation_reaches_the_papers_figure() {
    let take = exp61(60, 2.0, Hide::One);
    let (found, _) = take.score(&take.solve(Method::Relaxation), 0.03);
    assert!(found >= 0.99, "{found}");
}

#[test]
fn every_epipolar_match_is_a_point() {
    let take = exp61(3, 0.5, Hide::Nothing);
    let (found, ghosts) = take.score(&take.solve(Method::Epipolar), 0.03);
    assert!(found > 0.999 && ghosts > 0.2, "{found} {ghosts}");
}

#[test]
fn the_noise_of_each_camera_is_estimated_from_the_take() {
    let what =
        Imperfections { sigma_px: 0.0, hide: Hide::Each(0.2), merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 };
    let mut take = simulate(rigs::ring(8, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0), 33, 40, &what);
    let mut random = markerloom_core::synth::random::Random::new(5, 5);
    let true_noise = [0.2, 0.4, 0.8, 0.3, 0.3, 0.2, 0.5, 0.4];
    for dot in take.dots.iter_mut().flatten() {
        for axis in 0..2 {
            dot.pixel[axis] += true_noise[dot.camera] * random.normal();
        }
    }
    for (estimated, truth) in take.model().noise.iter().zip(true_noise) {
        assert!(
            (estimated / truth - 1.0).abs() < 0.1,
            "{estimated} for {truth}: {:?} {:?}",
            take.model().noise,
            take.model().tail
        );
    }
}

#[test]
fn a_take_with_few_two_view_markers_and_one_with_many_both_keep_them() {
    let take = exp61(40, 1.0, Hide::Each(0.45));
    let (_, ghosts) = take.score(&take.solve(Method::Optimal), 0.03);
    let seen_twice = |f: usize, m: usize| take.seen[f].iter().filter(|d| d.markers == [m]).count() >= 2;
    let solved = take.solve(Method::Optimal);
    let (mut wanted, mut found) = (0, 0);
    for (f, one) in solved.iter().enumerate() {
        for (_, place) in take.truth[f].iter().enumerate().filter(|(m, _)| seen_twice(f, *m)) {
            wanted += 1;
            found += usize::from(one.groups.iter().any(|g| (g.point - place).norm() < 0.02));
        }
    }
    let share = f64::from(found as u32) / f64::from(wanted as u32);
    assert!(share > 0.95 && ghosts < 0.05, "{share} {ghosts}");
}

#[test]
fn clutter_and_fixed_reflections_make_no_points() {
    let what =
        Imperfections { sigma_px: 0.3, hide: Hide::Each(0.1), merge_px: 0.0, clutter_per_frame: 5.0, reflections: 5 };
    let rig = rigs::ring(8, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0);
    let take = simulate(rig, 5, 40, &what);
    let (found, ghosts) = take.score(&take.solve(Method::Optimal), 0.005);
    assert!(found > 0.999 && ghosts < 0.005, "{found} {ghosts}");
    assert!(take.model().reflections.iter().map(Vec::len).sum::<usize>() >= 30);
}

#[test]
fn views_of_many_cameras_stay_one_point_each() {
    let what =
        Imperfections { sigma_px: 0.3, hide: Hide::Each(0.25), merge_px: 0.0, clutter_per_frame: 0.5, reflections: 0 };
    let rig = rigs::ring(16, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0);
    let take = simulate(rig, 60, 6, &what);
    let solved = take.solve(Method::Optimal);
    assert_eq!(take.score(&solved, 0.005), (1.0, 0.0));
    assert!(solved.iter().all(|s| s.groups.len() == 60));
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let take = exp61(30, 2.0, Hide::Each(0.25));
    let model = take.model();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let solved = pool.install(|| reconstruct(&take.rig, &take.views(), &model, &ReconstructOptions::default()));
        format!("{solved:?}")
    };
    assert_eq!(run(1), run(2));
    assert_eq!(run(1), run(7));
}

#[test]
fn the_order_of_dots_does_not_matter() {
    let mut take = exp61(10, 1.0, Hide::One);
    let points = |take: &Take, model: &SceneModel| {
        let solved = reconstruct(&take.rig, &take.views(), model, &ReconstructOptions::default());
        let mut all: Vec<[i64; 3]> = solved
            .iter()
            .flat_map(|s| s.groups.iter().map(|g| g.point.map(|v| (v * 1e7).round() as i64).into()))
            .collect();
        all.sort_unstable();
        all
    };
    let model = take.model();
    let before = points(&take, &model);
    take.dots.iter_mut().for_each(|f| f.reverse());
    assert_eq!(points(&take, &model), before);
}

#[test]
fn moving_the_world_moves_the_points_and_changes_no_group() {
    let take = exp61(10, 0.3, Hide::One);
    let turn = *Rotation3::from_euler_angles(0.4, -0.7, 1.1).matrix();
    let shift = Vector3::new(3.0, -2.0, 0.5);
    let mut moved = take.rig.clone();
    for camera in &mut moved.cameras {
        camera.position_m = turn * camera.position_m + shift;
        camera.camera_from_world *= turn.transpose();
    }
    let options = ReconstructOptions::default();
    let model = estimate_model(&moved, &take.views(), &options).unwrap();
    let there = reconstruct(&moved, &take.views(), &model, &options);
    for (a, b) in take.solve(Method::Optimal).iter().zip(&there) {
        assert_eq!(a.groups.len(), b.groups.len());
        for (g, h) in a.groups.iter().zip(&b.groups) {
            assert_eq!(g.dots, h.dots);
            assert!((turn * g.point + shift - h.point).norm() < 1e-3);
        }
    }
}

#[test]
fn two_cameras_on_a_bar_see_what_is_far_before_them() {
    let eye = |i: usize, x: f64| {
        rigs::looking_at(i, Vector3::new(x, -2.0, 0.0), Vector3::new(0.1 * x, 0.0, 0.0), [1280.0, 1024.0], 1200.0)
    };
    let what =
        Imperfections { sigma_px: 0.1, hide: Hide::Nothing, merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 };
    let take = simulate(Rig { cameras: vec![eye(0, -0.25), eye(1, 0.25)] }, 8, 20, &what);
    let (found, _) = take.score(&take.solve(Method::Optimal), 0.01);
    assert!(found > 0.95, "{found}");
}

#[test]
fn rigs_that_cannot_give_a_depth_are_refused_by_name() {
    let take = exp61(2, 1.0, Hide::Nothing);
    let one = Rig { cameras: take.rig.cameras[..1].to_vec() };
    let error = estimate_model(&one, &[], &ReconstructOptions::default()).unwrap_err();
    assert_eq!(error, ReconstructError::TooFewCameras(1));
    let same = Rig { cameras: vec![take.rig.cameras[0].clone(), take.rig.cameras[0].clone()] };
    let error = estimate_model(&same, &[], &ReconstructOptions::default()).unwrap_err();
    assert_eq!(error, ReconstructError::NothingInCommon);
}

#[test]
fn the_epipolar_index_misses_no_pair() {
    let take = exp61(3, 2.0, Hide::Nothing);
    let model = take.model();
    let scene = Scene::new(&take.rig, &model);
    let frame = PreparedFrame::new(&scene, &take.dots[0]);
    let graph = PairGraph::new(&scene, &frame);
    let mut true_pairs = 0;
    for a in 0..frame.len() {
        for b in a + 1..frame.len() {
            let (da, db) = (&take.seen[0][frame.input_index[a]], &take.seen[0][frame.input_index[b]]);
            if da.markers == db.markers && da.camera != db.camera {
                assert!(
                    graph.linked(a as u32, b as u32),
                    "marker {:?} in cameras {} {}",
                    da.markers,
                    da.camera,
                    db.camera
                );
                true_pairs += 1;
            }
        }
    }
    assert_eq!(true_pairs, 33 * 6);
}

/// All choices of disjoint groups, by brute force.
fn brute_force(candidates: &Candidates, from: usize, used: u64) -> f64 {
    if from == candidates.len() {
        return 0.0;
    }
    let without = brute_force(candidates, from + 1, used);
    let mask = candidates.dots(from).iter().fold(0u64, |m, &z| m | 1 << z);
    if used & mask != 0 {
        return without;
    }
    without.max(candidates.weights[from] + brute_force(candidates, from + 1, used | mask))
}

fn packing_problem() -> impl Strategy<Value = Candidates> {
    let group = (proptest::collection::btree_set(0u32..12, 2..5), 0.1f64..20.0);
    proptest::collection::vec(group, 1..16).prop_map(|groups| {
        let mut candidates = Candidates { starts: vec![0], complete: true, ..Candidates::default() };
        for (dots, weight) in groups {
            candidates.members.extend(dots);
            candidates.starts.push(candidates.members.len() as u32);
            candidates.weights.push(weight);
            candidates.points.push(Vector3::zeros());
        }
        candidates
    })
}

proptest! {
    #[test]
    fn packing_equals_brute_force(candidates in packing_problem()) {
        let packing = pack(&candidates, 12, 100_000);
        let best = brute_force(&candidates, 0, 0);
        prop_assert!((packing.value - best).abs() < 1e-9, "{} instead of {}", packing.value, best);
        prop_assert!(packing.is_optimal());
        let mut used = 0u64;
        for &group in &packing.chosen {
            for &z in candidates.dots(group) {
                prop_assert_eq!(used >> z & 1, 0);
                used |= 1 << z;
            }
        }
    }

    #[test]
    fn without_nodes_the_bound_still_holds(candidates in packing_problem()) {
        let packing = pack(&candidates, 12, 0);
        let best = brute_force(&candidates, 0, 0);
        prop_assert!(packing.value <= best + 1e-9);
        prop_assert!(packing.bound >= best - 1e-9);
    }
}

#[test]
fn beyond_the_step_limit_every_pair_still_gets_a_look_and_the_frame_is_not_certified() {
    let what =
        Imperfections { sigma_px: 2.0, hide: Hide::Nothing, merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 };
    let take = simulate(rigs::ring(8, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0), 60, 1, &what);
    let model = take.model();
    let scene = Scene::new(&take.rig, &model);
    let frame = PreparedFrame::new(&scene, &take.dots[0]);
    let graph = PairGraph::new(&scene, &frame);
    let whole = enumerate(&scene, &frame, &graph, &EnumerateOptions::default());
    let cut = enumerate(&scene, &frame, &graph, &EnumerateOptions { step_limit: 10 });
    assert!(whole.complete && !whole.truncated);
    assert!(!cut.complete && cut.truncated && cut.len() < whole.len());
    assert!(pack(&cut, frame.len(), 20_000).value > 0.9 * pack(&whole, frame.len(), 20_000).value);
}
