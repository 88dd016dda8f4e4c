//! Normals against the true ones.

use super::scene::{Scene, dot};
use rand::RngExt;
use voxelastic::sensor::{BeamModel, CloudLayout, RangeLimits, ScanPreprocessor, preset};

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
    let mut preprocessor = ScanPreprocessor::new(model.clone(), CloudLayout::grid_of(model), RangeLimits { near: 0.5, max: 100.0 });
    let returns = &preprocessor.prepare(&scan.cloud).returns;
    let mut score = Score::default();
    for (i, n) in returns.normals.iter().enumerate() {
        let Some(hit) = scan.truth[returns.pixel[i] as usize] else { continue };
        if !select(hit.shape, hit.range, returns.points[i]) {
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

impl Score {
    fn print(&self, what: &str) {
        println!(
            "{what:<32} median {:5.2} 90% {:5.2} 99% {:6.2} degrees, given {:5.1} %, over 15 degrees {:5.2} %, of {}",
            self.quantile(0.5),
            self.quantile(0.9),
            self.quantile(0.99),
            100.0 * self.given(),
            100.0 * self.wrong(15.0),
            self.errors.len() + self.none
        );
    }
}

fn model(name: &str) -> BeamModel {
    preset(name).unwrap_or_else(|e| panic!("{e}"))
}

/// Without noise a plane is a plane, however slanted: rings of ground metres apart, too.
#[test]
fn planes_without_noise_are_exact() {
    for name in ["os1-64", "os0-64", "hdl-64e", "vlp-16"] {
        let walls = score(&Scene::street(0.0), &model(name), |shape, _, _| shape == 1 || shape == 2);
        let ground = score(&Scene::street(0.0), &model(name), |shape, _, _| shape == 0);
        for (what, score) in [("walls", walls), ("ground", ground)] {
            score.print(&format!("{name}, no noise, {what}"));
            // With 16 rows, the ones where ground meets wall are a larger share.
            let most_wrong = if name == "vlp-16" { 0.02 } else { 0.001 };
            assert!(score.quantile(0.9) < 0.1 && score.wrong(15.0) < most_wrong, "{name} {what}");
            assert!(score.given() > 0.85, "{name} {what} {}", score.given());
        }
    }
}

#[test]
fn noise_of_centimetres_turns_normals_by_degrees() {
    for (name, noise, median, most) in
        [("os1-64", 0.01, 0.8, 2.5), ("os1-64", 0.03, 2.2, 6.0), ("os0-64", 0.02, 1.2, 4.0), ("hdl-64e", 0.02, 1.0, 4.0)]
    {
        for (world, scene) in [("room", Scene::room(noise)), ("street", Scene::street(noise))] {
            let score = score(&scene, &model(name), |_, _, _| true);
            score.print(&format!("{name}, {noise} m, {world}"));
            assert!(score.quantile(0.5) < median && score.quantile(0.9) < most, "{name} {noise} {world}");
            assert!(score.given() > 0.98 && score.wrong(15.0) < 0.02, "{name} {noise} {world}");
        }
    }
}

#[test]
fn grazing_ground_far_away_keeps_its_normal() {
    for name in ["os1-64", "hdl-64e"] {
        let score = score(&Scene::street(0.02), &model(name), |shape, range, _| shape == 0 && range > 20.0);
        score.print(&format!("{name}, ground beyond 20 m"));
        assert!(score.quantile(0.5) < 0.2 && score.quantile(0.9) < 1.0 && score.given() > 0.95, "{name}");
    }
}

#[test]
fn bent_surfaces_get_narrow_windows() {
    for (name, most) in [("os1-64", 6.0), ("hdl-64e", 5.0)] {
        let pillar = score(&Scene::room(0.01), &model(name), |shape, _, _| shape == 6);
        let ball = score(&Scene::room(0.01), &model(name), |shape, _, _| shape == 7);
        pillar.print(&format!("{name}, pillar of 40 cm"));
        ball.print(&format!("{name}, ball of 1.2 m"));
        assert!(pillar.quantile(0.5) < most && pillar.given() > 0.9, "{name}");
        assert!(ball.quantile(0.5) < 3.0 && ball.quantile(0.9) < 8.0 && ball.given() > 0.9, "{name}");
    }
}

/// Edges and thin objects: planes are right, or there is none.
#[test]
fn edges_rarely_get_a_wrong_plane() {
    for name in ["os1-64", "hdl-64e"] {
        let corner = score(&Scene::room(0.02), &model(name), |shape, _, _| shape >= 8);
        corner.print(&format!("{name}, box and its edges"));
        assert!(corner.wrong(15.0) < 0.05, "{name}");
    }
}

/// With a random fifth of the scan missing, the rest keeps its planes.
#[test]
fn dropouts_are_bridged() {
    let model = model("os1-64");
    let mut scan = Scene::room(0.01).scan(&model, 7).cloud;
    let mut rng = super::scene::rng(8);
    scan.points.iter_mut().for_each(|p| {
        if rng.random::<f32>() < 0.2 {
            *p = [f32::NAN; 3];
        }
    });
    let mut preprocessor = ScanPreprocessor::new(model.clone(), CloudLayout::grid_of(&model), RangeLimits::default());
    let returns = &preprocessor.prepare(&scan).returns;
    let given = returns.normals.iter().filter(|n| **n != [0.0; 3]).count();
    assert!(given as f32 > 0.93 * returns.len() as f32, "{given} of {}", returns.len());
}

#[test]
fn roughness_is_the_noise_along_the_normal() {
    let model = model("os1-64");
    for noise in [0.01, 0.02] {
        let scan = Scene::room(noise).scan(&model, 9).cloud;
        let mut preprocessor = ScanPreprocessor::new(model.clone(), CloudLayout::grid_of(&model), RangeLimits::default());
        let returns = &preprocessor.prepare(&scan).returns;
        let mut ratios: Vec<f32> = (0..returns.len())
            .filter(|&i| returns.normals[i] != [0.0; 3])
            .map(|i| returns.roughness[i] * returns.ranges[i] / dot(returns.normals[i], returns.points[i]).abs().max(1e-3))
            .collect();
        ratios.sort_by(f32::total_cmp);
        let median = ratios[ratios.len() / 2];
        assert!((median / noise - 1.0).abs() < 0.15, "{noise}: {median}");
    }
}
