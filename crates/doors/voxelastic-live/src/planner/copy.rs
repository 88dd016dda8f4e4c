//! A copy of the occupancy of a map, kept up from what changes: who works on it keeps nobody waiting.

use std::collections::HashMap;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapId, SubmapScan};
use voxelastic::field::occupancy::OccupancyField;
use voxelastic::field::tsdf::TsdfField;

/// What a copy has of a submap: the revisions of the submap and of its occupancy.
type Revisions = [u64; 2];

/// Which state of a map its copy has.
#[derive(Debug, Default)]
pub struct Copied(HashMap<SubmapId, Revisions>);

/// What has changed in a map, as a copy.
#[derive(Debug)]
pub struct MapChanges {
    voxel_size: f32,
    /// All submaps there are.
    submaps: Vec<SubmapChanges>,
}

#[derive(Debug)]
struct SubmapChanges {
    id: SubmapId,
    t_map_submap: Pose,
    /// None if they are those of before.
    scans: Option<Vec<SubmapScan>>,
    /// None if it is that of before.
    occupancy: Option<OccupancyField>,
}

impl Copied {
    /// Copies what has changed since the last call: the occupancy of submaps in which something did, which is mostly the one that grows, and poses of all.
    pub fn changes(&mut self, atlas: &Atlas) -> MapChanges {
        let mut copied = HashMap::new();
        let submaps = atlas
            .placed()
            .map(|(submap, t_map_submap)| {
                let revisions = [submap.revision(), submap.occupancy().revision()];
                copied.insert(submap.id(), revisions);
                let before = self.0.get(&submap.id());
                let has_changed = |k: usize| before.is_none_or(|before| before[k] != revisions[k]);
                SubmapChanges {
                    id: submap.id(),
                    t_map_submap,
                    scans: has_changed(0).then(|| submap.scans().to_vec()),
                    occupancy: has_changed(1).then(|| submap.occupancy().clone()),
                }
            })
            .collect();
        self.0 = copied;
        MapChanges { voxel_size: atlas.voxel_size(), submaps }
    }
}

/// The copy: submaps with occupancy, scans and poses, without surfaces. The source of a fusion in progress is a submap like the others.
#[derive(Debug)]
pub struct MapCopy(Atlas);

impl MapCopy {
    /// Of nothing.
    pub fn new() -> Self {
        Self(Atlas::new(1.0))
    }

    /// The map as it was when the last changes were copied.
    pub fn atlas(&self) -> &Atlas {
        &self.0
    }

    /// Brings the copy up to date.
    pub fn apply(&mut self, changes: MapChanges) {
        let before = std::mem::replace(&mut self.0, Atlas::new(changes.voxel_size)).into_submaps();
        let mut before: HashMap<SubmapId, Submap> = before.into_iter().map(|submap| (submap.id(), submap)).collect();
        let submaps = changes.submaps.into_iter().map(|change| {
            let mut submap = before.remove(&change.id).unwrap_or_else(|| Submap::new(change.id, changes.voxel_size, change.t_map_submap));
            submap.set_pose(change.t_map_submap);
            if let Some(occupancy) = change.occupancy {
                submap = submap.with_fields(TsdfField::default(), occupancy);
            }
            match change.scans {
                Some(scans) => submap.with_scans(scans, 0.0),
                None => submap,
            }
        });
        self.0 = Atlas::from_submaps(changes.voxel_size, submaps.collect());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::event::Event;
    use voxelastic::settings::FieldKind;
    use voxelastic::{Mapper, Settings};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    #[test]
    fn a_copy_is_what_the_map_is_and_takes_only_what_has_changed() {
        let settings = Settings { voxel_size: 0.2, max_range: 12.0, field: FieldKind::Occupancy, lambda_odom: 2.0, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let sim = Simulation::new(SimOptions { scans: Some(8), columns: Some(128), spacing: 1.0, ..SimOptions::of("street") }).unwrap();
        let (mut copied, mut copy) = (Copied::default(), MapCopy::new());
        let mut update = |mapper: &Mapper| {
            let changes = copied.changes(mapper.atlas());
            let taken = changes.submaps.iter().filter(|submap| submap.occupancy.is_some()).count();
            copy.apply(changes);
            let (theirs, ours) = (mapper.atlas().query().unwrap(), copy.atlas().query().unwrap());
            let points: Vec<[f64; 3]> =
                (0..4000).map(|k| [f64::from(k % 40) - 20.0, f64::from(k / 40 % 20) - 10.0, f64::from(k / 800) * 0.7]).collect();
            let points: Vec<[f64; 3]> =
                points.iter().map(|p| std::array::from_fn(|k| p[k] + sim.poses(PoseSource::Truth)[0].translation.vector[k])).collect();
            assert_eq!(theirs.states(&points), ours.states(&points));
            let scans = |atlas: &Atlas| atlas.submaps().iter().map(|submap| (submap.t_map_submap(), submap.scans().to_vec())).collect::<Vec<_>>();
            assert_eq!(scans(mapper.atlas()), scans(copy.atlas()));
            taken
        };
        let mut taken = Vec::new();
        for scan in sim.scans(PoseSource::Truth) {
            mapper.handle(Event::Scan(scan)).unwrap();
            taken.push(update(&mapper));
        }
        assert!(mapper.atlas().submaps().len() > 2 && taken.iter().all(|count| (1..=2).contains(count)), "{taken:?}");
        assert_eq!(update(&mapper), 0, "nothing has changed");
        let moved = (0..8).map(|node| (node, Pose::translation(1.0, 0.0, 0.0) * mapper.pose(node).unwrap())).collect();
        mapper.handle(Event::PoseUpdate(moved)).unwrap();
        assert_eq!(update(&mapper), 0, "poses alone");
    }
}
