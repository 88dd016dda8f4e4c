//! Kills at random moments: a few with every test run, and as many as wanted by a command of its own, which the book's chapter on reliability has.

use crate::elastic::sessions::{copy, drive, files};
use crate::faults::resume::{Numbers, compare, content, ends, grown, simulated};
use crate::{fails, json, room, works};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use voxelastic::Pose;
use voxelastic_io::poses;

/// A file, or those of a folder by their paths in it.
type Files = BTreeMap<PathBuf, Vec<u8>>;

/// A command that is killed until it comes to its end, and what of it is compared.
enum Subject {
    /// `map DATA` or `live --from DATA --rate max`: the map with that of a run that was not killed.
    Run(String),
    /// A command and the file or folder that it writes: that of before, or the new one.
    Output { command: &'static str, file: &'static str, before: Files, whole: Option<(Files, Duration)> },
    /// `map DATA --into MAP`: the map of before, byte for byte, or that of a run that was not killed.
    Addition { data: &'static str, whole: Option<(BTreeMap<String, Vec<u8>>, Duration)> },
}

/// What was tried.
#[derive(Clone, Copy, Default)]
struct Tally {
    kills: usize,
    compared: usize,
}

impl Subject {
    fn output(command: &'static str, file: &'static str) -> Self {
        Self::Output { command, file, before: Files::from([(PathBuf::new(), b"before".to_vec())]), whole: None }
    }

    fn addition(data: &'static str) -> Self {
        Self::Addition { data, whole: None }
    }

    fn name(&self) -> String {
        match self {
            Self::Run(arguments) => arguments.clone(),
            Self::Output { command, file, .. } => format!("{command} {file}"),
            Self::Addition { data, .. } => format!("map {data} --into MAP"),
        }
    }

    /// Tries it a few times in `dir`, where `made.vox` is the map that outputs are made of and drives are added to.
    fn kill(&mut self, dir: &Path, numbers: &mut Numbers) -> Tally {
        match self {
            Self::Run(arguments) => Tally { kills: compare(dir, arguments, 1, numbers), compared: 1 },
            Self::Output { command, file, before, whole } => {
                let (arguments, path) = (format!("{command} {file}"), dir.join(*file));
                let (whole, takes) = whole.get_or_insert_with(|| {
                    let clock = Instant::now();
                    works(dir, &arguments);
                    (written(&path), clock.elapsed())
                });
                let mut tally = Tally::default();
                for _ in 0..10 {
                    replace(&path, before);
                    let has_ended = ends(dir, &arguments, *takes, numbers);
                    let now = written(&path);
                    let are_there = |files: &Files| files.iter().all(|(name, bytes)| now.get(name) == Some(bytes));
                    assert!(are_there(whole) || !has_ended && are_there(before), "{arguments}: {:?}", now.keys());
                    tally = Tally { kills: tally.kills + usize::from(!has_ended), compared: tally.compared + 1 };
                }
                // One that comes to its end leaves nothing of those that did not.
                works(dir, &arguments);
                assert_eq!(written(&path).keys().collect::<Vec<_>>(), whole.keys().collect::<Vec<_>>(), "{arguments}");
                let litter = |folder: &Path| fs::read_dir(folder).unwrap().any(|entry| entry.unwrap().file_name().to_string_lossy().starts_with('.'));
                assert!(!litter(dir), "{arguments}");
                tally
            }
            Self::Addition { data, whole } => {
                let (whole, takes) = whole.get_or_insert_with(|| {
                    copy(&dir.join("made.vox"), &dir.join("whole.vox"));
                    let clock = Instant::now();
                    works(dir, &format!("map {data} --into whole.vox"));
                    let takes = clock.elapsed();
                    let found = content(&dir.join("whole.vox"));
                    fs::remove_dir_all(dir.join("whole.vox")).unwrap();
                    (found, takes)
                });
                add(dir, data, whole, *takes, numbers)
            }
        }
    }
}

/// The files that are at `path`.
fn written(path: &Path) -> Files {
    let (mut found, mut left) = (Files::new(), vec![path.to_owned()]);
    while let Some(next) = left.pop() {
        if next.is_dir() {
            left.extend(fs::read_dir(next).unwrap().map(|entry| entry.unwrap().path()));
        } else {
            found.insert(next.strip_prefix(path).unwrap().to_owned(), fs::read(next).unwrap());
        }
    }
    found
}

/// Makes `path` what it was.
fn replace(path: &Path, files: &Files) {
    let _ = fs::remove_dir_all(path);
    for (name, bytes) in files {
        let file = if name.as_os_str().is_empty() { path.to_owned() } else { path.join(name) };
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, bytes).unwrap();
    }
}

/// The folder of tiles of a map, in which those of another one were.
fn tiles(dir: &Path) -> Subject {
    works(dir, "map first -o coarse.vox --voxel-size 0.5 --max-range 20");
    works(dir, "export coarse.vox -o tiles/");
    Subject::Output { command: "export made.vox -o", file: "tiles/", before: written(&dir.join("tiles")), whole: None }
}

/// Adds a drive to a copy of the map until it is in, with kills. After each, the map is that of before or the new one, and opens.
fn add(dir: &Path, data: &str, whole: &BTreeMap<String, Vec<u8>>, takes: Duration, numbers: &mut Numbers) -> Tally {
    let map = dir.join("killed.vox");
    copy(&dir.join("made.vox"), &map);
    let before = files(&map);
    let arguments = format!("map {data} --into killed.vox --checkpoints 2");
    let mut tally = Tally::default();
    let has_ended = loop {
        let has_ended = ends(dir, &arguments, grown(takes, tally.kills), numbers);
        tally = Tally { kills: tally.kills + usize::from(!has_ended), compared: tally.compared + 1 };
        assert!(tally.kills < 500, "no run comes to its end: {arguments}");
        if json(dir, "info killed.vox --check --json")["sessions"].as_array().unwrap().len() == 2 {
            break has_ended;
        }
        let now = files(&map);
        assert!(!has_ended && before.iter().all(|(name, bytes)| now.get(name) == Some(bytes)), "{arguments}, after {} kills", tally.kills);
    };
    if !has_ended {
        // It was killed when all was written: the same command finds that there is nothing left to do.
        fails(dir, &arguments, 1, &["is this run already"]);
    }
    let now = content(&map);
    assert_eq!(whole.keys().collect::<Vec<_>>(), now.keys().collect::<Vec<_>>(), "{arguments}, after {} kills", tally.kills);
    assert!(whole == &now, "{arguments}, after {} kills", tally.kills);
    fs::remove_dir_all(map).unwrap();
    tally
}

/// Two drives through a street that overlap, the second also in a frame of its own, and the map of the first.
fn drives(dir: &Path) {
    works(dir, "simulate street -o street --laps 0.6 --spacing 3 --columns 128 -q");
    let all = poses::read(dir.join("street/groundtruth.tum")).unwrap().len();
    drive(dir, "first", 0..all * 2 / 3, "groundtruth.tum", &Pose::identity(), 1.0);
    drive(dir, "second", all / 3..all, "groundtruth.tum", &Pose::identity(), 1.0);
    let turned = Pose::new(nalgebra::Vector3::new(300.0, -120.0, 4.0), nalgebra::Vector3::new(0.0, 0.0, 2.1));
    drive(dir, "turned", all / 3..all, "groundtruth.tum", &turned, 1.0);
    fs::remove_dir_all(dir.join("street")).unwrap();
    works(dir, "map first -o made.vox --voxel-size 0.3 --max-range 30");
}

#[test]
fn a_killed_session_goes_on_and_the_map_is_the_old_or_the_new_one() {
    let dir = tempfile::tempdir().unwrap();
    drives(dir.path());
    let (mut numbers, mut kills) = (Numbers(3), 0);
    for data in ["second", "turned"] {
        let mut subject = Subject::addition(data);
        kills += (0..2).map(|_| subject.kill(dir.path(), &mut numbers).kills).sum::<usize>();
    }
    assert!(kills > 0);
}

#[test]
fn a_killed_output_is_the_old_or_the_new_file() {
    let dir = tempfile::tempdir().unwrap();
    simulated(dir.path());
    works(dir.path(), "map street --voxel-size 0.4 --max-range 20 -o made.vox");
    let mut numbers = Numbers(11);
    let outputs = ["m.ply", "m.las", "m.copc.laz"]
        .map(|file| Subject::output(if file.ends_with("ply") { "mesh made.vox -o" } else { "export made.vox -o" }, file));
    let kills: usize = outputs.into_iter().map(|mut output| output.kill(dir.path(), &mut numbers).kills).sum();
    assert!(kills > 0);
}

#[test]
#[ignore = "half an hour: the command for 1,000 kills is in the book's chapter on reliability"]
fn a_thousand_kills() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    drives(dir);
    simulated(dir);
    room::write(&dir.join("room"), 60);
    fs::remove_file(dir.join("room/poses.tum")).unwrap();
    let number = |name: &str, default: u64| std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default);
    let (most, mut numbers) = (number("VOXELASTIC_KILLS", 1000) as usize, Numbers(number("PROPTEST_RNG_SEED", 7)));
    let mut maps =
        ["", " --field both", " --optimize", " --loops"].map(|flags| format!("map street --voxel-size 0.3 --max-range 30{flags}")).to_vec();
    // Sweeps with an inertial unit, of which the motions are known to the run alone.
    works(dir, "simulate room -o walk --moving --rate 10 --imu 100 --columns 128 --carrier handheld --rest 1 --scans 80 --bag");
    let without_poses =
        ["map room --voxel-size 0.05", "map room --voxel-size 0.05 --no-loops", "map walk/recording.mcap --voxel-size 0.1 --every scan"];
    maps.extend(without_poses.map(str::to_owned));
    // The same, played.
    let played: Vec<String> = maps.iter().map(|map| format!("{} --rate max", map.replacen("map ", "live --from ", 1))).collect();
    let outputs =
        [("mesh made.vox -o", "m.ply"), ("export made.vox -o", "m.las"), ("export made.vox -o", "m.copc.laz"), ("render made.vox -o", "m.png")];
    let mut subjects: Vec<(&str, Subject)> = outputs.map(|(command, file)| ("outputs", Subject::output(command, file))).into();
    subjects.push(("outputs", tiles(dir)));
    subjects.extend(maps.into_iter().map(|map| ("map", Subject::Run(map))));
    subjects.extend(played.into_iter().map(|live| ("live", Subject::Run(live))));
    subjects.extend(["second", "turned"].map(|data| ("into", Subject::addition(data))));
    if let Ok(which) = std::env::var("VOXELASTIC_KILLED") {
        subjects.retain(|(kind, _)| which.split(',').any(|wanted| wanted == *kind));
    }
    let mut tallies = vec![Tally::default(); subjects.len()];
    let kills = |tallies: &[Tally]| tallies.iter().map(|tally| tally.kills).sum::<usize>();
    while !subjects.is_empty() && kills(&tallies) < most {
        for ((_, subject), tally) in subjects.iter_mut().zip(&mut tallies) {
            let Tally { kills, compared } = subject.kill(dir, &mut numbers);
            *tally = Tally { kills: tally.kills + kills, compared: tally.compared + compared };
            println!("| `{}` | {} | {} | 0 |", subject.name(), tally.kills, tally.compared);
        }
    }
    println!("{} kills, {} results compared, 0 lost", kills(&tallies), tallies.iter().map(|tally| tally.compared).sum::<usize>());
}
