//! Time per frame of the causal tracker, on one thread and on two, over a moving take: mean and tail, because a live user waits for the
//! slowest frame.
//!
//! `cargo bench --bench track [part of a scene's name]`. Each take is followed several times; the first 50 frames, in which
//! everything is new, count in the tail only.

use markerloom_core::camera::Rig;
use markerloom_core::correspond::frame::Dot;
use markerloom_core::correspond::scene::SceneModel;
use markerloom_core::reconstruct::{ReconstructOptions, estimate_model};
use markerloom_core::synth::body::{Body, Motion};
use markerloom_core::synth::observe::{Hide, Imperfections, observe};
use markerloom_core::synth::rigs;
use markerloom_core::track::{Moment, TrackOptions, Tracker};
use nalgebra::Vector3;
use std::time::Instant;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const RATE_HZ: f64 = 100.0;
const ROUNDS: usize = 3;

/// People on a square grid, cameras on a ring around them.
struct Stage {
    name: &'static str,
    cameras: usize,
    people: usize,
    markers_each: usize,
    distance_m: f64,
    spacing_m: f64,
    size_px: [f64; 2],
    focal_px: f64,
    frames: usize,
}

const STAGES: [Stage; 3] = [
    Stage {
        name: "8 cameras, 33 markers",
        cameras: 8,
        people: 1,
        markers_each: 33,
        distance_m: 4.5,
        spacing_m: 0.0,
        size_px: [1280.0, 1024.0],
        focal_px: 1300.0,
        frames: 1500,
    },
    Stage {
        name: "12 cameras, 82 markers",
        cameras: 12,
        people: 2,
        markers_each: 41,
        distance_m: 4.5,
        spacing_m: 0.7,
        size_px: [1280.0, 1024.0],
        focal_px: 1300.0,
        frames: 800,
    },
    Stage {
        name: "48 cameras, 10 people, 530 markers",
        cameras: 48,
        people: 10,
        markers_each: 53,
        distance_m: 9.0,
        spacing_m: 1.5,
        size_px: [2432.0, 2048.0],
        focal_px: 2600.0,
        frames: 150,
    },
];

fn people(stage: &Stage) -> Vec<Body> {
    let side = (stage.people as f64).sqrt().ceil() as usize;
    let middle = (side as f64 - 1.0) / 2.0;
    let place = |i: usize| Vector3::new((i % side) as f64 - middle, (i / side) as f64 - middle, 0.0) * stage.spacing_m;
    (0..stage.people).map(|i| Body::new(Motion::Dance, stage.markers_each, i as u64, place(i))).collect()
}

fn seen(stage: &Stage, rig: &Rig) -> Vec<Vec<Dot>> {
    let people = people(stage);
    let what =
        Imperfections { sigma_px: 0.3, hide: Hide::Each(0.02), merge_px: 3.0, clutter_per_frame: 0.3, reflections: 1 };
    let frame = |frame: usize| {
        let (mut markers, mut capsules) = (Vec::new(), Vec::new());
        for body in &people {
            let pose = body.pose(frame as f64 / RATE_HZ);
            markers.extend(pose.markers_m);
            capsules.extend(pose.capsules);
        }
        let dots = observe(rig, &markers, &capsules, &what, 0, frame);
        dots.into_iter().map(|d| Dot { camera: d.camera, pixel: d.pixel, sigma: 1.0, hardware: None }).collect()
    };
    (0..stage.frames).map(frame).collect()
}

/// Milliseconds of each frame.
fn follow(rig: &Rig, model: &SceneModel, frames: &[Vec<Dot>]) -> Vec<f64> {
    let mut tracker = Tracker::new(rig, model, RATE_HZ, TrackOptions::default()).expect("the rig sees the stage");
    let mut ms = Vec::with_capacity(frames.len());
    for dots in frames {
        let clock = Instant::now();
        std::hint::black_box(tracker.push(dots, Moment::default()).expect("time goes on"));
        ms.push(1e3 * clock.elapsed().as_secs_f64());
    }
    ms
}

/// Mean over the steady frames, then median and tail over all (ms).
fn measure(rig: &Rig, model: &SceneModel, frames: &[Vec<Dot>], threads: usize) -> [f64; 4] {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be had");
    let (mut steady, mut all) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let ms = pool.install(|| follow(rig, model, frames));
        steady.extend_from_slice(&ms[50..]);
        all.extend(ms);
    }
    all.sort_by(f64::total_cmp);
    let quantile = |q: f64| all[((all.len() - 1) as f64 * q) as usize];
    [steady.iter().sum::<f64>() / steady.len() as f64, quantile(0.5), quantile(0.99), quantile(0.999)]
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    println!("{:38} {:>7} {:>9} {:>9} {:>9} {:>9}", "", "threads", "mean ms", "p50", "p99", "p99.9");
    for stage in STAGES.iter().filter(|s| wanted.iter().all(|w| s.name.contains(w.as_str()))) {
        let mut rig = rigs::ring(stage.cameras, stage.distance_m, 20.0, 0.0, stage.size_px, stage.focal_px);
        rig.cameras.iter_mut().for_each(|c| c.position_m += Vector3::z());
        let frames = seen(stage, &rig);
        let some: Vec<&[Dot]> = frames.iter().step_by(stage.frames.div_ceil(30)).map(Vec::as_slice).collect();
        let model = estimate_model(&rig, &some, &ReconstructOptions::default()).expect("the rig sees the stage");
        for threads in [1, 2] {
            let [mean, p50, p99, p999] = measure(&rig, &model, &frames, threads);
            println!("{:38} {threads:7} {mean:9.4} {p50:9.4} {p99:9.4} {p999:9.4}", stage.name);
        }
    }
}
