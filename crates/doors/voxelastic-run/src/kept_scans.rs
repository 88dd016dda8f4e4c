//! Scans of a robot, kept on disk so that submaps can be rebuilt from them: the robot does not deliver them twice.

use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::error::Error;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use voxelastic::event::NodeId;
use voxelastic::mapper::ScanSource;
use voxelastic::{Cloud, Motion};

/// Scans of one file, in bytes: what is too old goes with a whole file.
const PIECE: u64 = 128 << 20;

/// Clouds by the nodes at which they were taken, in files without names: they go with the process, however that ends. Beyond a size the oldest are given up.
#[derive(Debug)]
pub struct KeptScans {
    folder: PathBuf,
    most_bytes: u64,
    pieces: VecDeque<Piece>,
    /// Number of the first of the pieces.
    first: usize,
    at: BTreeMap<NodeId, Place>,
}

#[derive(Debug)]
struct Piece {
    file: File,
    bytes: u64,
    nodes: Vec<NodeId>,
}

#[derive(Clone, Copy, Debug)]
struct Place {
    piece: usize,
    begin: u64,
    bytes: usize,
}

/// A cloud as it is written.
#[derive(Serialize)]
struct Stored<'a> {
    points: &'a [[f32; 3]],
    size: [usize; 2],
    intensity: Option<&'a [f32]>,
    colours: Option<&'a [[u8; 3]]>,
    ring: Option<&'a [u16]>,
    time: Option<&'a [f32]>,
    motion: Option<&'a Motion>,
    sensor: u16,
}

/// The same as it is read.
#[derive(Deserialize)]
struct Read {
    points: Vec<[f32; 3]>,
    size: [usize; 2],
    intensity: Option<Vec<f32>>,
    colours: Option<Vec<[u8; 3]>>,
    ring: Option<Vec<u16>>,
    time: Option<Vec<f32>>,
    motion: Option<Motion>,
    sensor: u16,
}

impl KeptScans {
    /// None yet; at most about `most_bytes` of them, in `folder`.
    pub fn new(folder: &Path, most_bytes: u64) -> Self {
        Self { folder: folder.to_owned(), most_bytes, pieces: VecDeque::new(), first: 0, at: BTreeMap::new() }
    }

    /// Whether the scan of a node is kept.
    pub fn has(&self, node: NodeId) -> bool {
        self.at.contains_key(&node)
    }

    /// Bytes on disk.
    pub fn bytes(&self) -> u64 {
        self.pieces.iter().map(|piece| piece.bytes).sum()
    }

    /// Keeps a scan.
    ///
    /// # Errors
    /// Those of the system: the scan is not kept.
    pub fn add(&mut self, node: NodeId, cloud: &Cloud) -> io::Result<()> {
        let stored = Stored {
            points: &cloud.points,
            size: [cloud.width, cloud.height],
            intensity: cloud.intensity.as_deref(),
            colours: cloud.colours.as_deref(),
            ring: cloud.ring.as_deref(),
            time: cloud.time.as_deref(),
            motion: cloud.motion.as_ref(),
            sensor: cloud.sensor,
        };
        let data = postcard::to_allocvec(&stored).map_err(io::Error::other)?;
        if self.pieces.back().is_none_or(|piece| piece.bytes >= PIECE.min(self.most_bytes / 4)) {
            self.pieces.push_back(Piece { file: tempfile::tempfile_in(&self.folder)?, bytes: 0, nodes: Vec::new() });
        }
        let number = self.first + self.pieces.len() - 1;
        let Some(piece) = self.pieces.back_mut() else { return Ok(()) };
        write_at(&mut piece.file, &data, piece.bytes)?;
        self.at.insert(node, Place { piece: number, begin: piece.bytes, bytes: data.len() });
        piece.nodes.push(node);
        piece.bytes += data.len() as u64;
        while self.bytes() > self.most_bytes && self.pieces.len() > 1 {
            let gone = self.pieces.pop_front().map(|piece| piece.nodes).unwrap_or_default();
            self.first += 1;
            for node in gone {
                self.at.remove(&node);
            }
        }
        Ok(())
    }

    /// Gives up all of them.
    pub fn clear(&mut self) {
        *self = Self::new(&self.folder, self.most_bytes);
    }
}

impl ScanSource for KeptScans {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        let Place { piece, begin, bytes } = *self.at.get(&node).ok_or("it is not kept")?;
        let piece = self.pieces.get_mut(piece - self.first).ok_or("it is not kept any more")?;
        let mut data = vec![0; bytes];
        read_at(&mut piece.file, &mut data, begin)?;
        let Read { points, size: [width, height], intensity, colours, ring, time, motion, sensor } = postcard::from_bytes(&data)?;
        Ok(Cloud { points, width, height, intensity, colours, ring, time, motion, sensor })
    }
}

fn write_at(file: &mut File, data: &[u8], begin: u64) -> io::Result<()> {
    use std::io::{Seek, SeekFrom, Write};
    file.seek(SeekFrom::Start(begin))?;
    file.write_all(data)
}

fn read_at(file: &mut File, data: &mut [u8], begin: u64) -> io::Result<()> {
    use std::io::{Read, Seek, SeekFrom};
    file.seek(SeekFrom::Start(begin))?;
    file.read_exact(data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Pose;

    fn cloud(seed: u32) -> Cloud {
        let points: Vec<[f32; 3]> = (0..1000).map(|k| [seed as f32, k as f32 * 0.37, if k % 7 == 0 { f32::NAN } else { -1.5 }]).collect();
        Cloud {
            width: 100,
            height: 10,
            intensity: Some((0..1000).map(|k| k as f32).collect()),
            ring: Some((0..1000).map(|k| (k / 100) as u16).collect()),
            time: seed.is_multiple_of(2).then(|| (0..1000).map(|k| k as f32 * 1e-4).collect()),
            motion: Motion::through([(0.0, Pose::identity()), (0.1, Pose::translation(0.5, 0.0, 0.0))]),
            sensor: 3,
            points,
            ..Cloud::default()
        }
    }

    /// As text, in which what is not a number equals itself.
    fn words(cloud: &Cloud) -> String {
        format!("{cloud:?}")
    }

    #[test]
    fn clouds_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let mut kept = KeptScans::new(folder.path(), 1 << 30);
        (0..9).for_each(|n| kept.add(n, &cloud(n as u32)).unwrap());
        for n in [3, 0, 8] {
            assert_eq!(words(&kept.cloud(n).unwrap()), words(&cloud(n as u32)));
        }
        assert!(kept.has(8) && !kept.has(9) && kept.cloud(9).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the files have no names");
        kept.clear();
        assert!(!kept.has(3) && kept.bytes() == 0);
    }

    #[test]
    fn the_oldest_are_given_up() {
        let folder = tempfile::tempdir().unwrap();
        let mut kept = KeptScans::new(folder.path(), 200_000);
        (0..100).for_each(|n| kept.add(n, &cloud(n as u32)).unwrap());
        assert!(kept.bytes() <= 200_000 && kept.bytes() > 100_000, "{}", kept.bytes());
        let first = (0..100).find(|&n| kept.has(n)).unwrap();
        assert!(first > 80 && (first..100).all(|n| kept.has(n)));
        assert_eq!(words(&kept.cloud(first).unwrap()), words(&cloud(first as u32)));
        assert!(kept.cloud(first - 1).is_err());
    }
}
