//! File systems that lack something, and clocks that jump.

use crate::faults::resume::content;
use crate::{Finished, json, room, voxelastic, works};
use std::path::Path;
use std::process::Command;

const BINARY: &str = env!("CARGO_BIN_EXE_voxelastic");

/// The command where the system refuses something, as `refuse.py` names it.
#[cfg(target_arch = "x86_64")]
fn refused(python: &str, dir: &Path, what: &str, arguments: &str) -> Finished {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/faults/refuse.py");
    Command::new(python).arg(script).args([what, BINARY]).args(arguments.split(' ')).current_dir(dir).output().unwrap().into()
}

#[cfg(target_arch = "x86_64")]
#[test]
fn file_systems_without_links_locks_or_maps_are_good_enough() {
    let Some(python) = voxelastic_testing::python("ctypes") else { return };
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    room::write(&dir.join("room"), 6);
    works(dir, "map room -o whole.vox --voxel-size 0.1");
    for what in ["links", "locks", "maps of files"] {
        let outputs = ["mesh a.vox -o a.ply", "export a.vox -o a.copc.laz", "export a.vox -o tiles/"];
        for command in ["map room -o a.vox --voxel-size 0.1 --checkpoints 2 --restart"].iter().chain(&outputs) {
            let done = refused(&python, dir, what, command);
            assert_eq!(done.code, Some(0), "without {what}: {command}: {}", done.err);
            assert!(what != "locks" || !command.starts_with("map") || done.err.contains("knows no locks"), "{}", done.err);
        }
        assert_eq!(content(&dir.join("a.vox")), content(&dir.join("whole.vox")), "without {what}");
    }
    let done = refused(&python, dir, "maps of files", "map room -o b.vox --memory 100MB");
    assert!(done.code == Some(1) && ["error: ", "No such device", "TMPDIR"].iter().all(|word| done.err.contains(word)), "{}", done.err);
}

#[cfg(target_arch = "x86_64")]
#[test]
fn a_file_system_that_cannot_rename_keeps_what_was_there() {
    let Some(python) = voxelastic_testing::python("ctypes") else { return };
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    room::write(&dir.join("room"), 6);
    works(dir, "map room -o a.vox --voxel-size 0.1 --max-scans 3");
    std::fs::write(dir.join("a.ply"), "before").unwrap();
    let before = content(&dir.join("a.vox"));
    for (command, word) in
        [("map room -o a.vox --voxel-size 0.1 --overwrite --on-full-disk fail", "a.vox/submap-"), ("mesh a.vox -o a.ply", "a.ply: cannot write")]
    {
        let done = refused(&python, dir, "renames", command);
        assert!(done.code == Some(1) && done.err.contains(word) && done.err.contains("Operation not permitted"), "{command}: {}", done.err);
    }
    assert!(content(&dir.join("a.vox")) == before && std::fs::read(dir.join("a.ply")).unwrap() == b"before");
    assert_eq!(json(dir, "info a.vox --check --json")["scans"], 3);
    assert!(std::fs::read_dir(dir).unwrap().all(|entry| !entry.unwrap().file_name().to_string_lossy().ends_with(".tmp")));
}

#[test]
fn clocks_may_jump_or_show_any_year() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/faults/clock.c");
    let built = Command::new("cc").args(["-shared", "-fPIC", "-o"]).arg(dir.join("clock.so")).arg(source).status();
    if !built.is_ok_and(|status| status.success()) {
        return voxelastic_testing::skip(voxelastic_testing::Need::System, "no C compiler");
    }
    room::write(&dir.join("room"), 6);
    works(dir, "map room -o whole.vox --voxel-size 0.1");
    let twice = "map room --max-scans 4 --into a.vox --align 0,0,0";
    for years in [None, Some("-100"), Some("20000"), Some("-56")] {
        for command in
            ["map room -o a.vox --voxel-size 0.1 --checkpoints 2 --report --restart", "live --from room --rate max -o b.vox --restart", twice]
        {
            let mut done = voxelastic(dir);
            years.map(|years| done.env("CLOCK_YEARS", years));
            let done: Finished = done.env("LD_PRELOAD", dir.join("clock.so")).args(command.split(' ')).output().unwrap().into();
            assert!(done.code == Some(0) && !done.err.contains("panicked"), "{years:?}: {command}: {}", done.err);
            if command.starts_with("map room -o") {
                assert_eq!(content(&dir.join("a.vox")), content(&dir.join("whole.vox")), "{years:?}");
            }
        }
        std::fs::remove_dir_all(dir.join("a.vox")).unwrap();
    }
}
