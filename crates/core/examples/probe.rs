use markerloom_core::correspond::Method;
use markerloom_core::correspond::frame::Dot;
use markerloom_core::correspond::scene::Scene;
use markerloom_core::reconstruct::*;
use markerloom_core::synth::{cloud, rigs, observe::*};
use nalgebra::Vector3;
use std::time::Instant;
fn main() {
    let a: Vec<f64> = std::env::args().skip(1).map(|s| s.parse().unwrap()).collect();
    let (c, n, sigma, hide, frames, method, elev) = (a[0] as usize, a[1] as usize, a[2], a[3], a[4] as usize, a[5] as usize, a.get(6).copied().unwrap_or(30.0));
    let rig = if elev < -1.0 { rigs::arc(c, 2.0, 0.0, 120.0, [640.0, 480.0], 757.0) } else { rigs::ring(c, 2.0, elev, 45.0, [640.0, 480.0], 757.0) };
    let size = Vector3::new(0.497843, 0.788865, 0.748485);
    let what = Imperfections { sigma_px: sigma, hide: if hide < 0.0 { Hide::One } else { Hide::Each(hide) }, merge_px: 0.0, clutter_per_frame: 0.0, reflections: 0 };
    let mut takes = vec![]; let mut truth = vec![];
    for f in 0..frames { let m = cloud(0, f, n, &size, &Vector3::zeros()); let d = observe(&rig, &m, &[], &what, 0, f); takes.push(d); truth.push(m); }
    let dots: Vec<Vec<Dot>> = takes.iter().map(|f| f.iter().map(|d| Dot { camera: d.camera, pixel: d.pixel, sigma: 1.0 }).collect()).collect();
    let views: Vec<&[Dot]> = dots.iter().map(|d| &d[..]).collect();
    let options = ReconstructOptions { method: [Method::Optimal, Method::Relaxation][method], ..Default::default() };
    let t = Instant::now();
    let model = estimate_model(&rig, &views, &options).unwrap();
    println!("model {:.0} ms: {:?} vol {:?} lam {:.1} pD {:.3} clutter {:?} tail {:?}", t.elapsed().as_secs_f64()*1e3, model.noise, model.volume, model.expected_markers, model.detection, model.clutter, model.tail);
    let scene = Scene::new(&rig, &model);
    let t = Instant::now();
    stages(&scene, &views); let t = Instant::now();
    let out: Vec<_> = views.iter().map(|d| reconstruct_frame(&scene, d, &options)).collect();
    let ms = t.elapsed().as_secs_f64() * 1e3 / frames as f64;
    let (mut req, mut hit, mut set, mut ghosts, mut cert, mut cand, mut nodes) = (0, 0, 0, 0, 0, 0, 0);
    let (mut conf_sum, mut sr, mut srn) = (0.0, 0.0, 0);
    for f in 0..frames {
        let mut views_of = vec![vec![]; n];
        for (i, d) in takes[f].iter().enumerate() { for &m in &d.markers { views_of[m].push(i); } }
        let mut used = vec![false; out[f].groups.len()];
        cert += out[f].certified as usize; cand += out[f].candidates; nodes += out[f].nodes;
        for m in 0..n { if views_of[m].len() < 2 { continue; } req += 1;
            let mut own = views_of[m].clone(); own.sort();
            if out[f].groups.iter().any(|g| { let mut d = g.dots.clone(); d.sort(); d == own }) { set += 1; }
            let best = (0..used.len()).filter(|&g| !used[g]).min_by(|&x, &y| (out[f].groups[x].point - truth[f][m]).norm().total_cmp(&(out[f].groups[y].point - truth[f][m]).norm()));
            if let Some(g) = best { let e = (out[f].groups[g].point - truth[f][m]).norm(); if e < if sigma > 1.0 {0.03} else {0.005} { used[g] = true; hit += 1; sr += e*e/out[f].groups[g].covariance.trace(); srn += 1; } } }
        for (gi, g) in out[f].groups.iter().enumerate() { if !used[gi] { println!("ghost f{f} n {} dots {:?} near {:.4}", g.dots.len(), g.dots.iter().map(|&d| takes[f][d].markers.clone()).collect::<Vec<_>>(), truth[f].iter().map(|m| (m - g.point).norm()).fold(9.0, f64::min)); } }
        ghosts += used.iter().filter(|u| !**u).count();
        conf_sum += out[f].groups.iter().map(|g| g.confidence).sum::<f64>();
    }
    let total: usize = out.iter().map(|o| o.groups.len()).sum();
    println!("3d {:.3} set {:.3} ghosts {:.3} cert {:.3} | {:.3} ms cand {} nodes {} | conf {:.4} true {:.4} sigma ratio {:.3}", 100.0*hit as f64/req as f64, 100.0*set as f64/req as f64, ghosts as f64/frames as f64, cert as f64/frames as f64, ms, cand/frames, nodes/frames, conf_sum/total as f64, 1.0-ghosts as f64/total as f64, sr/srn as f64);
}
#[allow(dead_code)]
pub fn stages(scene: &Scene, views: &[&[Dot]]) {
    use markerloom_core::correspond::{*, frame::PreparedFrame, pairs::PairGraph, enumerate::*, packing::pack, confidence::confidences};
    let mut t = [0.0; 6];
    let (mut np, mut steps) = (0, 0);
    for d in views {
        let s = Instant::now(); let f = PreparedFrame::new(scene, d); t[0] += s.elapsed().as_secs_f64();
        let s = Instant::now(); let g = PairGraph::new(scene, &f); t[1] += s.elapsed().as_secs_f64(); np += g.len();
        let s = Instant::now(); let c = enumerate(scene, &f, &g, &EnumerateOptions::default()); t[2] += s.elapsed().as_secs_f64(); steps += c.steps;
        let s = Instant::now(); let p = pack(&c, f.len(), 20000); t[3] += s.elapsed().as_secs_f64();
        let s = Instant::now(); let q = confidences(&c, &p, f.len()); t[4] += s.elapsed().as_secs_f64();
        let s = Instant::now(); for (i, &g) in p.chosen.iter().enumerate() { let dots: Vec<usize> = c.dots(g).iter().map(|&z| z as usize).collect(); group_from_dots(scene, &f, &dots, c.points[g], q[i]); } t[5] += s.elapsed().as_secs_f64();
    }
    let n = views.len() as f64;
    println!("prep {:.3} pairs {:.3} ({}) enum {:.3} ({}) pack {:.3} conf {:.3} tri {:.3} ms", t[0]*1e3/n, t[1]*1e3/n, np/views.len(), t[2]*1e3/n, steps/views.len(), t[3]*1e3/n, t[4]*1e3/n, t[5]*1e3/n);
}
