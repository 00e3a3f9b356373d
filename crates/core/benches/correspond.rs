//! Time per frame from scratch (no memory of earlier frames), one thread: rays, pairs, candidates, packing, points.
//!
//! `cargo bench` prints the mean for one frame of each scene; each iteration takes the next of 16 frames.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use markerloom_core::camera::Rig;
use markerloom_core::correspond::Method;
use markerloom_core::correspond::frame::Dot;
use markerloom_core::correspond::scene::{Scene, SceneModel};
use markerloom_core::reconstruct::{ReconstructOptions, estimate_model, reconstruct_frame};
use markerloom_core::synth::observe::{Hide, Imperfections, observe};
use markerloom_core::synth::{cloud, rigs};
use nalgebra::Vector3;
use std::hint::black_box;

const BOX_M: Vector3<f64> = Vector3::new(0.497_843, 0.788_865, 0.748_485);
const FRAMES: usize = 16;

struct Take {
    rig: Rig,
    frames: Vec<Vec<Dot>>,
    model: SceneModel,
}

fn take(cameras: usize, markers: usize, sigma_px: f64, hide: Hide) -> Take {
    let rig = rigs::ring(cameras, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0);
    let what = Imperfections { sigma_px, hide, merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 };
    let see = |frame| {
        let points = cloud(0, frame, markers, &BOX_M, &Vector3::zeros());
        let seen = observe(&rig, &points, &[], &what, 0, frame);
        seen.into_iter().map(|d| Dot { camera: d.camera, pixel: d.pixel, sigma: 1.0, hardware: None }).collect()
    };
    let frames: Vec<Vec<Dot>> = (0..FRAMES).map(see).collect();
    let views: Vec<&[Dot]> = frames.iter().map(Vec::as_slice).collect();
    let model = estimate_model(&rig, &views, &ReconstructOptions::default()).expect("the rig sees the box");
    Take { rig, frames, model }
}

fn per_frame(criterion: &mut Criterion, group: &str, name: &str, take: &Take, method: Method) {
    let scene = Scene::new(&take.rig, &take.model);
    let options = ReconstructOptions { method, ..ReconstructOptions::default() };
    let mut group = criterion.benchmark_group(group);
    group.sample_size(10);
    let mut next = 0;
    group.bench_function(BenchmarkId::from_parameter(name), |bencher| {
        bencher.iter(|| {
            next = (next + 1) % FRAMES;
            black_box(reconstruct_frame(&scene, &take.frames[next], &options))
        });
    });
    group.finish();
}

fn table(criterion: &mut Criterion) {
    let exp61 = take(4, 33, 2.0, Hide::One);
    per_frame(criterion, "table", "exp61 one, optimal", &exp61, Method::Optimal);
    per_frame(criterion, "table", "exp61 one, relaxation", &exp61, Method::Relaxation);
    for markers in [33, 100, 200] {
        let crowd = take(8, markers, 0.3, Hide::Each(0.25));
        per_frame(criterion, "table", &format!("8 cameras, {markers} markers, optimal"), &crowd, Method::Optimal);
        per_frame(criterion, "table", &format!("8 cameras, {markers} markers, relaxation"), &crowd, Method::Relaxation);
    }
    per_frame(
        criterion,
        "table",
        "24 cameras, 200 markers, optimal",
        &take(24, 200, 0.3, Hide::Each(0.25)),
        Method::Optimal,
    );
}

fn growth(criterion: &mut Criterion) {
    for cameras in [4, 6, 8, 12, 16, 24] {
        let crowd = take(cameras, 50, 0.3, Hide::Each(0.25));
        per_frame(criterion, "growth with cameras, 50 markers", &cameras.to_string(), &crowd, Method::Optimal);
    }
    for markers in [10, 20, 50, 100, 200, 300] {
        let crowd = take(8, markers, 0.3, Hide::Each(0.25));
        per_frame(criterion, "growth with markers, 8 cameras", &markers.to_string(), &crowd, Method::Optimal);
    }
}

criterion_group!(benches, table, growth);
criterion_main!(benches);
