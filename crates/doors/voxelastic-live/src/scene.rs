//! What viewers show, as messages: the latest of each thing, and never more than that.
//!
//! The mapper's thread puts messages in and waits for nobody. Each viewer takes those that are newer than what it has, at its own pace. A slow viewer misses
//! intermediate states of a thing, but not the last one; one that attaches late gets everything that is there.

use crate::link::Link;
use crate::wire;
use axum::body::Bytes;
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// A thing that viewers show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Thing {
    /// The poses of all submaps.
    Submaps,
    /// Some positions of the trajectory.
    Path(u32),
    /// Closed loops.
    Loops,
    /// The last scan.
    Scan,
    /// Figures.
    Statistics,
    /// The surface in a tile, by its place among all.
    Tile([i32; 3]),
}

/// Messages that a viewer does not have yet.
#[derive(Clone, Debug, Default)]
pub struct News {
    /// The messages, each with its number.
    pub messages: Vec<(u64, Bytes)>,
    /// What the viewer has afterwards.
    pub have: Have,
}

/// What a viewer has: the numbers of the last messages that it got.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Have {
    /// Of tiles, which take turns ...
    pub tiles: u64,
    /// ... and of everything else, which goes first.
    pub others: u64,
}

/// The latest message of each thing.
#[derive(Debug)]
pub struct Scene {
    /// What it is shown over; none where nothing limits that.
    link: Option<Arc<Link>>,
    things: Mutex<Things>,
    last: watch::Sender<u64>,
}

#[derive(Debug, Default)]
struct Things {
    last: u64,
    latest: HashMap<Thing, (u64, Bytes)>,
    tiles: BTreeMap<u64, Thing>,
    others: BTreeMap<u64, Thing>,
    bytes: usize,
    /// The tile that the robot is in.
    focus: [i32; 3],
}

impl Default for Scene {
    fn default() -> Self {
        Self::over(None)
    }
}

/// Tiles that a viewer has in an older state are less important than those it lacks that are so much farther from the robot, tiles.
const OLDER: i64 = 4;

impl Scene {
    /// An empty one that is shown over a link, if there is one.
    pub fn over(link: Option<Arc<Link>>) -> Self {
        Self { link, things: Mutex::default(), last: watch::Sender::new(0) }
    }

    /// What it is shown over.
    pub fn link(&self) -> Option<&Arc<Link>> {
        self.link.as_ref()
    }

    /// The robot is in this tile.
    pub fn focus(&self, place: [i32; 3]) {
        self.lock().focus = place;
    }

    /// Of the tiles that a viewer lacks, or has in an older state, the one that matters most, with its number: the nearest to the robot. `sent` has the number in which each was sent.
    pub fn most_important(&self, sent: &HashMap<[i32; 3], u64>) -> Option<([i32; 3], u64, Bytes)> {
        let things = self.lock();
        let rank = |place: &[i32; 3]| {
            let steps = (0..3).map(|k| (i64::from(place[k]) - i64::from(things.focus[k])).abs()).max().unwrap_or(0);
            steps + if sent.contains_key(place) { OLDER } else { 0 }
        };
        let lacking = things.tiles.iter().filter_map(|(number, thing)| match thing {
            Thing::Tile(place) if sent.get(place) != Some(number) => Some((rank(place), *number, *place)),
            _ => None,
        });
        let (_, number, place) = lacking.min()?;
        Some((place, number, things.latest.get(&Thing::Tile(place))?.1.clone()))
    }

    fn lock(&self) -> MutexGuard<'_, Things> {
        self.things.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Replaces the messages of things.
    pub fn put(&self, messages: impl IntoIterator<Item = (Thing, Vec<u8>)>) {
        let mut things = self.lock();
        messages.into_iter().for_each(|(thing, message)| things.put(thing, message));
        let last = things.last;
        drop(things);
        self.last.send_replace(last);
    }

    /// Forgets everything but the figures, and tells viewers that submaps, trajectory, loops and scan are gone. With the submaps they drop the tiles.
    pub fn clear(&self) {
        let mut things = self.lock();
        let tiles: Vec<Thing> = std::mem::take(&mut things.tiles).into_values().collect();
        for (_, message) in tiles.into_iter().filter_map(|thing| things.latest.remove(&thing)).collect::<Vec<_>>() {
            things.bytes -= message.len();
        }
        let paths: Vec<Thing> = things.latest.keys().copied().filter(|thing| matches!(thing, Thing::Path(_))).collect();
        drop(things);
        let empty = |thing| match thing {
            Thing::Path(part) => (thing, wire::path(part, &[])),
            Thing::Loops => (thing, wire::loops(&[])),
            _ => (Thing::Submaps, wire::submaps(&[])),
        };
        self.put(paths.into_iter().chain([Thing::Loops, Thing::Submaps]).map(empty));
    }

    /// What a viewer that has `have` gets next: everything but tiles, then tiles up to about `limit` bytes.
    pub fn news(&self, have: Have, limit: usize) -> News {
        let things = self.lock();
        let after = |number: u64| (std::ops::Bound::Excluded(number), std::ops::Bound::Unbounded);
        let message = |(number, thing): (&u64, &Thing)| Some((*number, things.latest.get(thing)?.1.clone()));
        let mut news = News { messages: Vec::new(), have };
        for message in things.others.range(after(have.others)).filter_map(message) {
            news.have.others = message.0;
            news.messages.push(message);
        }
        let mut bytes = 0;
        for message in things.tiles.range(after(have.tiles)).filter_map(message) {
            news.have.tiles = message.0;
            bytes += message.1.len();
            news.messages.push(message);
            if bytes >= limit {
                break;
            }
        }
        news
    }

    /// A receiver that is notified when messages come.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.last.subscribe()
    }

    /// The latest message of a thing.
    pub fn latest(&self, thing: Thing) -> Option<Bytes> {
        self.lock().latest.get(&thing).map(|(_, message)| message.clone())
    }

    /// Number and size of all messages.
    pub fn size(&self) -> (usize, usize) {
        let things = self.lock();
        (things.latest.len(), things.bytes)
    }
}

impl Things {
    fn put(&mut self, thing: Thing, mut message: Vec<u8>) {
        self.last += 1;
        wire::set_number(&mut message, self.last);
        let message = Bytes::from(message);
        self.bytes += message.len();
        let order = if matches!(thing, Thing::Tile(..)) { &mut self.tiles } else { &mut self.others };
        if let Some((number, old)) = self.latest.insert(thing, (self.last, message)) {
            order.remove(&number);
            self.bytes -= old.len();
        }
        order.insert(self.last, thing);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(news: &News) -> Vec<&str> {
        news.messages.iter().map(|(_, m)| std::str::from_utf8(m).unwrap()).collect()
    }

    #[test]
    fn viewers_get_the_latest_of_each_thing_and_figures_first() {
        let (scene, tile) = (Scene::default(), |x| Thing::Tile([x, 0, 0]));
        scene.put([(tile(1), b"a1".to_vec()), (tile(2), b"b1".to_vec()), (Thing::Scan, b"s1".to_vec())]);
        let first = scene.news(Have::default(), 1);
        assert_eq!(texts(&first), ["s1", "a1"], "at most one tile of two bytes");
        scene.put([(tile(1), b"a2".to_vec()), (Thing::Scan, b"s2".to_vec()), (Thing::Scan, b"s3".to_vec())]);
        let second = scene.news(first.have, 100);
        assert_eq!(texts(&second), ["s3", "b1", "a2"]);
        assert!(scene.news(second.have, 100).messages.is_empty());
        assert_eq!(texts(&scene.news(Have::default(), 100)), ["s3", "b1", "a2"], "a late one gets everything");
        assert_eq!(scene.size(), (3, 6));
    }

    #[test]
    fn over_a_link_what_is_near_and_lacking_comes_first() {
        let (scene, mut sent) = (Scene::default(), HashMap::new());
        let put = |x: i32, text: &str| scene.put([(Thing::Tile([x, 0, 0]), text.as_bytes().to_vec())]);
        (0..8).for_each(|x| put(x, "new"));
        scene.focus([5, 0, 0]);
        let mut next = |scene: &Scene| {
            let (place, number, _) = scene.most_important(&sent)?;
            sent.insert(place, number);
            Some(place[0])
        };
        assert_eq!([(); 3].map(|()| next(&scene)), [Some(5), Some(4), Some(6)]);
        // The nearest has changed again: it comes after those that lack and are up to four tiles farther.
        put(5, "newer");
        assert_eq!([(); 6].map(|()| next(&scene)), [3, 7, 2, 1, 5, 0].map(Some));
        assert_eq!(next(&scene), None);
    }

    #[test]
    fn tiles_of_a_map_that_is_gone_are_forgotten() {
        let scene = Scene::default();
        scene.put([
            (Thing::Tile([0; 3]), vec![0; 9]),
            (Thing::Tile([1; 3]), vec![1; 5]),
            (Thing::Statistics, vec![2]),
            (Thing::Path(3), vec![3; 40]),
        ]);
        scene.clear();
        // Submaps, loops, and the path are empty now.
        assert_eq!(scene.size(), (4, 1 + wire::path(3, &[]).len() + 2 * wire::loops(&[]).len()));
        assert!(scene.latest(Thing::Tile([1; 3])).is_none() && scene.latest(Thing::Statistics).is_some());
    }
}
