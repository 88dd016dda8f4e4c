//! Names that act on terminals, that are no text, or as long as file systems allow; and limits of the shell.

use crate::{json, room, voxelastic, works};
use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::Path;
use std::process::Command;

fn joined(name: &[u8], ending: &str) -> OsString {
    OsString::from_vec([name, ending.as_bytes()].concat())
}

/// Exit code, stdout, and stderr of a command; nothing of it acts on a terminal.
fn run(dir: &Path, arguments: &[&OsStr]) -> (Option<i32>, String, String) {
    let output = voxelastic(dir).args(arguments).output().unwrap();
    let acts = |bytes: &[u8]| String::from_utf8_lossy(bytes).chars().any(|c| (c.is_control() && c != '\n') || c == '\u{202e}');
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    assert!(!acts(&output.stdout) && !acts(&output.stderr), "{arguments:?}: {out:?} {err:?}");
    assert!(!err.lines().any(|line| line.starts_with("ERROR")), "a line of somebody else: {err}");
    (output.status.code(), out, err)
}

#[test]
fn names_are_text_whatever_is_in_them() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    let long = [b'n'; 240];
    let names: [&[u8]; 6] = [b"a\x1b]0;PWNED\x07\x1b[31mred", b"a\nERROR b", b"a\xff\xfeb", "a\u{9b}31m \u{202e}gnp".as_bytes(), b"a\rb", &long];
    for name in names {
        let data = joined(name, "");
        room::write(&dir.join(&data), 4);
        let (map, mesh) = (joined(name, ".vox"), joined(name, ".ply"));
        let of = |word| OsStr::new(word);
        let (code, out, err) = run(dir, &[of("map"), &data, of("-o"), &map, of("--voxel-size"), of("0.2"), of("--json")]);
        assert_eq!(code, Some(0), "{name:?}: {err}");
        let summary: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert_eq!(summary["output"], String::from_utf8_lossy(map.as_bytes()).as_ref());
        assert_eq!(run(dir, &[of("info"), &map]).0, Some(0));
        assert_eq!(run(dir, &[of("mesh"), &map, of("-o"), &mesh]).0, Some(0));
        assert_eq!(run(dir, &[of("map"), &joined(name, "nothere")]).0, Some(1));
        assert_eq!(run(dir, &[of("map"), &data, of("--voxels"), &data]).0, Some(2));
    }
}

#[test]
fn a_limit_on_the_size_of_files_is_an_error_of_writing() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    room::write(&dir.join("room"), 4);
    works(dir, "map room -o a.vox --voxel-size 0.1");
    let script = "ulimit -f 20; exec \"$0\" mesh a.vox -o a.ply";
    let output = Command::new("sh").args(["-c", script, env!("CARGO_BIN_EXE_voxelastic")]).current_dir(dir).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("a.ply") && message.contains("File too large"), "{message}");
    assert!(!dir.join("a.ply").exists() && std::fs::read_dir(dir).unwrap().all(|entry| !entry.unwrap().file_name().as_bytes().starts_with(b".")));
}

/// What a shell, a service or a container may leave of files that are open at a time, and of stacks.
#[test]
fn few_files_and_small_stacks_are_enough() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    room::write(&dir.join("room"), 8);
    works(dir, "map room -o whole.vox --voxel-size 0.1 --field both");
    for limit in ["ulimit -n 32", "ulimit -s 128", "export RUST_MIN_STACK=16384"] {
        let commands = [
            "map room -o a.vox --voxel-size 0.1 --field both --checkpoints 2 --report --restart",
            "live --from room --rate max -o b.vox --voxel-size 0.1 --restart",
            "mesh a.vox -o a.ply",
            "export a.vox -o a.copc.laz",
            "export a.vox -o tiles/",
            "render a.vox -o a.png",
            "localize a.vox room",
        ];
        for command in commands {
            let script = format!("{limit}; exec \"$0\" {command}");
            let output = Command::new("sh").args(["-c", &script, env!("CARGO_BIN_EXE_voxelastic")]).current_dir(dir).output().unwrap();
            assert_eq!(output.status.code(), Some(0), "{limit}; {command}: {}", String::from_utf8_lossy(&output.stderr));
        }
        assert_eq!(json(dir, "info a.vox --check --json")["scans"], 8);
        let [whole, limited] = ["whole.vox", "a.vox"].map(|map| crate::faults::resume::content(&dir.join(map)));
        assert_eq!(whole, limited, "{limit}");
    }
}
