//! A prepared scan: its returns, its range image, and counts of what was dropped.

use super::range_image::RangeImage;
use super::returns::Returns;

/// What became of a cloud's points. All but `hidden` add up to the points of the cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Usable returns.
    pub usable: usize,
    /// Points without return (NaN or the origin).
    pub no_return: usize,
    /// Returns nearer than the near limit.
    pub too_near: usize,
    /// Returns farther than the maximum range.
    pub beyond_max: usize,
    /// Returns outside of the field of view of the model.
    pub outside: usize,
    /// Usable returns whose pixel shows a nearer one.
    pub hidden: usize,
}

impl Counts {
    /// Adds the counts of a part of the cloud.
    pub(super) fn add(&mut self, part: &Self) {
        self.usable += part.usable;
        self.no_return += part.no_return;
        self.too_near += part.too_near;
        self.beyond_max += part.beyond_max;
        self.outside += part.outside;
        self.hidden += part.hidden;
    }
}

/// A scan ready to be integrated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PreparedScan {
    /// The range image; each column as seen from the lidar at the time of its measurement.
    pub image: RangeImage,
    /// The range image as seen from the lidar's pose at the time stamp, if the lidar moved during the sweep.
    pub single_view: Option<RangeImage>,
    /// The usable returns.
    pub returns: Returns,
    /// What became of its points.
    pub counts: Counts,
}

impl PreparedScan {
    /// The range image as seen from the lidar's pose at the time stamp, and whether single empty pixels in it are artefacts of projection. `fills_gaps` says
    /// that for [`image`](Self::image).
    pub fn view_from_one_pose(&self, fills_gaps: bool) -> (&RangeImage, bool) {
        self.single_view.as_ref().map_or((&self.image, fills_gaps), |single_view| (single_view, true))
    }
}
