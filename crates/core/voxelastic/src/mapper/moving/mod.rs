//! Things that move: their points are set aside before they reach the surfaces, and what they left is removed at the end.
//!
//! A [`View`](view::View) is what a scan saw: in each direction, the nearest and the farthest return in a window of pixels. A place is *void* in a view if all
//! returns in its window are farther away by a margin, so that beams on all sides of it passed beyond (the idea of DUFOMap, Duberg et al., RA-L 2024, with cones of
//! beams instead of voxels) and it is before the planes of these returns, and *seen* if a return, or its plane, is where it is. A view is first aligned with the scan
//! that it judges ([`align`]): at flat angles, centimetres of a pose are metres of range. A point in a place that was void before, and not seen before that, is on something that
//! moved there ([`votes`], [`detector`]). Some scans are kept to the end: then surfaces are removed from places that are void in most of them, or in the last ones
//! ([`kept`]).

mod align;
mod cells;
mod detector;
mod kept;
mod packed_plane;
mod view;
mod votes;
mod windows;

pub(super) use cells::Cells;
pub(super) use detector::{MovingDetector, MovingState};
