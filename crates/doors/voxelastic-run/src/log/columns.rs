//! Columns of a run's log that lie on the disk: a run that goes on for hours would grow by them.

use serde::de::Deserializer;
use serde::ser::{Error, SerializeSeq, Serializer};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use voxelastic_report::{RunLog, ScanLog};

/// Scans whose columns are written to the disk together. At most as many are in memory.
pub const PIECE: usize = 1024;

/// What the log has of some scans that follow each other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Columns {
    scans: ScanLog,
    phases_ms: BTreeMap<String, Vec<f64>>,
}

impl Columns {
    /// Takes those of the first `scans` scans out of `log`.
    fn take(log: &mut RunLog, scans: usize) -> Self {
        fn first<T>(column: &mut Vec<T>, scans: usize) -> Vec<T> {
            let following = column.split_off(scans.min(column.len()));
            std::mem::replace(column, following)
        }
        let s = &mut log.scans;
        let taken = ScanLog {
            node: first(&mut s.node, scans),
            time_s: first(&mut s.time_s, scans),
            position: first(&mut s.position, scans),
            orientation: first(&mut s.orientation, scans),
            wall_ms: first(&mut s.wall_ms, scans),
            cpu_ms: first(&mut s.cpu_ms, scans),
            submap: first(&mut s.submap, scans),
            submaps: first(&mut s.submaps, scans),
            fusions_due: first(&mut s.fusions_due, scans),
            map_mb: first(&mut s.map_mb, scans),
            rss_mb: first(&mut s.rss_mb, scans),
        };
        let phases_ms = log.phases_ms.iter_mut().map(|(name, column)| (name.clone(), first(column, scans))).collect();
        Self { scans: taken, phases_ms }
    }

    /// A copy of all that `log` has.
    pub fn all_of(log: &RunLog) -> Self {
        Self { scans: log.scans.clone(), phases_ms: log.phases_ms.clone() }
    }

    /// Puts them behind those of `log`.
    pub fn append_to(self, log: &mut RunLog) {
        let (s, more) = (&mut log.scans, self.scans);
        s.node.extend(more.node);
        s.time_s.extend(more.time_s);
        s.position.extend(more.position);
        s.orientation.extend(more.orientation);
        s.wall_ms.extend(more.wall_ms);
        s.cpu_ms.extend(more.cpu_ms);
        s.submap.extend(more.submap);
        s.submaps.extend(more.submaps);
        s.fusions_due.extend(more.fusions_due);
        s.map_mb.extend(more.map_mb);
        s.rss_mb.extend(more.rss_mb);
        for (name, column) in self.phases_ms {
            log.phases_ms.entry(name).or_default().extend(column);
        }
    }
}

/// Columns on the disk, in a file without a name: it goes with the process, however that ends.
#[derive(Debug)]
pub struct ColumnFile {
    file: File,
    /// Where each piece ends, bytes.
    ends: Vec<u64>,
    scans: usize,
}

impl ColumnFile {
    /// An empty one in `folder`.
    ///
    /// # Errors
    /// Those of the system.
    pub fn new(folder: &Path) -> io::Result<Self> {
        Ok(Self { file: tempfile::tempfile_in(folder)?, ends: Vec::new(), scans: 0 })
    }

    /// Scans whose columns are in it.
    pub fn scans(&self) -> usize {
        self.scans
    }

    /// Moves the columns of the first scans of `log` into the file, piece by piece, until less than a piece is left.
    ///
    /// # Errors
    /// Those of the system; what is not in the file is in the log then.
    pub fn move_from(&mut self, log: &mut RunLog) -> io::Result<()> {
        while log.scans.node.len() >= PIECE {
            let columns = Columns::take(log, PIECE);
            let written = self.write(&columns);
            if let Err(problem) = written {
                let following = Columns::take(log, log.scans.node.len());
                columns.append_to(log);
                following.append_to(log);
                return Err(problem);
            }
            self.scans += PIECE;
        }
        Ok(())
    }

    fn write(&mut self, columns: &Columns) -> io::Result<()> {
        let begin = self.ends.last().copied().unwrap_or(0);
        let bytes = postcard::to_stdvec(columns).map_err(io::Error::other)?;
        self.file.seek(SeekFrom::Start(begin))?;
        self.file.write_all(&bytes)?;
        self.ends.push(begin + bytes.len() as u64);
        Ok(())
    }

    /// The pieces, one after the other.
    pub fn pieces(&self) -> impl Iterator<Item = io::Result<Columns>> {
        let begins = std::iter::once(0).chain(self.ends.iter().copied());
        begins.zip(&self.ends).map(|(begin, end)| self.piece(begin, *end))
    }

    fn piece(&self, begin: u64, end: u64) -> io::Result<Columns> {
        let mut bytes = vec![0; (end - begin) as usize];
        let mut file = &self.file;
        file.seek(SeekFrom::Start(begin))?;
        file.read_exact(&mut bytes)?;
        postcard::from_bytes(&bytes).map_err(io::Error::other)
    }
}

/// The first columns of a log that is stored: those on the disk, or those that were stored.
#[derive(Debug)]
pub enum FirstColumns<'a> {
    /// On the disk, if there are any. They are stored piece by piece, without being in memory at once.
    OnDisk(Option<&'a ColumnFile>),
    /// That were stored.
    Stored(Vec<Columns>),
}

impl Serialize for FirstColumns<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::OnDisk(Some(file)) => {
                let mut sequence = serializer.serialize_seq(Some(file.ends.len()))?;
                file.pieces().try_for_each(|piece| sequence.serialize_element(&piece.map_err(S::Error::custom)?))?;
                sequence.end()
            }
            Self::OnDisk(None) => serializer.collect_seq(std::iter::empty::<Columns>()),
            Self::Stored(columns) => columns.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for FirstColumns<'_> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Vec::deserialize(deserializer).map(Self::Stored)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(scans: usize) -> RunLog {
        let column = |factor: f64| (0..scans).map(|k| factor * k as f64).collect::<Vec<f64>>();
        let scans = ScanLog {
            node: (0..scans as u64).collect(),
            time_s: column(0.1),
            position: (0..scans).map(|k| [k as f64, 1.0, 2.0]).collect(),
            wall_ms: column(3.0),
            submap: (0..scans as u32).collect(),
            ..ScanLog::default()
        };
        RunLog { input: "room".to_owned(), scans, phases_ms: [("prepare".to_owned(), column(7.0))].into_iter().collect(), ..RunLog::default() }
    }

    fn whole(first: FirstColumns<'_>, last: &RunLog) -> RunLog {
        let FirstColumns::Stored(columns) = first else { panic!("not stored") };
        let mut whole = RunLog { input: "room".to_owned(), ..RunLog::default() };
        columns.into_iter().for_each(|columns| columns.append_to(&mut whole));
        Columns::all_of(last).append_to(&mut whole);
        whole
    }

    #[test]
    fn what_is_on_the_disk_is_stored_and_read_as_if_it_were_in_memory() {
        let folder = tempfile::tempdir().unwrap();
        for scans in [0, PIECE - 1, PIECE, 3 * PIECE + 5] {
            let (mut file, mut last) = (ColumnFile::new(folder.path()).unwrap(), log(scans));
            file.move_from(&mut last).unwrap();
            assert_eq!((file.scans(), last.scans.node.len()), (scans / PIECE * PIECE, scans % PIECE));
            let bytes = postcard::to_stdvec(&FirstColumns::OnDisk(Some(&file))).unwrap();
            assert_eq!(whole(postcard::from_bytes(&bytes).unwrap(), &last), log(scans), "{scans} scans");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the file has no name");
    }

    #[test]
    fn a_disk_that_refuses_leaves_the_columns_in_memory() {
        let mut log_in_memory = log(2 * PIECE);
        // A file that is open for reading only takes nothing.
        let mut file = ColumnFile { file: File::open(std::env::current_exe().unwrap()).unwrap(), ends: Vec::new(), scans: 0 };
        assert!(file.move_from(&mut log_in_memory).is_err());
        assert_eq!((log_in_memory, file.scans()), (log(2 * PIECE), 0));
    }
}
