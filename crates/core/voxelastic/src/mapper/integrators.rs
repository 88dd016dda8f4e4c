//! The integrators of both fields and their settings.

use super::frontend::KeptScan;
use crate::atlas::Submap;
use crate::atlas::fusion::FusionSettings;
use crate::geometry::Pose;
use crate::integrate::{FieldsMut, OccupancyIntegrator, OccupancySettings, OccupancyStats, Redundancy, TsdfIntegrator, TsdfSettings, TsdfStats};
use crate::settings::{NoReturn, Settings};
use std::collections::BTreeMap;

impl From<&Settings> for TsdfSettings {
    fn from(settings: &Settings) -> Self {
        Self {
            voxel_size: settings.voxel_size,
            max_range: settings.max_range,
            truncation_voxels: settings.truncation,
            truncation_front: settings.truncation_front,
            truncation_behind: settings.truncation_behind,
            max_weight: settings.max_weight,
            max_scale: settings.max_scale,
            scale_hysteresis: settings.scale_hysteresis,
            ..Self::default()
        }
    }
}

impl From<&Settings> for OccupancySettings {
    fn from(settings: &Settings) -> Self {
        let clear_no_return = settings.no_return == NoReturn::Free;
        let (robot_radius, robot_height) = (settings.robot_radius_metres(), settings.robot_height_metres());
        Self { voxel_size: settings.voxel_size, max_range: settings.max_range, clear_no_return, robot_radius, robot_height, ..Self::default() }
    }
}

impl From<&Settings> for FusionSettings {
    fn from(settings: &Settings) -> Self {
        let occupancy = OccupancySettings::from(settings);
        Self { max_weight: settings.max_weight, min_log_odds: occupancy.min, max_log_odds: occupancy.max }
    }
}

/// One integrator per field: they hold scratch memory, so all submaps share them.
#[derive(Debug)]
pub(super) struct Integrators {
    tsdf: Option<TsdfIntegrator>,
    /// Those of occupancy by sensor, made for its first scan.
    occupancy: BTreeMap<u16, OccupancyIntegrator>,
}

impl Integrators {
    pub fn new(settings: &Settings) -> Self {
        Self { tsdf: settings.field.has_tsdf().then(|| TsdfIntegrator::new(settings.into())), occupancy: BTreeMap::new() }
    }

    /// Integrates a scan of a sensor whose planes are fitted, without the parts that are redundant in the TSDF.
    pub fn integrate(
        &mut self,
        sensor: u16,
        submap: &mut Submap,
        t_submap_lidar: &Pose,
        scan: &KeptScan<'_>,
        settings: &Settings,
        redundancy: &Redundancy<'_>,
    ) -> (Option<TsdfStats>, Option<OccupancyStats>) {
        let occupancy = settings.field.has_occupancy();
        let occupancy = occupancy.then(|| self.occupancy.entry(sensor).or_insert_with(|| OccupancyIntegrator::new(settings.into(), scan.model())));
        let fields = FieldsMut { tsdf: &mut submap.tsdf, occupancy: &mut submap.occupancy };
        scan.in_submap(t_submap_lidar).integrate(fields, self.tsdf.as_mut(), occupancy, redundancy)
    }
}
