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

    /// Whether [`has_come`](Self::has_come) is false whatever so many more views tell.
    pub fn cannot_have_come(&self, more: u16) -> bool {
        !self.has_come() && 2 * self.seen >= self.void + more && (self.seen > 0 || self.void + self.sparse + more < 2)
    }

    /// Whether a point there that is beside points on something that moves may be on it, too: hardly any view saw it.
    pub fn may_join(&self) -> bool {
        self.seen <= 1
    }

    /// Whether [`may_join`](Self::may_join) is false whatever so many more views tell.
    pub fn cannot_join(&self, _more: u16) -> bool {
        !self.may_join()
    }

    /// Whether a surface there does not belong in the map: the place is void in many views, or in the last ones.
    pub fn has_gone(&self) -> bool {
        let mostly = self.void >= 1 && 2 * self.void > self.seen;
        let lately = self.void_since >= 2 && 4 * self.void_since >= self.seen;
        mostly || lately || (self.seen == 0 && self.void + self.sparse >= 2)
    }

    /// Whether [`has_gone`](Self::has_gone) is false whatever so many more views tell.
    pub fn cannot_have_gone(&self, more: u16) -> bool {
        !self.has_gone() && self.seen > 0 && self.seen >= 2 * (self.void + more) && self.seen > 4 * (self.void_since + more)
    }

    /// Whether a surface there has gone, by views of later times: several are void and none saw anything.
    pub fn is_gone_later(&self) -> bool {
        self.void + self.sparse >= 2 && self.seen == 0
    }

    /// Whether [`is_gone_later`](Self::is_gone_later) is false whatever so many more views tell.
    pub fn cannot_be_gone_later(&self, more: u16) -> bool {
        self.seen > 0 || self.void + self.sparse + more < 2
    }
}

/// Places that views are asked about, submap frame, metres.
pub(super) struct Places<P, S> {
    /// The place of a number.
    pub place: P,
    /// Width and height of the thing there, metres; asked for only where it could have been missed.
    pub size: S,
}

/// What `views`, oldest first, tell of `count` places. A place whose votes are `settled`, with so many more views to come, is asked about no further.
pub(super) fn votes_of<P, S>(
    views: &[PlacedView<'_>],
    model: &BeamModel,
    count: usize,
    places: &Places<P, S>,
    settled: impl Fn(&Votes, u16) -> bool + Sync,
) -> Vec<Votes>
where
    P: Fn(usize) -> [f32; 3] + Sync,
    S: Fn(usize) -> [f32; 2] + Sync,
{
    let mut votes = vec![Votes::default(); count];
    votes.par_chunks_mut(PROJECT_CHUNK).enumerate().for_each(|(chunk, votes)| {
        let first = chunk * PROJECT_CHUNK;
        let places = Places { place: |i| (places.place)(first + i), size: |i| (places.size)(first + i) };
        votes_of_chunk(views, model, votes, &places, &settled);
    });
    votes
}

/// As [`votes_of`], on the calling thread.
pub(super) fn votes_of_few<P, S>(
    views: &[PlacedView<'_>],
    model: &BeamModel,
    count: usize,
    places: &Places<P, S>,
    settled: impl Fn(&Votes, u16) -> bool,
) -> Vec<Votes>
where
    P: Fn(usize) -> [f32; 3],
    S: Fn(usize) -> [f32; 2],
{
    let mut votes = vec![Votes::default(); count];
    for (chunk, votes) in votes.chunks_mut(PROJECT_CHUNK).enumerate() {
        let first = chunk * PROJECT_CHUNK;
        let places = Places { place: |i| (places.place)(first + i), size: |i| (places.size)(first + i) };
        votes_of_chunk(views, model, votes, &places, &settled);
    }
    votes
}

/// Fills the votes of up to [`PROJECT_CHUNK`] places.
fn votes_of_chunk<P, S>(
    views: &[PlacedView<'_>],
    model: &BeamModel,
    votes: &mut [Votes],
    places: &Places<P, S>,
    settled: impl Fn(&Votes, u16) -> bool,
) where
    P: Fn(usize) -> [f32; 3],
    S: Fn(usize) -> [f32; 2],
{
    let mut asked: Vec<(usize, [f32; 3])> = (0..votes.len()).map(|i| (i, (places.place)(i))).collect();
    let mut sizes: Vec<Option<[f32; 2]>> = vec![None; votes.len()];
    SCRATCH.with_borrow_mut(|scratch| {
        for (view, more) in views.iter().zip((0..views.len() as u16).rev()) {
            let size = |k: usize| {
                let i = asked[k].0;
                *sizes[i].get_or_insert_with(|| (places.size)(i))
            };
            view.look(model, asked.iter().map(|(_, place)| *place), size, scratch, |k, observation| votes[asked[k].0].add(observation));
            asked.retain(|(i, _)| !settled(&votes[*i], more));
            if asked.is_empty() {
                break;
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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

    proptest! {
        #[test]
        fn settled_votes_stay_as_they_are(observations in prop::collection::vec(0usize..4, 1..30)) {
            let observations: Vec<Observation> =
                observations.into_iter().map(|k| [Observation::Unknown, Observation::Sparse, Observation::Seen, Observation::Void][k]).collect();
            let of = |count: usize| {
                let mut votes = Votes::default();
                observations[..count].iter().for_each(|observation| votes.add(*observation));
                votes
            };
            let end = of(observations.len());
            for count in 0..=observations.len() {
                let (votes, more) = (of(count), (observations.len() - count) as u16);
                prop_assert!(!(votes.cannot_have_come(more) && end.has_come()), "{votes:?} {end:?}");
                prop_assert!(!(votes.cannot_join(more) && end.may_join()), "{votes:?} {end:?}");
                prop_assert!(!(votes.cannot_have_gone(more) && end.has_gone()), "{votes:?} {end:?}");
                prop_assert!(!(votes.cannot_be_gone_later(more) && end.is_gone_later()), "{votes:?} {end:?}");
            }
            // With nothing more to come, all is known.
            prop_assert_eq!((end.cannot_have_come(0), end.cannot_be_gone_later(0)), (!end.has_come(), !end.is_gone_later()));
        }
    }
}
