//! Whether data are the same as before, by what can be seen without reading all of them.

use std::path::Path;
use std::time::UNIX_EPOCH;
use voxelastic::Pose;
use xxhash_rust::xxh3::Xxh3;

/// Adds up what data are made of.
#[derive(Default)]
pub(crate) struct Fingerprint(Xxh3);

impl Fingerprint {
    /// Name, length and time of change of a file, or of what is in a folder. A file that is not there counts, too.
    pub(crate) fn file(&mut self, path: &Path) {
        self.bytes(path.file_name().unwrap_or_default().as_encoded_bytes());
        let Ok(metadata) = path.metadata() else { return };
        if metadata.is_dir() {
            let mut names: Vec<_> = path.read_dir().into_iter().flatten().flatten().map(|entry| entry.path()).filter(|path| path.is_file()).collect();
            names.sort();
            names.iter().for_each(|path| self.file(path));
            return;
        }
        let changed = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        self.numbers([metadata.len(), changed.map_or(0, |since| since.as_nanos() as u64)]);
    }

    pub(crate) fn numbers(&mut self, numbers: impl IntoIterator<Item = u64>) {
        numbers.into_iter().for_each(|number| self.bytes(&number.to_le_bytes()));
    }

    pub(crate) fn pose(&mut self, pose: &Pose) {
        self.numbers(pose.translation.vector.iter().chain(pose.rotation.coords.iter()).map(|v| v.to_bits()));
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
        // Names do not run into each other.
        self.0.update(&[0xff]);
    }

    pub(crate) fn digest(&self) -> u64 {
        self.0.digest()
    }
}
