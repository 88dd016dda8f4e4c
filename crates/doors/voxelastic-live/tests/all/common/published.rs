//! Somebody who gets what a node `robot` publishes, and reads it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use voxelastic_live::ros::middleware::{MiddlewareError, Sink};

/// A place in the frame of a message, metres.
pub type Point = [f64; 3];

/// The last message of each topic.
#[derive(Clone, Default)]
pub struct Published(Arc<Mutex<HashMap<String, Vec<u8>>>>);

struct Topic(String, Published);

impl Sink for Topic {
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError> {
        self.1.0.lock().unwrap().insert(self.0.clone(), message.to_vec());
        Ok(())
    }

    fn subscribers(&self) -> usize {
        usize::from(self.0.ends_with("/grid"))
    }
}

/// Reads CDR from front to back.
struct Message<'a>(&'a [u8], usize);

impl Message<'_> {
    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        self.1 = self.1.next_multiple_of(N);
        self.1 += N;
        self.0[self.1 - N..self.1].try_into().unwrap()
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.bytes())
    }

    fn text(&mut self) -> String {
        let length = self.u32() as usize;
        self.1 += length;
        String::from_utf8(self.0[self.1 - length..self.1 - 1].to_vec()).unwrap()
    }

    fn header(&mut self) -> String {
        self.u32();
        self.u32();
        self.text()
    }

    fn pose(&mut self) -> (Point, [f64; 4]) {
        ([(); 3].map(|()| self.f64()), [(); 4].map(|()| self.f64()))
    }
}

impl Published {
    fn with<T>(&self, topic: &str, read: impl FnOnce(Message<'_>) -> T) -> Option<T> {
        let all = self.0.lock().unwrap();
        all.get(&format!("/robot/{topic}")).map(|message| read(Message(&message[4..], 0)))
    }

    /// A topic whose last message is kept.
    pub fn topic(&self, name: &str) -> Box<dyn Sink> {
        Box::new(Topic(name.to_owned(), self.clone()))
    }

    /// The waypoints of the path to follow, in the frame of the map.
    pub fn path(&self) -> Vec<Point> {
        self.path_of("explore_path")
    }

    /// The waypoints of `nav_msgs/Path`.
    pub fn path_of(&self, topic: &str) -> Vec<Point> {
        let path = self.with(topic, |mut message| {
            assert_eq!(message.header(), "map");
            let waypoint = |message: &mut Message<'_>| {
                assert_eq!(message.header(), "map");
                message.pose().0
            };
            (0..message.u32()).map(|_| waypoint(&mut message)).collect()
        });
        path.unwrap_or_default()
    }

    pub fn goal(&self) -> Option<Point> {
        self.with("explore_goal", |mut message| {
            message.header();
            message.pose().0
        })
    }

    /// Centres and sizes of the boxes of `visualization_msgs/MarkerArray`.
    pub fn frontier(&self) -> Vec<(Point, Point)> {
        let boxes = self.with("frontier", |mut message| {
            let marker = |message: &mut Message<'_>| {
                message.header();
                message.text();
                let [_, kind, action] = [(); 3].map(|()| message.u32());
                let (centre, size) = (message.pose().0, [(); 3].map(|()| message.f64()));
                // Colour and lifetime; whether it moves with its frame; no points and no colours.
                let _: [u32; 6] = [(); 6].map(|()| message.u32());
                message.bytes::<1>();
                assert_eq!([message.u32(), message.u32()], [0, 0]);
                // Texture, text and mesh: no names and no contents.
                message.text();
                message.header();
                message.text();
                let _: [u32; 2] = [(); 2].map(|()| message.u32());
                let _: [String; 3] = [(); 3].map(|()| message.text());
                message.u32();
                message.bytes::<1>();
                (kind == 1 && action == 0).then_some((centre, size))
            };
            (0..message.u32()).filter_map(|_| marker(&mut message)).collect()
        });
        boxes.unwrap_or_default()
    }

    /// Edge of the cells, their number along x, the corner of the first one, and the cells of `nav_msgs/OccupancyGrid`.
    pub fn grid(&self) -> Option<(f64, usize, Point, Vec<i8>)> {
        self.with("grid", |mut message| {
            message.header();
            message.u32();
            message.u32();
            let edge = f32::from_le_bytes(message.bytes());
            let [width, _] = [message.u32(), message.u32()];
            let (corner, _) = message.pose();
            let cells = (0..message.u32()).map(|_| i8::from_le_bytes(message.bytes())).collect();
            (f64::from(edge), width as usize, corner, cells)
        })
    }
}
