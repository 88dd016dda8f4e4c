//! Which loops searches of the pose graph follow where a place was passed often: those of the first passes and of the last.
//!
//! A robot that goes round for ever links each pass with those before. Were all these links followed, a search would look at all passes, and each
//! round would make it longer. But the first passes lead to the roots of the submaps, the last ones to where the robot is, and those in between only say again
//! what these say. So a place keeps the links of a few passes, and a link that is not kept leaves the graph with all that only it leads to. Distances along the
//! graph grow by that or stay, so that no submap becomes larger than its bound; where no place has been passed more often, nothing changes.
//!
//! A place is a cell of space, that of the older end of a link. A pass is a length of path: a robot that turns in a small room begins one from time to time, too.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Passes of a place whose links are followed for ever.
pub(super) const FIRST: usize = 2;
/// Passes whose links are followed until as many others have come after them.
pub(super) const LAST: usize = 2;

/// Size of places and length of passes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PassRule {
    /// Edge of the cells that are places, metres; more than 0.
    pub place: f64,
    /// Path of a pass, metres; more than 0.
    pub pass: f64,
}

/// A pass of a place, with the links from it to older nodes there.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Pass {
    number: u64,
    links: Vec<u32>,
}

/// The passes of each place.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Passes {
    rule: PassRule,
    /// The passes whose links are followed, in the order in which the first link of each came.
    #[serde(with = "pairs")]
    places: BTreeMap<[i64; 3], Vec<Pass>>,
}

impl Passes {
    pub fn new(rule: PassRule) -> Self {
        Self { rule, places: BTreeMap::new() }
    }

    /// Notes a link from a node with `path` metres of path before it to an older one at `position`, map frame, metres. Returns links to be followed no longer.
    pub fn note(&mut self, link: u32, position: [f64; 3], path: f64) -> Vec<u32> {
        let place = position.map(|c| (c / self.rule.place).floor() as i64);
        let number = (path / self.rule.pass) as u64;
        let passes = self.places.entry(place).or_default();
        match passes.iter_mut().find(|pass| pass.number == number) {
            Some(pass) => pass.links.push(link),
            None => passes.push(Pass { number, links: vec![link] }),
        }
        if passes.len() > FIRST + LAST { passes.remove(FIRST).links } else { Vec::new() }
    }
}

/// Stores the places as pairs: keys of JSON are text.
mod pairs {
    use super::Pass;
    use serde::{Deserialize, Deserializer, Serializer};
    use std::collections::BTreeMap;

    type Places = BTreeMap<[i64; 3], Vec<Pass>>;

    pub fn serialize<S: Serializer>(places: &Places, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(places)
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(deserializer: D) -> Result<Places, D::Error> {
        Ok(Vec::deserialize(deserializer)?.into_iter().collect())
    }
}
