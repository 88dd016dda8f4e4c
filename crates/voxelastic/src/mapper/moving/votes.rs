//! What several views together tell of a place.

use super::view::{Observation, PlacedView, Scratch};
use crate::sensor::{BeamModel, PROJECT_CHUNK};
use rayon::prelude::*;
use std::cell::RefCell;

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch::default());
}

/// Counts of what views tell of a place, in the order of time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Votes {
    void: u16,
    seen: u16,
    /// Times void, if it is not that it was missed.
    sparse: u16,
    /// Times seen before it was void last.
    seen_before: u16,
    /// Times void since it was seen last.
    void_since: u16,
}

impl Votes {
    /// Adds what the next view tells.
    pub fn add(&mut self, observation: Observation) {
        match observation {
            Observation::Unknown => {}
            Observation::Sparse => self.sparse += 1,
            Observation::Seen => {
                self.seen += 1;
                self.void_since = 0;
            }
            Observation::Void => {
                self.void += 1;
                self.void_since += 1;
                self.seen_before = self.seen;
            }
        }
    }

    /// Whether a point that is measured there now is on something that moves: the place was void, hardly seen before that, and not seen often since, as what came
    /// and stays is. Or it was never seen: not everything is missed twice.
    pub fn has_come(&self) -> bool {
        /// Times seen after which something stands.
        const STANDS: u16 = 8;
        let came = self.void >= 1 && 2 * self.seen_before < self.void && self.seen - self.seen_before < STANDS;
        came || (self.seen == 0 && self.void + self.sparse >= 2)
    }

    /// Whether a point there that is beside points on something that moves may be on it, too: hardly any view saw it.
    pub fn may_join(&self) -> bool {
        self.seen <= 1
    }

    /// Whether a surface there does not belong in the map: the place is void in many views, or in the last ones.
    pub fn has_gone(&self) -> bool {
        let mostly = self.void >= 1 && 2 * self.void > self.seen;
        let lately = self.void_since >= 2 && 4 * self.void_since >= self.seen;
        mostly || lately || (self.seen == 0 && self.void + self.sparse >= 2)
    }

    /// Whether a surface there has gone, by views of later times: several are void and none saw anything.
    pub fn is_gone_later(&self) -> bool {
        self.void + self.sparse >= 2 && self.seen == 0
    }
}

/// What `views`, oldest first, tell of `count` places, submap frame, metres, on things of a width and height, metres.
pub(super) fn votes_of(
    views: &[PlacedView<'_>],
    model: &BeamModel,
    count: usize,
    place: impl Fn(usize) -> ([f32; 3], [f32; 2]) + Sync,
) -> Vec<Votes> {
    let mut votes = vec![Votes::default(); count];
    votes.par_chunks_mut(PROJECT_CHUNK).enumerate().for_each(|(chunk, votes)| {
        let first = chunk * PROJECT_CHUNK;
        let (places, sizes): (Vec<[f32; 3]>, Vec<[f32; 2]>) = (first..first + votes.len()).map(&place).unzip();
        votes.copy_from_slice(&votes_of_few(views, model, &places, &sizes));
    });
    votes
}

/// As [`votes_of`], on the calling thread.
pub(super) fn votes_of_few(views: &[PlacedView<'_>], model: &BeamModel, places: &[[f32; 3]], sizes: &[[f32; 2]]) -> Vec<Votes> {
    let mut votes = vec![Votes::default(); places.len()];
    SCRATCH.with_borrow_mut(|scratch| {
        for view in views {
            let chunks = places.chunks(PROJECT_CHUNK).zip(sizes.chunks(PROJECT_CHUNK)).zip(votes.chunks_mut(PROJECT_CHUNK));
            for ((places, sizes), votes) in chunks {
                view.look(model, places, sizes, scratch, |i, observation: Observation| votes[i].add(observation));
            }
        }
    });
    votes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn votes(observations: &str) -> Votes {
        let mut votes = Votes::default();
        observations.chars().for_each(|c| {
            votes.add(match c {
                'v' => Observation::Void,
                's' => Observation::Seen,
                '.' => Observation::Sparse,
                _ => Observation::Unknown,
            });
        });
        votes
    }

    #[test]
    fn what_came_and_what_went() {
        for (observations, came, gone) in [
            ("", false, false),
            ("v", true, true),
            ("vvs", true, true),
            ("?vss", true, false),
            ("ssssv", false, false),
            ("sssvv", false, true),
            ("vvvsvvv", true, true),
            ("sssssssssssvv", false, false),
            ("ssss", false, false),
            ("vvssssssss", false, false),
            (".", false, false),
            ("..", true, true),
            ("...s", false, false),
            (".vs.", true, true),
        ] {
            assert_eq!((votes(observations).has_come(), votes(observations).has_gone()), (came, gone), "{observations}");
        }
    }
}
