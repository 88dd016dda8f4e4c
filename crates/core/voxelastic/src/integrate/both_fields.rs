//! Integration of a scan into both fields of a submap: its returns are transformed into rays once.

use super::occupancy::{OccupancyIntegrator, OccupancyScan, OccupancyStats};
use super::rays::returns::ReturnsView;
use super::rays::select::MAX_RAYS;
use super::rays::transform::build_rays;
use super::tsdf::{Redundancy, TsdfIntegrator, TsdfStats, integrate_colours};
use crate::field::occupancy::OccupancyField;
use crate::field::tsdf::TsdfField;
use crate::geometry::Rigid;
use crate::sensor::RangeImage;
use std::time::Instant;

/// The integrators of the fields that a map has. They hold scratch memory, so one pair should serve all submaps.
#[derive(Debug)]
pub(crate) struct FieldIntegrators {
    pub tsdf: Option<TsdfIntegrator>,
    pub occupancy: Option<OccupancyIntegrator>,
}

/// The fields of a submap.
pub(crate) struct FieldsMut<'a> {
    pub tsdf: &'a mut TsdfField,
    pub occupancy: &'a mut OccupancyField,
}

/// A scan to be integrated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanInput<'a> {
    pub t_submap_lidar: Rigid,
    pub returns: ReturnsView<'a>,
    /// Colour of each return, sRGB, [0, 0, 0] for none; empty when the scan has none.
    pub colours: &'a [[u8; 3]],
    /// The range image as seen from the pose of the scan.
    pub image: &'a RangeImage,
    /// Whether single empty pixels of the image are artefacts of projection.
    pub fills_gaps: bool,
}

impl FieldIntegrators {
    /// Integrates a scan into the fields that have an integrator; the TSDF skips rays that are redundant.
    pub fn integrate(
        &mut self,
        fields: FieldsMut<'_>,
        scan: &ScanInput<'_>,
        redundancy: &Redundancy<'_>,
    ) -> (Option<TsdfStats>, Option<OccupancyStats>) {
        let Self { tsdf, occupancy } = self;
        let ScanInput { t_submap_lidar, image, fills_gaps: fill, .. } = *scan;
        let smallest_angle = scan.returns.smallest_angle;
        let Some(tsdf) = tsdf else {
            let measured = scan.returns.measured_only();
            let stats = occupancy.as_mut().map(|occupancy| occupancy.integrate(fields.occupancy, &t_submap_lidar, image, &measured, fill));
            return (None, stats);
        };
        let clock = Instant::now();
        let returns = scan.returns.first(MAX_RAYS);
        let tsdf_scan = tsdf.scan(&t_submap_lidar, &returns);
        let measured = occupancy.as_mut().map(|occupancy| occupancy.rays_to_build(smallest_angle));
        let surface = Some(tsdf.rays_to_build(smallest_angle));
        if returns.measured == returns.points.len() {
            build_rays(&returns, &tsdf_scan.frame, surface, measured);
        } else {
            build_rays(&returns, &tsdf_scan.frame, surface, None);
            if measured.is_some() {
                build_rays(&returns.measured_only(), &tsdf_scan.frame, None, measured);
            }
        }
        let transform = clock.elapsed();
        let mut tsdf_stats = tsdf.integrate_rays(fields.tsdf, &tsdf_scan, redundancy);
        tsdf_stats.phases.transform = transform;
        if !scan.colours.is_empty() {
            let settings = tsdf.settings();
            integrate_colours(fields.tsdf, &t_submap_lidar, &returns.measured_only(), scan.colours, settings.voxel_size, settings.max_range);
        }
        let occupancy_scan = OccupancyScan { t_submap_lidar, image, fill, smallest_angle, returns: None };
        let occupancy_stats = occupancy.as_mut().map(|occupancy| occupancy.integrate_scan(fields.occupancy, &occupancy_scan));
        (Some(tsdf_stats), occupancy_stats)
    }
}
