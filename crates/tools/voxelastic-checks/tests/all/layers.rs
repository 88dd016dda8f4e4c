//! The sources of this workspace follow the layers that `ARCHITECTURE.md` draws.

use voxelastic_checks::checks::Workspace;

fn holds(found: Result<Vec<String>, String>) {
    let found = found.unwrap();
    assert!(found.is_empty(), "{} problems:\n{}\n`cargo run -p voxelastic-checks` prints the drawing.", found.len(), found.join("\n"));
}

#[test]
fn crates_import_lower_crates_only() {
    holds(Workspace::this().crate_arrows());
}

#[test]
fn rooms_import_lower_rooms_only() {
    holds(Workspace::this().room_arrows());
}

#[test]
fn files_do_not_depend_on_each_other_in_cycles() {
    holds(Workspace::this().file_cycles());
}

#[test]
fn unsafe_code_is_in_the_files_named_for_it() {
    holds(Workspace::this().unsafe_files());
}

#[test]
fn no_folder_has_so_many_files_that_nobody_finds_one() {
    holds(Workspace::this().full_folders());
}
