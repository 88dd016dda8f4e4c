//! Normals against the truth.

use super::scene::{Scene, dot};
use voxelastic::sensor::{BeamModel, Layout, Limits, Preparer, preset, preset_with_columns};

/// How well normals agree with the truth over a set of returns.
#[derive(Debug, Default)]
struct Score {
    /// Errors of the normals that were given, degrees, sorted.
    errors: Vec<f32>,
    none: usize,
}

impl Score {
    fn quantile(&self, q: f32) -> f32 {
        self.errors.get((q * self.errors.len() as f32) as usize).copied().unwrap_or(f32::NAN)
    }
    fn given(&self) -> f32 {
        self.errors.len() as f32 / (self.errors.len() + self.none).max(1) as f32
    }
    fn wrong(&self, degrees: f32) -> f32 {
        self.errors.iter().filter(|&&e| e > degrees).count() as f32 / self.errors.len().max(1) as f32
    }
}

/// Scores the returns that `select` picks, by shape and true range.
fn score(scene: &Scene, model: &BeamModel, select: impl Fn(usize, f32, [f32; 3]) -> bool) -> Score {
    let scan = scene.scan(model, 5);
    let mut preparer = Preparer::new(model.clone(), Layout::grid_of(model), Limits { near: 0.5, max: 100.0 });
    let beams = &preparer.prepare(&scan.cloud).beams;
    let mut score = Score::default();
    for (i, n) in beams.normals.iter().enumerate() {
        let Some(hit) = scan.truth[beams.pixel[i] as usize] else { continue };
        if !select(hit.shape, hit.range, beams.points[i]) {
            continue;
        }
        if *n == [0.0; 3] {
            score.none += 1;
        } else {
            score.errors.push(dot(*n, hit.normal).clamp(-1.0, 1.0).acos().to_degrees());
        }
    }
    score.errors.sort_by(f32::total_cmp);
    score
}

fn report(what: &str, s: &Score) {
    println!(
        "{what:<44} median {:5.2} 90% {:5.2} 99% {:6.2} deg, given {:5.1} %, over 15 deg {:5.2} %, of {}",
        s.quantile(0.5),
        s.quantile(0.9),
        s.quantile(0.99),
        100.0 * s.given(),
        100.0 * s.wrong(15.0),
        s.errors.len() + s.none
    );
}

#[test]
fn table() {
    let all = |_: usize, _: f32, _: [f32; 3]| true;
    for name in ["os1-64", "os0-64", "hdl-64e"] {
        let model = preset(name).unwrap_or_else(|e| panic!("{e}"));
        for noise in [0.0, 0.01, 0.02] {
            report(&format!("{name} room {noise}"), &score(&Scene::room(noise), &model, all));
            report(&format!("{name} room cylinder"), &score(&Scene::room(noise), &model, |s, _, _| s == 6));
            report(&format!("{name} room sphere"), &score(&Scene::room(noise), &model, |s, _, _| s == 7));
            report(&format!("{name} room box"), &score(&Scene::room(noise), &model, |s, _, _| s >= 8));
            report(&format!("{name} street {noise}"), &score(&Scene::street(noise), &model, all));
            report(&format!("{name} street ground 5-15"), &score(&Scene::street(noise), &model, |s, r, _| s == 0 && r > 5.0 && r < 15.0));
            report(&format!("{name} street ground >20"), &score(&Scene::street(noise), &model, |s, r, _| s == 0 && r > 20.0));
            report(&format!("{name} street walls"), &score(&Scene::street(noise), &model, |s, _, _| s == 1 || s == 2));
            report(&format!("{name} street pole+trunk"), &score(&Scene::street(noise), &model, |s, _, _| s > 2));
        }
    }
    let _ = preset_with_columns;
}
