//! From clouds to returns.

use super::scene::Scene;
use proptest::prelude::*;
use voxelastic::Cloud;
use voxelastic::sensor::{BeamModel, CloudLayout, NO_POINT, RangeLimits, ScanPreprocessor, preset, preset_with_columns};

const LIMITS: RangeLimits = RangeLimits { near: 0.5, max: 15.0 };

fn model() -> BeamModel {
    preset_with_columns("os1-64", 512).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn a_grid_keeps_its_pixels_and_its_points() {
    let model = model();
    let mut scan = Scene::room(0.01).scan(&model, 1);
    scan.cloud.points[5000] = [0.1, 0.0, 0.0];
    let mut preprocessor = ScanPreprocessor::new(model.clone(), CloudLayout::grid_of(&model), LIMITS);
    let prepared = preprocessor.prepare(&scan.cloud);
    let counts = prepared.counts;
    assert_eq!(counts.usable + counts.no_return + counts.too_near + counts.beyond_max + counts.outside, scan.cloud.len());
    assert_eq!((counts.too_near, counts.hidden, counts.outside), (1, 0, 0));
    assert!(counts.beyond_max > 100 && counts.usable > 20_000, "{counts:?}");
    assert_eq!(prepared.returns.len(), counts.usable);
    for (pixel, hit) in scan.truth.iter().enumerate() {
        let range = prepared.image.ranges[pixel];
        match hit {
            _ if pixel == 5000 => assert_eq!(range, 0.0),
            None => assert_eq!(range, 0.0),
            Some(hit) if hit.range > 15.1 => assert!(range.is_infinite() && prepared.image.points[pixel] == NO_POINT),
            Some(hit) => assert!((range - hit.range).abs() < 0.1 || range.is_infinite()),
        }
    }
}

#[test]
fn a_shuffled_cloud_gives_the_image_of_the_grid() {
    use rand::seq::SliceRandom;
    let model = model();
    let scan = Scene::room(0.01).scan(&model, 2);
    let mut order: Vec<usize> = (0..scan.cloud.len()).collect();
    order.shuffle(&mut super::scene::rng(3));
    let shuffled = Cloud::from_points(order.iter().map(|&i| scan.cloud.points[i]).collect());
    let mut grid = ScanPreprocessor::new(model.clone(), CloudLayout::grid_of(&model), LIMITS);
    let mut projected = ScanPreprocessor::new(model, CloudLayout::Projected, LIMITS);
    let (a, b) = (grid.prepare(&scan.cloud), projected.prepare(&shuffled));
    assert_eq!(a.counts, b.counts);
    assert_eq!(a.returns.pixel, b.returns.pixel);
    assert_eq!(a.returns.points, b.returns.points);
    assert_eq!(a.returns.normals, b.returns.normals);
}

#[test]
fn a_pixel_shows_its_nearest_return_and_the_others_stay_returns() {
    let model = model();
    let points = vec![model.point(10.0, 20.0, 8.0), model.point(10.0, 20.1, 5.0), model.point(9.8, 20.0, 30.0), model.point(10.0, 21.0, 30.0)];
    let mut preprocessor = ScanPreprocessor::new(model.clone(), CloudLayout::Projected, LIMITS);
    let scan = preprocessor.prepare(&Cloud::from_points(points));
    let pixel = 10 * model.columns() + 20;
    assert_eq!(scan.image.points[pixel], 1);
    assert_eq!(scan.returns.source, [0, 1]);
    assert_eq!(scan.returns.pixel, [pixel as u32; 2]);
    assert!(scan.image.ranges[pixel + 1].is_infinite());
    assert_eq!((scan.counts.usable, scan.counts.hidden, scan.counts.beyond_max), (2, 1, 2));
}

#[test]
fn threads_change_nothing() {
    let model = model();
    let scan = Scene::room(0.02).scan(&model, 4);
    let run = |threads, layout: CloudLayout| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap_or_else(|e| panic!("{e}"));
        pool.install(|| ScanPreprocessor::new(model.clone(), layout, LIMITS).prepare(&scan.cloud).clone())
    };
    for layout in [CloudLayout::grid_of(&model), CloudLayout::Projected] {
        let one = run(1, layout.clone());
        for threads in [2, 3, 7] {
            assert_eq!(one, run(threads, layout.clone()), "{threads} threads");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn any_points_are_prepared_without_a_panic(
        points in prop::collection::vec(prop::array::uniform3(prop_oneof![Just(f32::NAN), Just(0.0), Just(f32::INFINITY), Just(-1e30f32), Just(1e-30f32), -90f32..90.0]), 0..300),
        height in 0usize..5,
        name in prop::sample::select(vec!["os0-32", "vlp-16", "hdl-64e"]),
        layout in 0..4,
    ) {
        let model = preset(name).map_err(|e| TestCaseError::fail(e.to_string()))?;
        let rows: Vec<u16> = (0..40).collect();
        let layout = match layout {
            0 => CloudLayout::grid_of(&model),
            1 => CloudLayout::Rings { row_of_ring: rows },
            2 => CloudLayout::RingOrder { row_of_ring: rows },
            _ => CloudLayout::Projected,
        };
        let ring = Some(points.iter().enumerate().map(|(i, _)| (i % 50) as u16).collect());
        let cloud = Cloud { width: points.len() / height.max(1), height, ring, points, ..Cloud::default() };
        let mut preprocessor = ScanPreprocessor::new(model, layout, LIMITS);
        let scan = preprocessor.prepare(&cloud);
        let c = scan.counts;
        prop_assert_eq!(c.usable + c.no_return + c.too_near + c.beyond_max + c.outside, cloud.len());
        for (i, n) in scan.returns.normals.iter().enumerate() {
            let length: f32 = n.iter().map(|c| c * c).sum();
            prop_assert!(length == 0.0 || (length - 1.0).abs() < 1e-3, "{:?} at {:?}", n, scan.returns.points[i]);
        }
    }
}
