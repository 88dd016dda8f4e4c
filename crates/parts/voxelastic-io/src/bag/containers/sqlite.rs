//! ROS 2 bags in SQLite: tables `topics` and `messages`.

use super::chunk::{Compression, decompress};
use super::container::{Container, Encoding, Index, Message, Topic};
use crate::{Error, Position, Result, unpacking};
use rusqlite::{Connection, ErrorCode, OpenFlags, params};
use std::collections::{HashMap, VecDeque};
use std::path::{Path, PathBuf};

const ZSTD_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];
/// Rows read by one query.
const ROWS: i64 = 16;

/// A ROS 2 `.db3`.
pub(crate) struct Sqlite {
    path: PathBuf,
    database: Connection,
    topics: Vec<Topic>,
    topic_of: HashMap<i64, usize>,
    /// The last row that was read.
    row: i64,
    ready: VecDeque<Result<Message>>,
    finished: bool,
}

impl Sqlite {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let fail = |e: rusqlite::Error| {
            let problem = format!("not readable as a ROS 2 bag: {e}");
            Error::content(path, Position::File, problem, "copy or record it again; `ros2 bag reindex` may help")
        };
        voxelastic_files::note_read(path);
        let database = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX).map_err(fail)?;
        let mut bag = Self {
            path: path.into(),
            database,
            topics: Vec::new(),
            topic_of: HashMap::new(),
            row: i64::MIN,
            ready: VecDeque::new(),
            finished: false,
        };
        if let Err(error) = bag.read_topics() {
            // SQLite opens no file that is shorter than its head says, unless it may be asked for a damaged schema.
            let is_cut = error.sqlite_error_code() == Some(ErrorCode::DatabaseCorrupt);
            if !is_cut || bag.database.pragma_update(None, "writable_schema", true).is_err() {
                return Err(fail(error));
            }
            (bag.topics, bag.topic_of) = Default::default();
            bag.read_topics().map_err(fail)?;
            tracing::warn!("{}: the bag was cut or is damaged; it is read as far as it goes", path.display());
        }
        Ok(bag)
    }

    fn read_topics(&mut self) -> rusqlite::Result<()> {
        let mut query = self.database.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id")?;
        let mut rows = query.query([])?;
        while let Some(row) = rows.next()? {
            let (id, name, kind, format): (i64, String, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?);
            let encoding = if format == "cdr" { Encoding::Cdr } else { Encoding::Other };
            self.topic_of.insert(id, self.topics.len());
            self.topics.push(Topic::new(name, &kind, encoding));
        }
        Ok(())
    }

    fn read_index(&self) -> rusqlite::Result<Index> {
        let mut index = Index { counts: vec![0; self.topics.len()], times_ns: None };
        // The table is indexed by time, so this is fast.
        let times = self.database.query_row("SELECT min(timestamp), max(timestamp) FROM messages", [], |row| Ok((row.get(0)?, row.get(1)?)))?;
        if let (Some(first), Some(last)) = times {
            index.times_ns = Some((first, last));
        }
        let mut query = self.database.prepare("SELECT topic_id, count(*) FROM messages GROUP BY topic_id")?;
        let mut rows = query.query([])?;
        while let Some(row) = rows.next()? {
            let (id, count): (i64, i64) = (row.get(0)?, row.get(1)?);
            if let Some(&topic) = self.topic_of.get(&id) {
                index.counts[topic] += count.unsigned_abs();
            }
        }
        Ok(index)
    }

    /// Reads the next few rows. Rows after a damaged page cannot be reached.
    fn read_rows(&mut self, wanted: &dyn Fn(&Topic) -> bool) {
        let result = self.try_read_rows(wanted);
        match result {
            Ok(0) => self.finished = true,
            Ok(_) => {}
            Err(error) => {
                self.finished = true;
                let problem = format!("nothing can be read after row {}: {error}", self.row.max(0));
                self.ready.push_back(Err(Error::content(&self.path, Position::File, problem, "the bag is cut or damaged there: copy it again")));
            }
        }
    }

    fn try_read_rows(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> rusqlite::Result<usize> {
        let mut query = self.database.prepare("SELECT id, topic_id, timestamp, data FROM messages WHERE id > ?1 ORDER BY id LIMIT ?2")?;
        let mut rows = query.query(params![self.row, ROWS])?;
        let mut read = 0;
        while let Some(row) = rows.next()? {
            let (id, topic, time_ns): (i64, i64, i64) = (row.get(0)?, row.get(1)?, row.get(2)?);
            self.row = id;
            read += 1;
            let Some(&topic) = self.topic_of.get(&topic).filter(|t| wanted(&self.topics[**t])) else { continue };
            let data: Vec<u8> = row.get(3)?;
            self.ready.push_back(Ok(Message { topic, time_ns, at: id.unsigned_abs(), data }));
        }
        Ok(read)
    }
}

/// Decompresses a message: they may be compressed one by one.
fn decompressed(message: Message, path: &Path) -> Result<Message> {
    if !message.data.starts_with(ZSTD_MAGIC) {
        return Ok(message);
    }
    let damaged = |problem: String| {
        let problem = format!("the message in row {} cannot be decompressed: {problem}", message.at);
        Error::content(path, Position::File, problem, "copy or record it again")
    };
    let limit = unpacking::limit(message.data.len() as u64);
    match decompress(Compression::Zstd, &message.data, limit + 1) {
        (_, Some(error)) => Err(damaged(error.to_string())),
        (data, None) if data.len() as u64 > limit => Err(damaged(format!("its {} bytes become more than {limit}", message.data.len()))),
        (data, None) => Ok(Message { data, ..message }),
    }
}

impl Container for Sqlite {
    fn topics(&self) -> &[Topic] {
        &self.topics
    }

    fn index(&self) -> Option<Index> {
        self.read_index().ok()
    }

    fn next(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Option<Result<Message>> {
        while self.ready.is_empty() && !self.finished {
            self.read_rows(wanted);
        }
        // One at a time: they may be much larger than what is stored.
        let next = self.ready.pop_front()?;
        Some(next.and_then(|message| decompressed(message, &self.path)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bag with these messages on one topic.
    fn bag(path: &Path, messages: &[Vec<u8>]) {
        let database = Connection::open(path).unwrap();
        database
            .execute_batch(
                "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
                 CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
                 INSERT INTO topics VALUES(1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr');",
            )
            .unwrap();
        for (k, message) in messages.iter().enumerate() {
            database.execute("INSERT INTO messages VALUES(?1, 1, ?1, ?2)", params![k as i64 + 1, message]).unwrap();
        }
    }

    #[test]
    fn messages_that_grow_beyond_reason_are_refused_one_by_one() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("bombs.db3");
        let packed = |length: usize| zstd::bulk::compress(&vec![0; length], 1).unwrap();
        let bomb = packed(unpacking::limit(0) as usize + 1);
        assert!(bomb.len() < 10_000);
        bag(&path, &[[vec![bomb; 3], vec![packed(1000)]].concat(), vec![vec![1, 2, 3]]].concat());
        let mut found = Sqlite::open(&path).unwrap();
        let results: Vec<_> = std::iter::from_fn(|| found.next(&|_| true)).collect();
        assert_eq!(results.len(), 5);
        for bomb in &results[..3] {
            let text = bomb.as_ref().unwrap_err().to_string();
            assert!(text.contains("bombs.db3") && text.contains("become more than"), "{text}");
        }
        let lengths: Vec<usize> = results[3..].iter().map(|message| message.as_ref().unwrap().data.len()).collect();
        assert_eq!(lengths, [1000, 3]);
    }
}
