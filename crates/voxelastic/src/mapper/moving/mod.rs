//! Things that move: their points are set aside before they reach the surfaces, and what they left is removed at the end.
//!
//! A [`View`](view::View) is what a scan saw: in each direction, the nearest and the farthest return in a window of pixels. A place is *void* in a view if all
//! returns in its window are farther away by a margin, so that beams on all sides of it passed beyond (the idea of DUFOMap, Duberg et al., RA-L 2024, with cones of
//! beams instead of voxels), and *seen* if a return is where it is. A point in a place that was void before, and not seen before that, is on something that
//! moved there ([`votes`]). When a submap is left, and at the end, surfaces are removed from places that are void in most views or in the last ones
//! ([`detector`]).
//!
//! Surfaces are compared with the views of their submap, and of the scans just before it: poses farther apart may be wrong by more than the margin.

mod detector;
mod view;
mod votes;

pub(super) use detector::{MovingDetector, MovingState};
