//! Files that were made to harm, of every kind that is read: none takes more time or memory than it should, or ends the command otherwise than with a word.

use crate::{room, works};
use std::path::Path;
use std::process::Command;

#[test]
fn no_file_takes_more_than_it_should() {
    // The memory of a process is asked of Linux.
    let Some(python) = voxelastic_testing::python("resource, sqlite3, bz2") else { return };
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    room::write(&dir.join("room"), 2);
    works(dir, "map room -o good.vox --voxel-size 0.4");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/inputs/hostile_run.py");
    let mut command = Command::new(python);
    // No bytecode beside the scripts.
    command.arg("-B").arg(script).arg(dir).arg(env!("CARGO_BIN_EXE_voxelastic")).arg(dir.join("good.vox"));
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && output.stderr.is_empty(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    let files: usize = said.lines().last().and_then(|line| line.split(' ').next()?.parse().ok()).unwrap();
    assert!(files >= 200 && said.lines().count() == 1, "{said}");
    println!("{said}");
}
