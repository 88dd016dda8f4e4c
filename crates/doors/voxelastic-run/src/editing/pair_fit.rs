//! How the surfaces of two submaps fit, and the pairs whose surfaces should lie on each other and do not.

use super::state::State;
use crate::error::Result;
use rayon::prelude::*;
use serde::Serialize;
use voxelastic::atlas::fusion::PairAgreement;
use voxelastic::atlas::{Atlas, Submap, SubmapId};

/// Pairs with fewer places in common say little.
const LEAST_PLACES: u64 = 40;
/// A pair is misaligned if less than this share of its places match, or if those that do are farther apart than this, voxels.
const LEAST_MATCHED: f64 = 0.4;
const MOST_APART: f64 = 0.75;

/// How the surfaces of two submaps fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PairFit {
    /// The two.
    pub submaps: [SubmapId; 2],
    /// Places on their surfaces where both have some within a few metres.
    pub places: u64,
    /// Share of these that have a partner within five voxels that faces the same way, 0 to 1.
    pub matched: f64,
    /// Mean distance of these partners along the normal, metres.
    pub apart_m: f64,
}

impl PairFit {
    /// Of two submaps of a map with finest voxels of `voxel` metres.
    pub fn of(pair: &PairAgreement, voxel: f32) -> Self {
        let matched = pair.matched as f64 / pair.places.max(1) as f64;
        Self { submaps: pair.submaps, places: pair.places, matched, apart_m: pair.apart * f64::from(voxel) }
    }

    /// Places that agree, those of partners that are apart in part; `voxel`, metres.
    pub fn agreeing(&self, voxel: f64) -> f64 {
        self.places as f64 * self.matched * (1.0 - self.apart_m / (PairAgreement::REACH * voxel))
    }
}

/// The pairs of submaps that do not fit, those with most places that do first. Of two that saw a wall from either side few places match, too: somebody has to look.
pub fn misaligned(pairs: &[PairFit], voxel: f64) -> Vec<PairFit> {
    let is_misaligned = |pair: &&PairFit| pair.places >= LEAST_PLACES && (pair.matched < LEAST_MATCHED || pair.apart_m > MOST_APART * voxel);
    let wrong = |pair: &PairFit| pair.places as f64 - pair.agreeing(voxel);
    let mut found: Vec<PairFit> = pairs.iter().filter(is_misaligned).copied().collect();
    found.sort_by(|a, b| wrong(b).total_cmp(&wrong(a)).then(a.submaps.cmp(&b.submaps)));
    found
}

/// How two submaps fit; none if they have no surfaces in the same places.
pub fn fit(state: &State, submaps: [SubmapId; 2]) -> Result<Option<PairFit>> {
    let submaps = submaps.par_iter().map(|id| state.submap(*id)).collect::<Result<Vec<_>>>()?;
    let voxel = submaps.first().map_or(1.0, Submap::voxel_size);
    Ok(Atlas::from_submaps(voxel, submaps).pair_agreement().first().map(|pair| PairFit::of(pair, voxel)))
}
