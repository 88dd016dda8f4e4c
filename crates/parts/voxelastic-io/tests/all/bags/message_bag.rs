//! Bags of ROS 1 and ROS 2 with messages that are written here, byte by byte.

use std::path::Path;

/// A message under construction: packed as in ROS 1, or aligned as in ROS 2.
#[derive(Clone)]
pub struct Body(pub Vec<u8>, bool);

impl Body {
    pub fn u32(mut self, value: usize) -> Self {
        if self.1 {
            self.0.resize(self.0.len().next_multiple_of(4), 0);
        }
        self.0.extend((value as u32).to_le_bytes());
        self
    }

    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.extend(bytes);
        self
    }

    pub fn sequence(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len()).bytes(bytes)
    }

    pub fn text(self, text: &str) -> Self {
        let end: &[u8] = if self.1 { &[0] } else { &[] };
        self.sequence(&[text.as_bytes(), end].concat())
    }

    pub fn stamp(self, time: f64) -> Self {
        self.u32(time as usize).u32((time.fract() * 1e9) as usize)
    }

    pub fn header(self, time: f64, frame: &str) -> Self {
        if self.1 { self } else { self.u32(7) }.stamp(time).text(frame)
    }
}

/// A bag: topics, and messages of them with their times.
pub struct Bag {
    is_ros2: bool,
    topics: Vec<(&'static str, &'static str)>,
    /// Topic, time of recording, and bytes.
    pub messages: Vec<(usize, f64, Vec<u8>)>,
}

impl Bag {
    pub fn new(is_ros2: bool) -> Self {
        Self { is_ros2, topics: Vec::new(), messages: Vec::new() }
    }

    pub fn add(&mut self, topic: (&'static str, &'static str), time: f64, fill: impl FnOnce(Body) -> Body) {
        let index = self.topics.iter().position(|known| *known == topic).unwrap_or_else(|| {
            self.topics.push(topic);
            self.topics.len() - 1
        });
        self.messages.push((index, time, fill(Body(Vec::new(), self.is_ros2)).0));
    }

    pub fn write(&self, path: &Path) {
        let _ = std::fs::remove_file(path);
        let mut messages: Vec<_> = self.messages.iter().collect();
        messages.sort_by(|a, b| a.1.total_cmp(&b.1));
        if self.is_ros2 {
            let database = rusqlite::Connection::open(path).unwrap();
            let tables = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
                CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);";
            database.execute_batch(tables).unwrap();
            for (id, (name, kind)) in self.topics.iter().enumerate() {
                let kind = kind.replace('/', "/msg/");
                database.execute("INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr')", (id as i64, name, kind)).unwrap();
            }
            database.execute_batch("BEGIN").unwrap();
            for (topic, time, body) in messages {
                let data = [&[0, 1, 0, 0], body.as_slice()].concat();
                let row = (*topic as i64, (time * 1e9) as i64, data);
                database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)", row).unwrap();
            }
            database.execute_batch("COMMIT").unwrap();
            return;
        }
        let field = |name: &str, value: &[u8]| {
            let text = [name.as_bytes(), b"=", value].concat();
            [&(text.len() as u32).to_le_bytes(), text.as_slice()].concat()
        };
        let record = |fields: &[Vec<u8>], data: &[u8]| {
            let head = fields.concat();
            [&(head.len() as u32).to_le_bytes()[..], &head, &(data.len() as u32).to_le_bytes(), data].concat()
        };
        let mut bytes = b"#ROSBAG V2.0\n".to_vec();
        bytes.extend(record(&[field("op", &[3]), field("index_pos", &[0; 8])], &[]));
        for (number, (name, kind)) in (0u32..).zip(&self.topics) {
            let connection = [field("op", &[7]), field("conn", &number.to_le_bytes()), field("topic", name.as_bytes())];
            bytes.extend(record(&connection, &field("type", kind.as_bytes())));
        }
        for (topic, time, body) in messages {
            let stamp = [*time as u32, (time.fract() * 1e9) as u32].map(u32::to_le_bytes).concat();
            bytes.extend(record(&[field("op", &[2]), field("conn", &(*topic as u32).to_le_bytes()), field("time", &stamp)], body));
        }
        std::fs::write(path, bytes).unwrap();
    }
}
