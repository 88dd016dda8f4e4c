//! What shells and people are told about the program itself.

use crate::works;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// The subcommands, as the help lists them under its headings.
fn subcommands(help: &str) -> Vec<&str> {
    let rows = help.lines().skip_while(|line| *line != "Commands:").take_while(|line| *line != "Options:");
    rows.filter(|line| line.starts_with("  ")).filter_map(|line| line.split_whitespace().next()).collect()
}

#[test]
fn completions_of_each_shell_have_every_command() {
    let dir = tempfile::tempdir().unwrap();
    let help = works(dir.path(), "--help");
    let names = subcommands(&help);
    assert!(names.len() > 25, "{help}");
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = works(dir.path(), &format!("completions {shell}"));
        for name in &names {
            assert!(script.split(|c: char| !c.is_alphanumeric()).any(|word| word == *name), "{shell}: no {name}");
        }
    }
}

#[test]
fn bash_completes_commands_flags_and_values() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("completions"), works(dir.path(), "completions bash")).unwrap();
    let completed = |words: &[&str]| {
        let (last, before) = (words.len() - 1, words.len() - 2);
        let script = format!(
            "source ./completions; COMP_WORDS=({}); COMP_CWORD={last}; _voxelastic voxelastic '{}' '{}'; echo \"${{COMPREPLY[@]}}\"",
            words.iter().map(|w| format!("'{w}'")).collect::<Vec<_>>().join(" "),
            words[last],
            words[before]
        );
        let output = Command::new("bash").args(["--norc", "-c", &script]).current_dir(dir.path()).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stderr), "");
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    };
    assert_eq!(completed(&["voxelastic", "geo"]), "georeference");
    assert_eq!(completed(&["voxelastic", "map", "--voxel"]), "--voxel-size");
    assert_eq!(completed(&["voxelastic", "mesh", "hall.vox", "--surface", "occ"]), "occupied");
}

#[test]
fn the_version_is_one_line_and_the_long_one_says_what_was_built() {
    let dir = tempfile::tempdir().unwrap();
    let short = works(dir.path(), "-V");
    assert_eq!(short, format!("voxelastic {}\n", env!("CARGO_PKG_VERSION")));
    let long = works(dir.path(), "--version");
    assert!(long.starts_with(&short), "{long}");
    let keys: Vec<&str> = long.lines().skip(1).filter_map(|line| line.split_once(": ")).map(|(key, _)| key).collect();
    let commit: &[&str] = if option_env!("VOXELASTIC_COMMIT").is_some() { &["commit"] } else { &[] };
    assert_eq!(keys, [commit, &["features", "vector instructions"]].concat());
    assert!(long.contains(voxelastic::vector_instructions()), "{long}");
}

#[test]
fn the_service_is_called_with_flags_that_live_has() {
    let dir = tempfile::tempdir().unwrap();
    let help = works(dir.path(), "live --help");
    let files = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../release/files");
    let text: String = ["voxelastic.service", "default", "Containerfile"].map(|name| std::fs::read_to_string(files.join(name)).unwrap()).concat();
    let is_outside = |c: char| !(c.is_ascii_alphanumeric() || c == '-');
    let calls =
        text.lines().filter(|line| ["ExecStart=", "Environment=", "#VOXELASTIC_LIVE=", "CMD [\"live\""].iter().any(|start| line.starts_with(start)));
    let flags: BTreeSet<&str> = calls.flat_map(|line| line.split(is_outside)).filter(|word| word.starts_with('-')).collect();
    assert!(flags.is_superset(&BTreeSet::from(["-q", "-o", "--ros2", "--view", "--slam"])), "{flags:?}");
    for flag in flags {
        assert!(help.split(is_outside).any(|word| word == flag), "live has no {flag}");
    }
}
