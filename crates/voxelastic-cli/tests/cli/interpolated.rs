//! `map --interpolate` and `mesh --interpolated`.

use crate::{json, works};
use voxelastic_io::ply;

#[test]
fn gaps_between_rings_are_closed_where_that_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate street -o street --spacing 1 --scans 12 --drift 0");
    works(dir.path(), "map street -o street.vox --poses groundtruth --hold-out 6 --voxel-size 0.1 --interpolate 3");
    let measured = json(dir.path(), "mesh street.vox -o measured.ply --json");
    assert!(measured["interpolated"].is_null(), "{measured}");
    let all = json(dir.path(), "mesh street.vox -o all.ply --interpolated --json");
    let marked = all["interpolated"].as_u64().unwrap();
    assert!(marked * 10 > all["vertices"].as_u64().unwrap(), "{all}");
    assert_eq!(ply::read_mesh(dir.path().join("all.ply")).unwrap().positions.len() as u64, all["vertices"].as_u64().unwrap());
    let within = |more: &str| {
        let held_out = json(dir.path(), &format!("heldout street.vox street --poses groundtruth --hold-out 6 --max-range 60 --json {more}"));
        held_out["distances"]["fraction_under_10cm"].as_f64().unwrap()
    };
    let (without, with) = (within(""), within("--interpolated"));
    assert!(with > without, "{with} {without}");
    assert!(works(dir.path(), "info street.vox --json").contains("\"interpolate\":\"3\""));
}
