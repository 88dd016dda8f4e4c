//! Recordings that were cut, never closed, damaged or made to harm.

use crate::drive::{every_scan, play};
use crate::fixture;
use std::path::Path;
use std::time::{Duration, Instant};
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
    // How long: by default a moment, longer where asked (VOXELASTIC_SOAK_S, seconds a format).
    let seconds = std::env::var("VOXELASTIC_SOAK_S").ok().and_then(|s| s.parse().ok()).unwrap_or(1.0);
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut random = move |n: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % n.max(1) as u64) as usize
    };
    for name in NAMES {
        let good = std::fs::read(fixture(name)).unwrap();
        let (clock, mut runs, mut opened, mut slowest) = (Instant::now(), 0, 0, Duration::ZERO);
        while clock.elapsed().as_secs_f64() < seconds {
            let mut bad = good.clone();
            for _ in 0..=random(6) {
                let at = random(bad.len());
                match random(5) {
                    0 => bad[at] ^= 1 << random(8),
                    1 => bad[at] = random(256) as u8,
                    2 => bad[at..].iter_mut().take(8).for_each(|b| *b = 0xff),
                    3 => bad.truncate(at.max(64)),
                    // Heads are where the lengths are.
                    _ => {
                        let at = random(512.min(bad.len()));
                        bad[at] = random(256) as u8;
                    }
                }
                if bad.len() < 64 {
                    break;
                }
            }
            let path = put(dir.path(), name, &bad);
            let start = Instant::now();
            if let Ok(recording) = Recording::open(&path, &every_scan()) {
                opened += 1;
                let events = recording.events().take(1000).count();
                assert!(events < 1000, "{name}: no end of events");
            }
            let _ = bag::describe(&path, &OpenOptions::default());
            slowest = slowest.max(start.elapsed());
            runs += 1;
        }
        eprintln!("{name}: {runs} damaged files, {opened} opened, the slowest took {slowest:?}");
        assert!(slowest < Duration::from_secs(5), "{name}: {slowest:?}");
    }
}
