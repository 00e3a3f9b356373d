use markerloom_core::correspond::{frame::*, optimal::choose, scene::Scene};
use markerloom_core::reconstruct::*;
use markerloom_core::synth::{cloud, observe::*, rigs};
use nalgebra::Vector3;
fn main() {
    let rig = rigs::ring(4, 2.0, 0.0, 45.0, [640.0, 480.0], 757.0);
    let size = Vector3::new(0.497843, 0.788865, 0.748485);
    let what = Imperfections { sigma_px: 2.0, hide: Hide::One, merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 };
    let takes: Vec<_> = (0..200).map(|f| { let m = cloud(0, f, 33, &size, &Vector3::zeros()); (observe(&rig, &m, &[], &what, 0, f), m) }).collect();
    let dots: Vec<Vec<Dot>> = takes.iter().map(|(f, _)| f.iter().map(|d| Dot { camera: d.camera, pixel: d.pixel, sigma: 1.0 }).collect()).collect();
    let views: Vec<&[Dot]> = dots.iter().map(|d| &d[..]).collect();
    let o = ReconstructOptions::default();
    let model = estimate_model(&rig, &views, &o).unwrap();
    let scene = Scene::new(&rig, &model);
    println!("region {:?}", model.region);
    let mut shown = 0;
    for f in 0..200 {
        let frame = PreparedFrame::new(&scene, &dots[f]);
        let (c, p) = choose(&scene, &frame, &o.optimal);
        for m in 0..33 {
            let own: Vec<u32> = (0..frame.len() as u32).filter(|&z| takes[f].0[frame.input_index[z as usize]].markers == [m]).collect();
            let near = p.chosen.iter().map(|&g| (c.points[g] - takes[f].1[m]).norm()).fold(9.0, f64::min);
            if near > 0.03 && shown < 14 { shown += 1;
                let w = (0..c.len()).find(|&g| c.dots(g) == own).map(|g| (c.weights[g], (c.points[g]-takes[f].1[m]).norm()));
                println!("f{f} m{m} {:.3?} own {own:?} cams {:?} w {w:?} near {near:.3}", takes[f].1[m].as_slice(), own.iter().map(|&z| frame.sights[z as usize].camera).collect::<Vec<_>>());
                for &g in &p.chosen { if c.dots(g).iter().any(|z| own.contains(z)) { println!("    chosen {:?} w {:.2} cams {:?} err {:.3}", c.dots(g), c.weights[g], c.dots(g).iter().map(|&z| frame.sights[z as usize].camera).collect::<Vec<_>>(), (c.points[g]-takes[f].1[m]).norm()); } }
            }
        }
    }
}
