//! Refining a saved map: its surfaces correct its poses, and its submaps are made again from their scans with the poses that follow.

use crate::mapping::Mapping;
use crate::warning::{Code, Warnings};
use crate::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, SubmapId};
use voxelastic::event::{Event, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic::mapper::ScanSource;
use voxelastic::{Cloud, Mapper};
use voxelastic_slam::refine::{Judgement, RefineSettings, Refined, ScanSurface, refine};

/// Poses of lidars in the map.
pub type Poses = Vec<(NodeId, Pose)>;

/// Edges of the cells of scans that are tried, metres: thin clouds need larger ones.
const CELLS: [f32; 3] = [0.2, 0.4, 0.8];
/// The share of the surfels of a scan that must be planes, for the smallest cells that have it.
const LEAST_PLANARITY: f64 = 0.25;
/// Scans that are looked at to choose the cells, and scans that are read before they are worked on together.
const LOOKED_AT: usize = 5;
const AT_A_TIME: usize = 16;
/// A share of held-out points near planes below which poses and scans do not belong together.
const LEAST_NEAR: f64 = 0.1;

/// The scans of a map as refinement needs them.
pub struct MapScans {
    nodes: Vec<NodeId>,
    poses: Vec<Pose>,
    surfaces: Vec<ScanSurface>,
    cell: f32,
}

/// What became of a refinement.
#[derive(Clone, Debug, Serialize)]
pub struct RefineSummary {
    /// Whether poses were changed.
    pub refined: bool,
    /// Scans.
    pub scans: usize,
    /// Edge of the cells in which the points of a scan are summed, metres.
    pub cell_m: f32,
    /// By how much scans moved, root mean square, metres.
    pub moved_rms_m: f64,
    /// By how much a scan moved at most, metres.
    pub moved_most_m: f64,
    /// How well scans lay on each other's planes before.
    pub before: PlaneFigures,
    /// How well they do with the poses that were kept.
    pub after: PlaneFigures,
    /// Rounds that were tried.
    pub rounds: usize,
    /// Rounds whose poses were kept.
    pub rounds_kept: usize,
}

/// How well scans lie on each other's planes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PlaneFigures {
    /// Planes that several scans see.
    pub planes: usize,
    /// Thickness of the planes (one standard deviation of the points across each, with the noise of the sensor), metres, that half of them do not exceed; `null` without planes.
    pub thickness_m: Option<f64>,
    /// That which 90 % of them do not exceed.
    pub thickness_90_m: Option<f64>,
    /// The share of the points that were held out that is near a plane of other scans.
    pub near: f64,
    /// Distance of these from it, metres: half of them do not exceed it.
    pub distance_m: Option<f64>,
    /// The figure that decides, smaller is better: the mean of `ln(1 + (distance / 5 mm)^2) / 2` over the points that were held out.
    pub score: f64,
}

impl From<Judgement> for PlaneFigures {
    fn from(j: Judgement) -> Self {
        let known = |v: f64| v.is_finite().then_some(v);
        Self {
            planes: j.planes,
            thickness_m: known(j.thickness_m),
            thickness_90_m: known(j.thickness_90_m),
            near: j.near,
            distance_m: known(j.distance_m),
            score: j.score,
        }
    }
}

impl MapScans {
    /// Reads the scans of a map again. `next` is told before each how many were read and how many there are, and says whether to go on; none if it does not.
    ///
    /// # Errors
    /// When the data lack a scan of the map, or a sweep has times but its motion is not known.
    pub fn read(atlas: &Atlas, clouds: &mut dyn ScanSource, mut next: impl FnMut(usize, usize) -> bool) -> Result<Option<Self>> {
        let mut track: Vec<(NodeId, Pose)> = Vec::new();
        for submap in atlas.submaps() {
            track.extend(submap.corrected_scans().map(|(node, t_submap_lidar)| (node, submap.t_map_submap() * t_submap_lidar)));
        }
        track.sort_by_key(|(node, _)| *node);
        track.dedup_by_key(|(node, _)| *node);
        let (nodes, poses): (Vec<NodeId>, Vec<Pose>) = track.into_iter().unzip();
        let mut surfaces = Vec::with_capacity(nodes.len());
        let mut cell = None;
        for chunk in nodes.chunks(AT_A_TIME) {
            let mut points = Vec::with_capacity(chunk.len());
            for node in chunk {
                if !next(surfaces.len() + points.len(), nodes.len()) {
                    return Ok(None);
                }
                points.push(returns(*node, clouds)?);
            }
            let cell = *cell.get_or_insert_with(|| cell_for(&points));
            surfaces.par_extend(points.par_iter().map(|points| ScanSurface::of(points, cell)));
        }
        Ok(Some(Self { nodes, poses, surfaces, cell: cell.unwrap_or(CELLS[0]) }))
    }

    /// Number of scans.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Refines the poses. What was not done is a warning. Returns the poses if they are better, and what was found.
    ///
    /// # Errors
    /// When the equations do not fit into memory.
    pub fn refine(&self, warnings: &mut Warnings) -> Result<(Option<Poses>, RefineSummary)> {
        let settings = RefineSettings::default();
        let refined = refine(&self.poses, &self.surfaces, &[], f64::from(self.cell), &settings).map_err(|e| Error::new(e.to_string(), ""))?;
        let moved: Vec<f64> = self.poses.iter().zip(&refined.poses).map(|(a, b)| a.translation_distance(b)).collect();
        let kept = refined.rounds.iter().filter(|round| round.is_kept).count();
        let summary = RefineSummary {
            refined: kept > 0,
            scans: self.len(),
            cell_m: self.cell,
            moved_rms_m: (moved.iter().map(|m| m * m).sum::<f64>() / moved.len().max(1) as f64).sqrt(),
            moved_most_m: moved.iter().copied().fold(0.0, f64::max),
            before: refined.before.into(),
            after: refined.after.into(),
            rounds: refined.rounds.len(),
            rounds_kept: kept,
        };
        if kept == 0 {
            warnings.add(Code::NotRefined, format!("the poses are as they were: {}", why_not(&refined, self.len())), "");
            return Ok((None, summary));
        }
        Ok((Some(self.nodes.iter().copied().zip(refined.poses).collect()), summary))
    }
}

/// Why no poses were kept, in words.
fn why_not(refined: &Refined, scans: usize) -> String {
    if refined.before.planes == 0 {
        return format!("no plane is seen by two of the {scans} scans");
    }
    if refined.before.near < LEAST_NEAR {
        let share = 100.0 * refined.before.near;
        return format!("only {share:.0} % of the points are near a plane of another scan: there are few planes here, or the poses are too far off");
    }
    "points that were held out do not lie nearer to the planes of other scans with any others".to_owned()
}

fn returns(node: NodeId, clouds: &mut dyn ScanSource) -> Result<Vec<[f32; 3]>> {
    let remedy = "name the data that the map was made of, with the same --every, --poses and topics";
    let cloud = clouds.cloud(node).map_err(|e| Error::new(format!("scan {node} of the map cannot be read from the data: {e}"), remedy))?;
    let still = cloud.undistorted();
    if still.is_none() && has_times(&cloud) {
        let what = format!("the points of scan {node} have times, and how the sensor moved during the sweep is not in the data");
        return Err(Error::new(
            what,
            "write the poses with `voxelastic odometry` and map with them, or say --point-times undistorted if the clouds are undistorted already",
        ));
    }
    Ok(still.unwrap_or(cloud).points.into_iter().filter(Cloud::is_return).collect())
}

fn has_times(cloud: &Cloud) -> bool {
    cloud.time.as_ref().is_some_and(|times| times.iter().any(|t| t.is_finite() && *t != times[0]))
}

/// The smallest cells in which enough surfels are planes.
fn cell_for(scans: &[Vec<[f32; 3]>]) -> f32 {
    let planarity = |cell: f32| {
        let looked_at = &scans[..scans.len().min(LOOKED_AT)];
        looked_at.iter().map(|points| ScanSurface::of(points, cell).planarity()).sum::<f64>() / looked_at.len().max(1) as f64
    };
    CELLS.into_iter().find(|cell| planarity(*cell) >= LEAST_PLANARITY).unwrap_or(CELLS[2])
}

/// Moves the submaps of a saved map to corrected poses, and makes all of them again from their scans. `next` is told before each submap how many were made and how many there are,
/// and says whether to go on. Returns the mapping, and whether all were made.
///
/// # Errors
/// Poses that are none.
pub fn rebuilt(
    mapper: Mapper,
    pool: rayon::ThreadPool,
    poses: Vec<(NodeId, Pose)>,
    clouds: &mut (dyn ScanSource + Send),
    warnings: &mut Warnings,
    mut next: impl FnMut(usize, usize) -> bool,
) -> Result<(Mapping, bool)> {
    let mut mapping = Mapping::new(mapper, pool, None);
    mapping.take(Event::PoseUpdate(poses))?;
    let submaps: Vec<SubmapId> = mapping.atlas().submaps().iter().map(|s| s.id()).collect();
    for (k, id) in submaps.iter().enumerate() {
        if !next(k, submaps.len()) {
            return Ok((mapping, false));
        }
        if let Err(error) = mapping.rebuild(*id, clouds) {
            warnings.add(Code::NotRebuilt, format!("submap {id} is not rebuilt: {}", crate::error::one_line(&error)), "");
        }
    }
    mapping.finish();
    Ok((mapping, true))
}
