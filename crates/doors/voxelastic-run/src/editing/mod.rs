//! Editing a saved map: a list of edits that is kept with the map, each done to what those before it have made.
//!
//! The map that is shown is a function of the map before the edits and of the list, and of nothing else: the same list on the same map gives the same bytes, and an edit
//! that is taken back leaves those of before it. Places that were registered are written into the list as they were found, so nothing is looked for twice.
//!
//! | module | contents |
//! | --- | --- |
//! | [`Edit`] | what can be done, as a table of TOML |
//! | `parse` | reading a list; what is wrong is named by line and key |
//! | [`Region`] | boxes, spheres, prisms |
//! | `graph` | the pose graph of a saved map, and what edits add to it |
//! | `register` | two submaps, by their surfaces |
//! | `state` | what each edit does |
//! | `whole` | those that move a session or the map as a whole, or keep submaps apart |
//! | [`Editor`] | a map that is edited, on disk |
//! | [`Draft`] | one that is edited and looked at before it is on the disk |
//! | [`PairFit`] | how two submaps fit, and those that should lie on each other and do not |
//! | [`Suggestion`] | what is least consistent, and an edit that would mend it |

mod closures;
mod draft;
mod editor;
mod graph;
mod list;
mod pair_fit;
mod parse;
mod region;
mod register;
mod state;
mod suggesting;
#[cfg(test)]
mod tests;
mod whole;

pub use closures::{ListedClosure, closures, edits};
pub use draft::{Change, Draft, ShownClosure, Trial};
pub use editor::{Editor, keep, undo_all};
pub use list::{Between, Edit, Pin, SessionName, Target, Up};
pub use pair_fit::PairFit;
pub use parse::{parse, read};
pub use region::Region;
pub use register::Fit;
pub use state::Done;
pub use suggesting::{MapCheck, Suggestion};
