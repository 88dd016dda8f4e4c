//! Edits as text.

use super::*;
use nalgebra::Vector3;
use voxelastic::Pose;
use voxelastic::changes::OccupancyThen;
use voxelastic::event::Edge;

/// A number from -1 to 1 by its place in a sequence, with all of its digits.
fn random(k: u32) -> f64 {
    (f64::from(k) * 12.9898).sin() * 43_758.545_3 % 1.0
}

fn pose(k: u32) -> Pose {
    Pose::new(Vector3::new(random(k), 1e3 * random(k + 1), 1e-7 * random(k + 2)), Vector3::new(random(k + 3), random(k + 4), 2.0 * random(k + 5)))
}

fn all(k: u32) -> Vec<Edit> {
    let regions = [
        Region::Box { min: [random(k), -1.0 / 3.0, -2.0], max: [1.5, 1e-300, 7.0], yaw: 1e3 * random(k + 1) },
        Region::Sphere { centre: [random(k), 4.0, -0.0], radius: 0.1 + 0.2 },
        Region::Prism { polygon: vec![[0.0, 0.0], [random(k), 1e6], [5.0, -3.0], [f64::MIN_POSITIVE, 2.0]], z: [-1.0, random(k).abs()] },
    ];
    let information = std::array::from_fn(|i| random(k + i as u32) * 1e6);
    let edges = vec![
        Edge { from: 3, to: 900, t_from_to: pose(k), information: Some(information) },
        Edge { from: 5, to: 901, t_from_to: pose(k + 9), information: None },
    ];
    let pin = |pin| Edit::Pin { target: Target::Submap(k), pin };
    let mut edits = vec![
        pin(Pin { pose: Some(pose(k)), ..Pin::default() }),
        pin(Pin { position: Some([random(k), 2.0, 3.0]), up: Some(Up::Own), ..Pin::default() }),
        Edit::Pin {
            target: Target::Scan(u64::from(k) << 20),
            pin: Pin { height: Some(random(k)), up: Some(Up::Direction([0.1, random(k), 1.0])), ..Pin::default() },
        },
        Edit::Closure { between: Between::Submaps([1, 7]), start: Some(pose(k)), edges: edges.clone() },
        Edit::Closure { between: Between::Scans([1, 70]), start: None, edges },
        Edit::Closure { between: Between::Scans([1, 70]), start: None, edges: Vec::new() },
        Edit::RemoveClosure { scans: [9, 4] },
        Edit::Merge { into: 4, from: 2 },
        Edit::KeepApart { submaps: [60, k] },
        Edit::Origin { at: [random(k), 1e5 * random(k + 1), -0.0], yaw: 180.0 * random(k + 2) },
        pin(Pin { at: Some([random(k), 1.0, 2.0]), position: Some([random(k + 1), 2.0, 3.0]), ..Pin::default() }),
        Edit::AlignSession { session: SessionName::Number(2), t_map_session: pose(k) },
        Edit::AlignSession { session: SessionName::Input("data \"of\" \\ Tuesday\n\u{1b}[2J".to_owned()), t_map_session: pose(k) },
        Edit::Note { text: "'''\"\"\" = [x]\n# ü \u{7f}".to_owned(), at: Some([random(k), 0.0, 1.0]) },
        Edit::Note { text: String::new(), at: None },
    ];
    for (n, region) in regions.into_iter().enumerate() {
        let occupancy = [None, Some(OccupancyThen::Free), Some(OccupancyThen::Unknown)][n];
        edits.push(Edit::Crop { region: region.clone() });
        edits.push(Edit::Erase { region, surfaces: n != 2, occupancy, submaps: vec![k; n] });
    }
    edits
}

#[test]
fn what_is_written_is_what_is_read_to_the_last_bit() {
    for k in 0..50 {
        let edits = all(k);
        let text: String = edits.iter().map(Edit::to_text).collect();
        let read = parse(&text, "edits.toml").unwrap();
        assert_eq!(read, edits, "{text}");
        assert_eq!(read.iter().map(Edit::to_text).collect::<String>(), text);
    }
    assert!(parse("# nothing\n", "edits.toml").unwrap().is_empty());
}

#[test]
fn poses_may_be_given_by_their_heading() {
    let read = parse("[[edit]]\nkind = \"align-session\"\nsession = 2\npose = [1, -2, 3.5, 90]\n", "a.toml").unwrap();
    let [Edit::AlignSession { t_map_session, .. }] = &read[..] else { panic!("{read:?}") };
    let turned = t_map_session * nalgebra::Point3::new(1.0, 0.0, 0.0);
    assert!((turned - nalgebra::Point3::new(1.0, -1.0, 3.5)).norm() < 1e-12);
}
