//! What an odometry knows between two scans, so that another process can go on where this one is.

use super::alternation::Alternation;
use super::drift::Drift;
use super::level::Level;
use super::prediction::Predictor;
use super::recent::RecentScans;
use super::settings::OdometrySettings;
use super::tracker::{Last, Odometry};
use super::vertical::VerticalEstimator;
use crate::registration::LocalMap;
use nalgebra::UnitQuaternion;
use serde::{Deserialize, Serialize};

/// What an [`Odometry`] knows beside its settings; see [`Odometry::state`].
///
/// Its serialised form belongs to the version of the program that wrote it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct OdometryState {
    levels: Vec<LocalMap>,
    /// x y z w.
    map_from_voxels: [f64; 4],
    predictor: Predictor,
    last: Option<Last>,
    drift: Drift,
    piece: usize,
    scans: usize,
    failures: usize,
    score: f64,
    level: Level,
    is_leaning: bool,
    usual_returns: f64,
    alternation: Alternation,
    recent: RecentScans,
    vertical: VerticalEstimator,
}

impl Odometry {
    /// What it knows.
    pub fn state(&self) -> OdometryState {
        OdometryState {
            levels: self.levels.clone(),
            map_from_voxels: self.map_from_voxels.coords.into(),
            predictor: self.predictor.clone(),
            last: self.last,
            drift: self.drift.clone(),
            piece: self.piece,
            scans: self.scans,
            failures: self.failures,
            score: self.score,
            level: self.level,
            is_leaning: self.is_leaning,
            usual_returns: self.usual_returns,
            alternation: self.alternation.clone(),
            recent: self.recent.clone(),
            vertical: self.vertical.clone(),
        }
    }

    /// An odometry that goes on from `state`, with the settings of the one that it is of: it finds the same poses, bit for bit.
    pub fn resume(settings: OdometrySettings, state: OdometryState) -> Self {
        let mut odometry = Self::new(settings);
        if let Some(finest) = state.levels.first() {
            odometry.scratch.scan_map = LocalMap::new(finest.size() * odometry.settings.source_spacing);
        }
        let OdometryState {
            levels,
            map_from_voxels,
            predictor,
            last,
            drift,
            piece,
            scans,
            failures,
            score,
            level,
            is_leaning,
            usual_returns,
            alternation,
            recent,
            vertical,
        } = state;
        let map_from_voxels = UnitQuaternion::new_unchecked(map_from_voxels.into());
        Self {
            levels,
            map_from_voxels,
            predictor,
            last,
            drift,
            piece,
            scans,
            failures,
            score,
            level,
            is_leaning,
            usual_returns,
            alternation,
            recent,
            vertical,
            ..odometry
        }
    }
}
