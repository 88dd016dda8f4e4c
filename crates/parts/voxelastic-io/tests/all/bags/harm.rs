//! Recordings that were cut, never closed, damaged or made to harm.

use crate::bags::drive::{every_scan, play};
use crate::bags::fixture;
use crate::common::damage::soak;
use std::path::Path;
use std::time::Duration;
use voxelastic_io::bag::{self, Recording};
use voxelastic_io::{OpenOptions, Position};

const NAMES: [&str; 4] = ["ouster_bz2.bag", "velodyne_layout.mcap", "livox_layout.mcap", "ouster_packed.db3"];

/// Writes `bytes` under a name with the extension of the original.
fn put(dir: &Path, name: &str, bytes: &[u8]) -> std::path::PathBuf {
    let path = dir.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn cut_recordings_are_read_as_far_as_they_go() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["ouster_bz2.bag", "velodyne_layout.mcap"] {
        let whole = std::fs::read(fixture(name)).unwrap();
        let mut last = 0;
        for tenths in [5, 7, 9] {
            let path = put(dir.path(), name, &whole[..whole.len() * tenths / 10]);
            let (scans, errors) = play(&path, &every_scan());
            assert!(scans.len() >= last && scans.len() <= 12, "{name}: {} scans of {tenths} tenths", scans.len());
            assert!(scans.len() == 12 || errors.iter().any(|e| matches!(e.position(), Position::Byte(at) if at > 0)), "{name}: {errors:?}");
            let described = bag::describe(&path, &OpenOptions::default()).unwrap();
            assert!(described.notes.iter().any(|n| n.contains("no index")), "{described}");
            assert!(described.topics.iter().find(|t| t.name == "/points").unwrap().messages.unwrap() as usize >= scans.len());
            last = scans.len();
        }
        assert!(last >= 6, "{name}: {last} scans of nine tenths");
    }
}

#[test]
fn a_cut_database_is_read_as_far_as_it_goes() {
    let dir = tempfile::tempdir().unwrap();
    let whole = std::fs::read(fixture("ouster_packed.db3")).unwrap();
    let mut last = 0;
    for tenths in [5, 7, 9] {
        let path = put(dir.path(), "cut.db3", &whole[..whole.len() * tenths / 10]);
        assert!(bag::describe(&path, &OpenOptions::default()).unwrap().topics.iter().any(|t| t.name == "/points"), "{tenths} tenths");
        let (scans, errors) = play(&path, &every_scan());
        assert!(scans.len() >= last && scans.len() < 12, "{} scans of {tenths} tenths", scans.len());
        assert!(errors.iter().any(|e| e.to_string().contains("cut or damaged")), "{errors:?}");
        last = scans.len();
    }
    assert!(last >= 6, "{last} scans of nine tenths");
}

#[test]
fn recordings_that_were_never_closed_hold_all_their_scans() {
    let dir = tempfile::tempdir().unwrap();
    // A bag whose recorder was killed: no place of the index in its head, and no index.
    let mut bag = std::fs::read(fixture("ouster_bz2.bag")).unwrap();
    let place = bag.windows(10).position(|w| w == b"index_pos=").unwrap() + 10;
    let index = u64::from_le_bytes(bag[place..place + 8].try_into().unwrap());
    bag[place..place + 8].fill(0);
    bag.truncate(index as usize);
    // An MCAP file without the summary, which the last numbers but one of the footer tell the place of.
    let mut mcap = std::fs::read(fixture("velodyne_layout.mcap")).unwrap();
    let footer = mcap.len() - 8 - 20;
    let summary = u64::from_le_bytes(mcap[footer..footer + 8].try_into().unwrap());
    mcap.truncate(summary as usize);
    for (name, bytes) in [("killed.bag.active", bag), ("killed.mcap", mcap)] {
        let path = put(dir.path(), name, &bytes);
        let (scans, _) = play(&path, &every_scan());
        assert_eq!(scans.len(), 12, "{name}");
        let described = bag::describe(&path, &OpenOptions::default()).unwrap();
        assert!(described.notes.iter().any(|n| n.contains("no index")), "{described}");
        assert_eq!(described.topics.iter().find(|t| t.name == "/points").unwrap().messages, Some(12), "{name}");
    }
}

#[test]
fn a_damaged_chunk_costs_no_more_than_itself() {
    let dir = tempfile::tempdir().unwrap();
    let mut bytes = std::fs::read(fixture("velodyne_layout.mcap")).unwrap();
    let at = bytes.len() / 4;
    bytes[at..at + 8].fill(0x55);
    let (scans, errors) = play(&put(dir.path(), "a.mcap", &bytes), &every_scan());
    assert!(scans.len() >= 6 && scans.len() < 12 && !errors.is_empty(), "{} scans, {errors:?}", scans.len());
}

#[test]
fn flipped_bytes_never_panic_or_hang() {
    let dir = tempfile::tempdir().unwrap();
    for name in NAMES {
        let good = std::fs::read(fixture(name)).unwrap();
        soak(name, &good, 60, Duration::from_secs(5), |bad| {
            let path = put(dir.path(), name, bad);
            let _ = bag::describe(&path, &OpenOptions::default());
            let Ok(recording) = Recording::open(&path, &every_scan()) else { return false };
            let events = recording.events().take(1000).count();
            assert!(events < 1000, "{name}: no end of events");
            true
        });
    }
}
