//! What the fuzz targets share. One target per reader; each reads whatever libFuzzer makes up and checks what comes out.
//!
//! ```sh
//! cargo install cargo-fuzz
//! python3 fuzz/seeds.py fuzz/seeds DATA                  # files to start from: by other people's software, and beginnings of real ones
//! RUSTC_BOOTSTRAP=1 cargo fuzz run -s none ros1 fuzz/corpus/ros1 fuzz/seeds/ros1 -- -max_total_time=600 -timeout=10 -rss_limit_mb=2048
//! ```

pub mod dumps;
pub mod maps;
pub mod message;

use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use voxelastic::Cloud;
use voxelastic::event::Event;
use voxelastic_io::bag::{self, Recording};
use voxelastic_io::dataset::Keyframing;
use voxelastic_io::{CloudFormat, OpenOptions, clouds};

/// No recording of the size that is tried here has more events.
const MOST_EVENTS: usize = 20_000;
/// What is tried is smaller than 100 kB: more memory than this is asked for by a claim.
const MOST_MEMORY_MB: u64 = 300;

/// Asserts that the process never held more memory than it should. Does nothing where the system does not tell.
pub fn check_memory() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse::<u64>().ok());
    assert!(peak.is_none_or(|kb| kb < 1000 * MOST_MEMORY_MB), "{peak:?} kB of memory");
}

/// Asserts what every cloud promises.
pub fn check(cloud: &Cloud) {
    let n = cloud.points.len();
    assert!(cloud.width.checked_mul(cloud.height) == Some(n) && cloud.points.iter().any(Cloud::is_return));
    let lengths = [
        cloud.intensity.as_ref().map(Vec::len),
        cloud.colours.as_ref().map(Vec::len),
        cloud.ring.as_ref().map(Vec::len),
        cloud.time.as_ref().map(Vec::len),
    ];
    assert!(lengths.iter().flatten().all(|len| *len == n));
}

/// Reads a cloud.
pub fn read_cloud(data: &[u8], format: CloudFormat) {
    if let Ok(read) = clouds::parse(data, Path::new("a"), format) {
        check(&read.cloud);
    }
    check_memory();
}

/// A folder of this process, in memory if possible.
pub fn folder() -> &'static Path {
    static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
        let memory = Path::new("/dev/shm");
        let folder = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() }.join(format!("voxelastic-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder to write to");
        folder
    });
    &FOLDER
}

/// Puts `data` into a file of this process with the given ending.
pub fn file(data: &[u8], ending: &str) -> PathBuf {
    let path = folder().join(format!("a.{ending}"));
    std::fs::write(&path, data).expect("space to write to");
    path
}

/// Describes and plays a recording, every scan of it.
pub fn play(data: &[u8], ending: &str) {
    play_with(data, ending, &OpenOptions { keyframing: Some(Keyframing::All), ..OpenOptions::default() });
}

/// Describes and plays a recording.
pub fn play_with(data: &[u8], ending: &str, options: &OpenOptions) {
    let path = file(data, ending);
    let _ = bag::describe(&path, options);
    if let Ok(recording) = Recording::open(&path, options) {
        let mut events = 0;
        for event in recording.events() {
            events += 1;
            assert!(events < MOST_EVENTS, "no end of events");
            if let Ok(Event::Scan(scan)) = event {
                check(&scan.cloud);
            }
        }
    }
    check_memory();
}
