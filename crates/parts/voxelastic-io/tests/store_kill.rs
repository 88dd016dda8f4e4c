//! A process that is killed at any moment while it saves leaves a map that opens: the old one or the new one.
#![cfg(unix)]

#[path = "all/store/world.rs"]
#[allow(dead_code)]
mod world;

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic_io::Error;
use voxelastic_io::store::{MapStore, MapWriter};
use world::{Numbers, details, made_up_atlas, made_up_field, same_atlas};

const DIR: &str = "VOXELASTIC_TEST_SAVES_TO";

/// The atlas after `step` rounds: some submaps are new, some are as they were.
fn atlas_at(step: u64) -> Atlas {
    let mut atlas = made_up_atlas(1, 4, 30);
    *atlas.submap_mut((step % 4) as u32).unwrap().tsdf_mut() = made_up_field(step, 300);
    let submap = atlas.submap_mut(1).unwrap();
    *submap = submap.clone().with_scans(submap.scans().to_vec(), step as f64);
    atlas
}

/// The step at which the map in `dir` was saved, after checking that it is what was saved then.
fn step_of(dir: &Path) -> Option<u64> {
    let store = match MapStore::open(dir) {
        Err(Error::NotAMap { .. }) => return None,
        other => other.unwrap(),
    };
    let step: u64 = store.manifest().details.settings["voxel"].parse().unwrap();
    assert!(same_atlas(&store.load_atlas().unwrap(), &atlas_at(step)), "step {step}");
    assert!(store.check().is_empty());
    Some(step)
}

/// Helper mode: saves again and again when it is given a folder, and does nothing otherwise.
#[test]
fn saves_for_ever() {
    let Some(dir) = std::env::var_os(DIR) else { return };
    let dir = Path::new(&dir);
    let first = step_of(dir).map_or(0, |step| step + 1);
    let mut writer = MapWriter::create(dir).unwrap();
    for step in first.. {
        writer.save(&atlas_at(step), &details(&step.to_string())).unwrap();
    }
}

#[test]
fn a_map_survives_being_killed_at_any_moment() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path().join("killed.vox");
    let mut numbers = Numbers(42);
    let (mut last, mut advanced) = (None, 0);
    // On a busy machine few saves are done between two kills: as many rounds as it takes, within reason.
    for round in 0.. {
        if round >= 40 && (advanced >= 10 || round == 1000) {
            break;
        }
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "saves_for_ever", "--nocapture"])
            .env(DIR, &dir)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        // Not before it is under way, then at any moment of a save or two.
        let wait = Instant::now();
        while round == 0 && !dir.exists() && wait.elapsed() < Duration::from_secs(10) {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(5) + Duration::from_secs_f64(0.08 * numbers.unit()));
        assert!(child.try_wait().unwrap().is_none(), "the helper must not end by itself");
        child.kill().unwrap();
        child.wait().unwrap();
        let step = step_of(&dir);
        assert!(step >= last, "the map went back from step {last:?} to {step:?}");
        advanced += usize::from(step > last);
        last = step;
    }
    assert!(advanced >= 10, "kills must hit between saves, not before the first: {advanced} rounds saved, last step {last:?}");
    // A last save leaves nothing behind but the map.
    let atlas = atlas_at(0);
    let mut writer = MapWriter::open(&dir).unwrap();
    writer.save(&atlas, &details("0")).unwrap();
    assert_eq!(std::fs::read_dir(&dir).unwrap().count(), atlas.submaps().len() + 2);
}
