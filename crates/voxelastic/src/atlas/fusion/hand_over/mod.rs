//! Stored once: a submap hands blocks over to another one that knows the same place better.
//!
//! Submaps that saw the same place store it several times. [`hand_over()`] merges blocks of a submap into the one whose block there was observed by most rays, by the same rule
//! as submaps are fused for a surface of the whole map ([`combine`](super::combine)), and removes them from the first. Only what lies within a block that is handed over is
//! merged, so that nothing counts twice. Which blocks these were, and how the two submaps lay then, is noted in the submap that had them ([`HandedOver`](crate::atlas::HandedOver)).
//!
//! [`take_back()`] gives a submap its blocks again, sampled where they lay then: where corrections have moved the two submaps apart since, or everywhere, before a map goes on to
//! grow. The other submap keeps them, too. So nothing is lost, but each way of a block resamples it.

mod choice;
mod give;
mod strain;
mod take_back;
#[cfg(test)]
mod tests;
mod transfer;

pub use give::hand_over;
pub use take_back::{TakeBack, take_back};
