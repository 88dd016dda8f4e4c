//! Recognition: simulated sensors are found again, real ones are taken sensibly.

use super::data;
use super::scene::Scene;
use voxelastic::Cloud;
use voxelastic::sensor::{BeamModel, CloudLayout, SensorError, detect, layout_for, preset, preset_with_columns};

fn model(name: &str) -> BeamModel {
    preset(name).unwrap_or_else(|e| panic!("{e}"))
}

fn recognised(what: &str, clouds: &[&Cloud]) -> voxelastic::sensor::Detected {
    let found = detect(clouds).unwrap_or_else(|e| panic!("{what}: {e}"));
    println!("{what:<24} {} {:?}", found.description, found.fit);
    found
}

/// Largest difference between the elevations of two models with as many rows, degrees.
fn apart(a: &BeamModel, b: &BeamModel) -> f32 {
    assert_eq!(a.rows(), b.rows());
    a.elevations().iter().zip(b.elevations()).map(|(x, y)| (x - y).abs().to_degrees()).fold(0.0, f32::max)
}

#[test]
fn organised_clouds_give_the_true_model() {
    for name in ["os1-64", "os0-128", "vlp-16", "hdl-64e", "pandar-64"] {
        let truth = model(name);
        let found = recognised(name, &[&Scene::room(0.01).scan(&truth, 1).cloud]);
        assert!(matches!(found.layout, CloudLayout::Grid(_)));
        assert_eq!((found.model.rows(), found.model.columns()), (truth.rows(), truth.columns()), "{name}");
        assert_eq!(found.model.is_clockwise(), truth.is_clockwise(), "{name}");
        assert!(apart(&truth, &found.model) < 0.03, "{name} {}", apart(&truth, &found.model));
        assert!((found.model.origin_radius() - truth.origin_radius()).abs() < 0.006, "{name} {}", found.model.origin_radius());
        for row in 0..truth.rows() {
            let off = (truth.azimuth(row as f32, 0.0) - found.model.azimuth(row as f32, 0.0)).to_degrees();
            // Beams that start off the axis are seen to the side on the near floor.
            let most = if name == "os0-128" { 0.2 } else { 0.05 };
            assert!((off - 360.0 * (off / 360.0).round()).abs() < most, "{name} row {row} {off}");
        }
    }
}

#[test]
fn staggered_bottom_up_and_transposed_grids_are_set_upright() {
    let truth = model("os1-64");
    let scan = Scene::room(0.01).scan(&truth, 2).cloud;
    let (rows, columns) = (truth.rows(), truth.columns());
    let mut staggered = scan.clone();
    for row in 0..rows {
        for column in 0..columns {
            // Firing order, bottom row first, one column of the cloud after the other.
            let firing = truth.firing_column(row, column);
            staggered.points[firing * rows + rows - 1 - row] = scan.points[row * columns + column];
        }
    }
    (staggered.width, staggered.height) = (rows, columns);
    let found = recognised("transposed, staggered", &[&staggered]);
    assert!(matches!(&found.layout, CloudLayout::Grid(grid) if grid.transposed && grid.shift_of_ring.iter().any(|&s| s != 0)));
    assert_eq!((found.model.rows(), found.model.columns()), (rows, columns));
    assert!(apart(&truth, &found.model) < 0.03);
    for row in [0, 1, 30, 63] {
        let off = (truth.azimuth_offsets()[row] - found.model.azimuth_offsets()[row]).to_degrees();
        assert!(off.abs() < 0.1, "row {row}: {off}");
    }
}

#[test]
fn ring_fields_and_ring_order_give_the_rows() {
    let truth = model("hdl-64e");
    let scan = Scene::street(0.01).scan(&truth, 3).cloud;
    let kept: Vec<usize> = (0..scan.len()).filter(|&i| Cloud::is_return(&scan.points[i])).collect();
    let points: Vec<[f32; 3]> = kept.iter().map(|&i| scan.points[i]).collect();
    let ring: Vec<u16> = kept.iter().map(|&i| (63 - i / scan.width) as u16).collect();
    let by_field = recognised("ring field", &[&Cloud { ring: Some(ring), ..Cloud::from_points(points.clone()) }]);
    assert!(matches!(&by_field.layout, CloudLayout::Rings { row_of_ring } if row_of_ring[0] == 63));
    let by_order = recognised("ring order", &[&Cloud::from_points(points)]);
    assert!(matches!(by_order.layout, CloudLayout::RingOrder { .. }));
    for found in [by_field, by_order] {
        assert!((found.model.columns() as f32 / truth.columns() as f32 - 1.0).abs() < 0.005, "{}", found.model.columns());
        assert!(apart(&truth, &found.model) < 0.05);
        assert!(found.fit.shown > 0.97 && found.fit.outside == 0.0, "{:?}", found.fit);
    }
}

#[test]
fn unorganised_clouds_give_rows_and_columns() {
    use rand::seq::SliceRandom;
    for (name, columns) in [("os1-64", 1024), ("os0-64", 2048), ("vlp-16", 1800), ("hdl-32e", 2170)] {
        let truth = preset_with_columns(name, columns).unwrap_or_else(|e| panic!("{e}"));
        let mut points = Scene::room(0.01).scan(&truth, 4).cloud.points;
        points.retain(Cloud::is_return);
        points.shuffle(&mut super::scene::rng(5));
        let found = recognised(&format!("{name} shuffled"), &[&Cloud::from_points(points)]);
        assert_eq!(found.layout, CloudLayout::Projected);
        assert_eq!(found.model.rows(), truth.rows(), "{name}");
        assert!((found.model.columns() as f32 / columns as f32 - 1.0).abs() < 0.01, "{name}: {}", found.model.columns());
        assert!(found.fit.shown > 0.9, "{name}");
        assert!(apart(&truth, &found.model) < 0.1, "{name}: {}", apart(&truth, &found.model));
    }
}

#[test]
fn a_named_sensor_keeps_the_grid_only_where_it_fits() {
    let truth = model("os1-64");
    let scan = Scene::room(0.01).scan(&truth, 6).cloud;
    assert!(matches!(layout_for(&truth, &scan), CloudLayout::Grid(_)));
    let mut turned = scan.clone();
    turned.points.rotate_left(300);
    assert!(!matches!(layout_for(&truth, &turned), CloudLayout::Grid(_)));
    assert_eq!(layout_for(&model("os0-64"), &scan), CloudLayout::Projected);
    assert_eq!(layout_for(&truth, &Cloud::from_points(scan.points)), CloudLayout::Projected);
}

#[test]
fn what_is_no_scan_is_refused() {
    assert!(matches!(detect(&[]), Err(SensorError::TooFewReturns { returns: 0, .. })));
    let nan = Cloud { width: 100, height: 10, points: vec![[f32::NAN; 3]; 1000], ..Cloud::default() };
    assert!(matches!(detect(&[&nan]), Err(SensorError::TooFewReturns { returns: 0, .. })));
    assert!(detect(&[&Cloud::from_points(vec![[1.0, 0.0, 0.0]; 1000])]).is_err());
    let line: Vec<[f32; 3]> = (0..1000).map(|i| [1.0 + i as f32 * 0.01, 0.0, 0.0]).collect();
    assert!(detect(&[&Cloud::from_points(line)]).is_err());
}

#[test]
fn real_scans_are_taken_sensibly() {
    let some = |name: &str, ext: &str| -> Vec<Cloud> {
        [0, 10, 20]
            .iter()
            .filter_map(|i| if ext == "bin" { data::raw(&format!("{name}{i:06}.bin"), 4) } else { data::pcd(&format!("{name}{i:06}.pcd")) })
            .collect()
    };
    let newer = |name: &str| -> Vec<Cloud> { (0..3).filter_map(|i| data::raw(&format!("newer-college-sample/{name}_{i:02}.bin"), 3)).collect() };
    for (what, clouds, least_shown) in [
        ("hall", some("hall/scans/", "pcd"), 0.85),
        ("kitti00-street", some("kitti00-street/velodyne/", "bin"), 0.9),
        ("newer college raw", newer("raw"), 0.85),
        ("newer college deskewed", newer("deskewed"), 0.8),
    ] {
        if clouds.is_empty() {
            continue;
        }
        let all: Vec<&Cloud> = clouds.iter().collect();
        for (which, clouds) in [("one", &all[..1]), ("three", &all[..])] {
            let found = recognised(&format!("{what}, {which}"), clouds);
            assert!(found.fit.shown > least_shown && found.fit.outside < 0.01, "{what}: {:?}", found.fit);
            assert_ne!(found.layout, CloudLayout::Scattered, "{what}");
        }
    }
    // Thinned to a point in 0.33 m: every return is used, so how many have a pixel of their own does not matter.
    let thinned = some("kitti00-loops/Scans/", "pcd");
    for count in 1..=thinned.len() {
        let found = recognised(&format!("kitti00-loops, {count}"), &thinned.iter().take(count).collect::<Vec<_>>());
        assert!(found.layout == CloudLayout::Scattered && found.fit.outside < 0.01, "{:?}", found.fit);
    }
}
