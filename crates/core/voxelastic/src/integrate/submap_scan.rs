//! A prepared scan at its pose in a submap: what is integrated.

use super::rays::returns::ReturnsView;
use crate::geometry::Rigid;
use crate::sensor::RangeImage;

/// A prepared scan at its pose in a submap.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SubmapScan<'a> {
    pub t_submap_lidar: Rigid,
    pub returns: ReturnsView<'a>,
    /// Colour of each return, sRGB, [0, 0, 0] for none; empty when the scan has none.
    pub colours: &'a [[u8; 3]],
    /// The range image as seen from the pose of the scan.
    pub image: &'a RangeImage,
    /// Whether the points were no grid, so that single empty pixels of the image are artefacts of projection.
    pub fills_gaps: bool,
}
