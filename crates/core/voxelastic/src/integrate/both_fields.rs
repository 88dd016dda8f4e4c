//! The way of a scan into both fields of a submap: its returns are transformed into rays once.

use super::occupancy::{OccupancyIntegrator, OccupancyStats, Rays};
use super::rays::select::MAX_RAYS;
use super::rays::transform::build_rays;
use super::submap_scan::SubmapScan;
use super::tsdf::{Redundancy, TsdfIntegrator, TsdfStats, colour_voxels};
use crate::field::occupancy::OccupancyField;
use crate::field::tsdf::TsdfField;
use std::time::Instant;

/// The fields of a submap.
pub(crate) struct FieldsMut<'a> {
    pub tsdf: &'a mut TsdfField,
    pub occupancy: &'a mut OccupancyField,
}

impl SubmapScan<'_> {
    /// Integrates the scan into the fields that have an integrator; the TSDF skips rays that are redundant.
    pub fn integrate(
        &self,
        fields: FieldsMut<'_>,
        tsdf: Option<&mut TsdfIntegrator>,
        mut occupancy: Option<&mut OccupancyIntegrator>,
        redundancy: &Redundancy<'_>,
    ) -> (Option<TsdfStats>, Option<OccupancyStats>) {
        let Some(tsdf) = tsdf else {
            let measured = Self { returns: self.returns.measured_only(), ..*self };
            return (None, occupancy.map(|occupancy| occupancy.update(fields.occupancy, &measured, Rays::ToBuild)));
        };
        let clock = Instant::now();
        let returns = self.returns.first(MAX_RAYS);
        let frame = tsdf.frame(&self.t_submap_lidar);
        let measured = occupancy.as_mut().map(|occupancy| occupancy.rays_to_build(returns.smallest_angle));
        let surface = Some(tsdf.rays_to_build(returns.smallest_angle));
        if returns.measured == returns.points.len() {
            build_rays(&returns, &frame, surface, measured);
        } else {
            build_rays(&returns, &frame, surface, None);
            if measured.is_some() {
                build_rays(&returns.measured_only(), &frame, None, measured);
            }
        }
        let transform = clock.elapsed();
        let mut tsdf_stats = tsdf.update_from_rays(fields.tsdf, &self.t_submap_lidar, &returns, redundancy);
        tsdf_stats.phases.transform = transform;
        if !self.colours.is_empty() {
            let settings = tsdf.settings();
            colour_voxels(fields.tsdf, &self.t_submap_lidar, &returns.measured_only(), self.colours, settings.voxel_size, settings.max_range);
        }
        (Some(tsdf_stats), occupancy.map(|occupancy| occupancy.update(fields.occupancy, self, Rays::Built)))
    }
}
