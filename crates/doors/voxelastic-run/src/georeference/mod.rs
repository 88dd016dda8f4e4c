//! Putting a saved map on Earth: by fixes of a receiver, or control points, as a rigid whole or bending.

mod checks;
mod measured;
mod nodes;
mod outcome;
mod placed;
mod request;
mod solve;
mod stored;

pub(crate) use nodes::move_submap;
pub use outcome::{Outcome, Row, Statistics, Use};
pub use request::{Clock, Request};
pub use solve::georeference;
pub use stored::trajectory;
