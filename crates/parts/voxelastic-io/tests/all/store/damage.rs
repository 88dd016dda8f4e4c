//! Damaged, foreign and malicious maps: each gets an error that says what is wrong, none a panic.

use crate::store::world::{details, made_up_atlas, same_atlas, same_submap};
use std::fs;
use std::path::{Path, PathBuf};
use voxelastic::atlas::Atlas;
use voxelastic_io::store::{FORMAT_VERSION, MapStore, MapWriter};
use voxelastic_io::{Error, Result};

/// A small map and where its files are.
struct Map {
    dir: tempfile::TempDir,
    atlas: Atlas,
    manifest: PathBuf,
    /// The file of submap 0, which has all fields.
    whole: PathBuf,
    /// The file of submap 1, which has a TSDF only.
    submap: PathBuf,
}

fn map() -> Map {
    let dir = tempfile::tempdir().unwrap();
    let atlas = made_up_atlas(3, 2, 12);
    let mut writer = MapWriter::create(dir.path()).unwrap();
    writer.save(&atlas, &details("damage")).unwrap();
    let file = |id: usize| dir.path().join(&writer.store().manifest().submaps[id].file);
    Map { manifest: dir.path().join("manifest.json"), whole: file(0), submap: file(1), atlas, dir }
}

fn load(dir: &Path) -> Result<Atlas> {
    MapStore::open(dir)?.load_atlas()
}

/// Runs `change` on the bytes of `file` and puts them back afterwards.
fn with_changed(file: &Path, change: impl FnOnce(&mut Vec<u8>), then: impl FnOnce()) {
    // Some file systems wait for the disk when a file is overwritten, but not when it is new.
    let put = |bytes: Vec<u8>| fs::remove_file(file).and_then(|()| fs::write(file, bytes)).unwrap();
    let original = fs::read(file).unwrap();
    let mut bytes = original.clone();
    change(&mut bytes);
    put(bytes);
    then();
    put(original);
}

/// Replaces `from` by `to` in the manifest and mends its checksum.
fn rewrite_manifest(map: &Map, from: &str, to: &str) {
    let text = fs::read_to_string(&map.manifest).unwrap();
    assert!(text.contains(from), "{text}");
    fs::write(&map.manifest, mended(&text.replace(from, to))).unwrap();
}

fn mended(text: &str) -> String {
    let at = text.find("\"crc32\": \"").unwrap() + 10;
    let zeros = format!("{}00000000{}", &text[..at], &text[at + 8..]);
    format!("{}{:08x}{}", &text[..at], crc32fast::hash(zeros.as_bytes()), &text[at + 8..])
}

#[test]
fn every_flipped_bit_is_noticed() {
    let map = map();
    let mut noticed = 0;
    for file in [&map.manifest, &map.whole, &map.submap] {
        let length = fs::metadata(file).unwrap().len() as usize;
        for at in (0..length).step_by(1 + length / 1000) {
            with_changed(
                file,
                |bytes| bytes[at] ^= 1 << (at * 5 % 8),
                || match load(map.dir.path()) {
                    Ok(atlas) => assert!(same_atlas(&atlas, &map.atlas), "byte {at} of {}", file.display()),
                    Err(error) => {
                        noticed += 1;
                        let file_name = file.file_name().unwrap().to_str().unwrap();
                        assert!(error.to_string().contains(file_name), "{error}");
                    }
                },
            );
        }
    }
    assert!(noticed > 2000, "{noticed}");
    assert!(same_atlas(&load(map.dir.path()).unwrap(), &map.atlas));
}

#[test]
fn every_byte_of_a_small_map_is_guarded() {
    let dir = tempfile::tempdir().unwrap();
    let atlas = made_up_atlas(3, 2, 1);
    MapWriter::create(dir.path()).unwrap().save(&atlas, &details("small")).unwrap();
    let files = fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().path());
    let (mut bytes, mut skipped) = (0, 0);
    for file in files.filter(|path| !path.ends_with(".lock")) {
        let name = file.file_name().unwrap().to_str().unwrap();
        let length = fs::metadata(&file).unwrap().len() as usize;
        assert!(length < 10_000, "{name}: {length} bytes");
        for at in 0..length {
            let flip = |bytes: &mut Vec<u8>| bytes[at] ^= 1 << (at % 8);
            with_changed(&file, flip, || {
                // Without what is damaged: the manifest is needed, of the submaps the others are as they were.
                let error = match MapStore::open(dir.path()).and_then(|store| store.load_undamaged()) {
                    Err(error) => error,
                    Ok((found, mut damage)) => {
                        assert!(damage.len() == 1 && found.submaps().len() == 1, "byte {at} of {name}: {damage:?}");
                        assert!(same_submap(&found.submaps()[0], atlas.submap(found.submaps()[0].id()).unwrap()), "byte {at} of {name}");
                        skipped += 1;
                        damage.remove(0)
                    }
                };
                assert!(error.to_string().contains(name), "byte {at}: {error}");
            });
        }
        bytes += length;
    }
    println!("{bytes} bytes, of which {skipped} cost one submap");
    assert!(skipped > bytes / 3, "{skipped} of {bytes}");
}

#[test]
fn every_truncation_and_every_tail_is_noticed() {
    let map = map();
    for file in [&map.manifest, &map.whole, &map.submap] {
        let length = fs::metadata(file).unwrap().len() as usize;
        for keep in (0..length).step_by(1 + length / 200) {
            with_changed(file, |bytes| bytes.truncate(keep), || assert!(load(map.dir.path()).is_err(), "{keep} of {length} bytes"));
        }
        with_changed(file, |bytes| bytes.push(b'x'), || assert!(load(map.dir.path()).is_err()));
        with_changed(file, |bytes| bytes.fill(0), || assert!(load(map.dir.path()).is_err()));
    }
    with_changed(
        &map.submap,
        |bytes| bytes.truncate(100),
        || {
            let error = load(map.dir.path()).unwrap_err();
            assert!(matches!(&error, Error::Damaged { section, offset: 100, .. } if section == "length"), "{error}");
        },
    );
}

#[test]
fn the_damaged_page_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = MapWriter::create(dir.path()).unwrap();
    writer.save(&made_up_atlas(5, 3, 5000), &details("pages")).unwrap();
    for (id, field) in [(1, "tsdf section"), (2, "occupancy section")] {
        let path = dir.path().join(&writer.store().manifest().submaps[id as usize].file);
        let mut bytes = fs::read(&path).unwrap();
        // Ten bytes before the end of the first section: its length is in the first row of the table, at byte 36.
        let [start, length] = [28, 36].map(|at| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize);
        let at = start + length - 10;
        bytes[at] ^= 4;
        fs::write(&path, &bytes).unwrap();
        for error in [writer.store().load_submap(id).unwrap_err(), writer.store().check().pop().unwrap()] {
            let Error::Damaged { section, offset, what, .. } = &error else { panic!("{error}") };
            assert!(section == field && *offset > 1000 && *offset < at as u64 && what.starts_with("page "), "{error}");
        }
    }
    assert!(matches!(load(dir.path()), Err(Error::Damaged { section, .. }) if section == "tsdf section"), "the first is reported");
}

#[test]
fn files_that_are_missing_or_not_files_are_named() {
    let map = map();
    let aside = map.submap.with_extension("aside");
    fs::rename(&map.submap, &aside).unwrap();
    let error = load(map.dir.path()).unwrap_err();
    assert!(matches!(&error, Error::Missing { path } if *path == map.submap), "{error}");
    assert!(MapStore::open(map.dir.path()).unwrap().load_submap(0).is_ok(), "the other submap is still there");
    fs::create_dir(&map.submap).unwrap();
    assert!(matches!(load(map.dir.path()).unwrap_err(), Error::Damaged { path, .. } if path == map.submap));
    fs::remove_dir(&map.submap).unwrap();
    fs::rename(&aside, &map.submap).unwrap();
    assert!(load(map.dir.path()).is_ok());
    fs::remove_file(&map.manifest).unwrap();
    assert!(matches!(MapStore::open(map.dir.path()), Err(Error::NotAMap { .. })));
}

#[test]
fn a_submap_in_the_place_of_another_is_noticed() {
    // Equal in every length, so that only identity differs.
    let dir = tempfile::tempdir().unwrap();
    let mut writer = MapWriter::create(dir.path()).unwrap();
    let mut atlas = made_up_atlas(3, 2, 12);
    let first = atlas.submaps()[0].clone();
    let second = atlas.submap_mut(1).unwrap();
    (*second.tsdf_mut(), *second.occupancy_mut()) = (first.tsdf().clone(), first.occupancy().clone());
    *second = second.clone().with_scans(first.scans().to_vec(), first.travelled());
    second.set_pose(first.t_map_submap());
    writer.save(&atlas, &details("swap")).unwrap();
    let files: Vec<PathBuf> = writer.store().manifest().submaps.iter().map(|e| dir.path().join(&e.file)).collect();
    fs::copy(&files[0], &files[1]).unwrap();
    let error = load(dir.path()).unwrap_err();
    assert!(error.to_string().contains("it is submap 0, the manifest says 1"), "{error}");
}

#[test]
fn manifests_that_name_files_elsewhere_are_refused() {
    let map = map();
    let name = map.submap.file_name().unwrap().to_str().unwrap().to_owned();
    let original = fs::read_to_string(&map.manifest).unwrap();
    for evil in ["../secret.vxs", "/etc/passwd", "submap-000001-../../x.vxs", "", ".lock", "manifest.json", "submap-000000-00000000000000aa.vxs"] {
        rewrite_manifest(&map, &name, evil);
        let error = MapStore::open(map.dir.path()).unwrap_err();
        assert!(matches!(&error, Error::Damaged { section, offset, .. } if section == "submap table" && *offset > 0), "{error}");
        fs::write(&map.manifest, &original).unwrap();
    }
}

#[test]
fn other_versions_are_refused_and_unknown_keys_are_not() {
    let map = map();
    let original = fs::read_to_string(&map.manifest).unwrap();
    let current = format!("\"version\": {FORMAT_VERSION}");
    let near = [FORMAT_VERSION - 1, FORMAT_VERSION + 1].map(|version| (version.to_string(), version));
    for (version, found) in near.into_iter().chain([("99999999999999999999".to_owned(), u32::MAX)]) {
        rewrite_manifest(&map, &current, &format!("\"version\": {version}"));
        let error = MapStore::open(map.dir.path()).unwrap_err();
        assert!(matches!(error, Error::OtherVersion { found: f, supported: FORMAT_VERSION, .. } if f == found), "{error}");
        let said = error.to_string();
        let names = said.contains("manifest.json") && said.contains(&format!("version {found},"));
        assert!(names && said.contains("map the data again") && error.remedy().contains("map the data again"), "{said}");
        assert!(matches!(MapWriter::create(map.dir.path()), Err(Error::OtherVersion { .. })), "it is not replaced");
        fs::write(&map.manifest, &original).unwrap();
    }
    rewrite_manifest(&map, "\"submaps\": [", "\"weather\": \"fine\",\n\"submaps\": [");
    assert!(same_atlas(&load(map.dir.path()).unwrap(), &map.atlas));
}

#[test]
fn manifests_with_impossible_content_are_refused() {
    let map = map();
    let original = fs::read_to_string(&map.manifest).unwrap();
    for (from, to) in [
        ("{\"id\":1,", "{\"id\":0,"),
        ("{\"id\":1,", "{\"id\":-1,"),
        ("{\"id\":1,", "{\"id\":4294967296,"),
        ("\"t_map_submap\":[", "\"t_map_submap\":[7.0,"),
        ("\"t_map_submap\":[", "\"t_map_submap\":[1e999,"),
        ("\"travelled\":", "\"travelled\":null,\"x\":"),
        ("\"settings\":", "\"setting\":"),
        ("\"scans\":[{", "\"scans\":[[[[[[[[{"),
    ] {
        rewrite_manifest(&map, from, to);
        let error = MapStore::open(map.dir.path()).unwrap_err();
        assert!(matches!(&error, Error::Damaged { offset, .. } if *offset > 0), "{from} -> {to}: {error}");
        fs::write(&map.manifest, &original).unwrap();
    }
}

#[test]
fn submap_files_of_other_versions_and_unknown_sections_are_refused() {
    let map = map();
    // Mends all checksums: of the submap file's head, which has two rows, and those that the manifest holds.
    let load_changed = |change: &dyn Fn(&mut Vec<u8>)| {
        let (manifest, submap) = (fs::read_to_string(&map.manifest).unwrap(), fs::read(&map.submap).unwrap());
        let mut bytes = submap.clone();
        change(&mut bytes);
        let crc32 = crc32fast::hash(&bytes[..68]);
        bytes[68..72].copy_from_slice(&crc32.to_le_bytes());
        fs::write(&map.submap, &bytes).unwrap();
        rewrite_manifest(&map, &crc32fast::hash(&submap).to_string(), &crc32fast::hash(&bytes).to_string());
        let error = load(map.dir.path()).unwrap_err();
        fs::write(&map.manifest, manifest).unwrap();
        fs::write(&map.submap, submap).unwrap();
        error
    };
    for version in [FORMAT_VERSION - 1, FORMAT_VERSION + 1] {
        let error = load_changed(&|bytes| bytes[8] = version as u8);
        assert!(matches!(error, Error::OtherVersion { found, supported: FORMAT_VERSION, .. } if found == version), "{error}");
    }
    let error = load_changed(&|bytes| bytes[20..24].copy_from_slice(b"heat"));
    assert!(matches!(&error, Error::UnknownSection { tag, offset: 72, .. } if tag == "heat"), "{error}");
    let error = load_changed(&|bytes| bytes[16] = 65);
    assert!(error.to_string().contains("claims 65 sections"), "{error}");
    for (what, at) in [("offset", 28), ("length", 36)] {
        let error = load_changed(&|bytes| bytes[at..at + 8].fill(0xff));
        assert!(matches!(&error, Error::Damaged { section, .. } if section == "section table"), "{what}: {error}");
    }
}
