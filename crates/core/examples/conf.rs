use markerloom_core::correspond::{confidence::confidences, frame::*, optimal::choose, scene::Scene};
use markerloom_core::reconstruct::*;
use markerloom_core::synth::{cloud, observe::*, rigs};
use nalgebra::Vector3;
fn main() {
    let rig = rigs::ring(4, 2.0, 30.0, 45.0, [640.0, 480.0], 757.0);
    let size = Vector3::new(0.497843, 0.788865, 0.748485);
    let what = Imperfections { sigma_px: 2.0, hide: Hide::Each(0.25), merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 };
    let takes: Vec<_> = (0..60).map(|f| { let m = cloud(0, f, 33, &size, &Vector3::zeros()); (observe(&rig, &m, &[], &what, 0, f), m) }).collect();
    let dots: Vec<Vec<Dot>> = takes.iter().map(|(f, _)| f.iter().map(|d| Dot { camera: d.camera, pixel: d.pixel, sigma: 1.0 }).collect()).collect();
    let views: Vec<&[Dot]> = dots.iter().map(|d| &d[..]).collect();
    let o = ReconstructOptions::default();
    let model = estimate_model(&rig, &views, &o).unwrap();
    let scene = Scene::new(&rig, &model);
    for f in 0..60 {
        let frame = PreparedFrame::new(&scene, &dots[f]);
        let (c, p) = choose(&scene, &frame, &o.optimal);
        let q = confidences(&c, &p, frame.len());
        for (i, &g) in p.chosen.iter().enumerate() {
            let near = takes[f].1.iter().map(|m| (c.points[g] - m).norm()).fold(9.0, f64::min);
            if near > 0.03 {
                // value of the best alternative by solving again without groups like it
                let like = |h: usize| c.dots(h).iter().filter(|z| c.dots(g).contains(z)).count() >= 2;
                let mut d = c.clone(); for h in 0..c.len() { if like(h) { d.weights[h] = 0.0; } }
                let alt = markerloom_core::correspond::packing::pack(&d, frame.len(), 20000);
                println!("f{f} n {} w {:.2} conf {:.4} exact loss {:.2} near {:.3}", c.dots(g).len(), c.weights[g], q[i], p.value - alt.value, near);
            }
        }
    }
}
