//! What a live run begins with: nothing, or what an earlier process has mapped.

use super::place::Place;
use super::relocalisation::Relocalisation;
use super::source::Started;
use crate::elastic::ElasticArgs;
use crate::jumps::Jumps;
use crate::mapping::Session;
use crate::resume::Unfinished;
use voxelastic::mapper::Mapper;
use voxelastic::sensor::BeamModel;
use voxelastic_slam::Corrector;
use voxelastic_slam::loops::LoopSettings;

/// What a run begins with, or goes on with.
pub struct Begun {
    pub session: Session,
    pub corrector: Corrector,
    pub jumps: Jumps,
    /// Scans that could not be used.
    pub skipped: usize,
    pub place: Place,
}

impl Begun {
    /// A new run, or one that goes on.
    pub fn new(
        elastic: ElasticArgs,
        unfinished: Option<Unfinished>,
        source: &Started,
        is_raw: bool,
        (mapper, sensor): (Mapper, Option<BeamModel>),
        pool: rayon::ThreadPool,
    ) -> anyhow::Result<Self> {
        let positions = source.positions();
        let Some(mut unfinished) = unfinished else {
            let (session, corrector) = (Session::new(mapper, pool), elastic.corrector(is_raw, None));
            return Ok(Self { session, corrector, jumps: Jumps::default(), skipped: 0, place: Place::new(positions, [0; 2]) });
        };
        let mut loops = LoopSettings::default();
        let is_recorded = match source.recorded() {
            Some(input) => {
                input.know_motions(unfinished.motions());
                true
            }
            None => {
                // What is kept of the scans does not tell it.
                loops.voxel_size = unfinished.loop_voxel_m;
                false
            }
        };
        let mut corrector = elastic.corrector_with(is_raw, unfinished.searches.clone(), loops);
        let (jumps, skipped, before) = (unfinished.jumps.clone(), unfinished.skipped, unfinished.came);
        let (last_node, next_node) = unfinished.nodes();
        let session = unfinished.session(mapper.settings(), sensor, source.clouds().as_mut(), &mut corrector, pool)?;
        let mut place = Place::new(positions, before);
        if !is_recorded {
            place.relocalisation = Some(Box::new(Relocalisation::new(&session, !is_raw)));
            (place.first_node, place.last_node) = (next_node, last_node);
        }
        Ok(Self { session, corrector, jumps, skipped, place })
    }
}
