//! A place: the scans taken along some metres of the path, in the frame of one of them.

use super::density_image::{Column, columns};
use super::signature::{Signature, SignatureMaker};
use crate::free_space::View;
use crate::registration::{Downsampler, LocalMap, Surfel};
use nalgebra::{UnitQuaternion, Vector3};
use voxelastic::event::NodeId;
use voxelastic::geometry::{Pose, Rigid};

/// Cosine of the angle between a surface's normal and the vertical below which it may be ground.
const LEVEL_COSINE: f32 = 0.9;
/// Share of the surfaces that must be level to say where the vertical is.
const LEVEL_SHARE: f32 = 0.05;
/// Levels of a place's map for registration.
const LEVELS: usize = 3;
/// Points per voxel edge that enter a place's map.
const DENSITY: f64 = 3.0;
/// Distance between points that are registered, in voxel edges.
const SPACING: f64 = 1.4;

/// The scan at a node, thinned.
#[derive(Clone, Debug)]
pub(crate) struct Keyframe {
    pub(crate) node: NodeId,
    /// Pose in the frame in which the poses came.
    pub(crate) t_map_lidar: Pose,
    /// Number of the piece of the trajectory.
    pub(crate) piece: usize,
    /// Length of the path up to here, metres.
    pub(crate) path: f64,
    /// In the lidar frame.
    pub(crate) points: Vec<[f32; 3]>,
}

/// A thinned scan in the frame of its place.
#[derive(Clone, Debug)]
pub(crate) struct PlaceScan {
    pub(crate) node: NodeId,
    pub(crate) t_anchor_lidar: Pose,
    pub(crate) points: Vec<[f32; 3]>,
}

/// A place that may be seen again.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    /// The node whose lidar frame is the frame of the place.
    pub(crate) node: NodeId,
    pub(crate) t_map_anchor: Pose,
    pub(crate) piece: usize,
    /// Length of the path up to the anchor, metres.
    pub(crate) path: f64,
    pub(crate) scans: Vec<PlaceScan>,
    /// Turns the frame of the place so that z is up.
    pub(crate) level: UnitQuaternion<f64>,
    /// What stands where, in the levelled frame.
    pub(crate) columns: Vec<Column>,
    pub(crate) signature: Signature,
}

impl Place {
    /// The place of some keyframes, in the frame of the middle one; none if there are none.
    pub(crate) fn new(keyframes: &[&Keyframe], voxel: f64, maker: &SignatureMaker) -> Option<Self> {
        Self::anchored(keyframes, keyframes.len() / 2, voxel, maker)
    }

    /// The place of some keyframes, in the frame of the one with this number; none if there is none.
    pub(crate) fn anchored(keyframes: &[&Keyframe], anchor: usize, voxel: f64, maker: &SignatureMaker) -> Option<Self> {
        let anchor = *keyframes.get(anchor)?;
        let scan = |k: &&Keyframe| {
            let t_anchor_lidar = anchor.t_map_lidar.inv_mul(&k.t_map_lidar);
            let moved = Rigid::from(&t_anchor_lidar);
            PlaceScan { node: k.node, t_anchor_lidar, points: k.points.iter().map(|p| moved.apply(*p)).collect() }
        };
        let scans: Vec<PlaceScan> = keyframes.iter().map(scan).collect();
        let level = level(&surfels(&scans, voxel));
        let turn = Rigid::from(&Pose::from_parts(Vector3::zeros().into(), level));
        let points = scans.iter().flat_map(|s| s.points.iter().map(|p| turn.apply(*p)));
        let columns = columns(points, voxel as f32);
        let signature = maker.signature(&columns, voxel as f32);
        let Keyframe { node, t_map_lidar, piece, path, .. } = *anchor;
        Some(Self { node, t_map_anchor: t_map_lidar, piece, path, scans, level, columns, signature })
    }

    /// The scan at `index` with those around it, at most `around` to either side.
    pub(crate) fn scans_around(&self, index: usize, around: usize) -> &[PlaceScan] {
        &self.scans[index.saturating_sub(around)..(index + around + 1).min(self.scans.len())]
    }

    /// The pose of one of its nodes in its frame.
    pub(crate) fn t_anchor(&self, node: NodeId) -> Option<Pose> {
        self.scans.iter().find(|scan| scan.node == node).map(|scan| scan.t_anchor_lidar)
    }

    /// The scans, as the free-space veto takes them.
    pub(crate) fn views(&self) -> Vec<View<'_>> {
        self.scans.iter().map(|scan| View { origin: scan.t_anchor_lidar.translation.vector.map(|v| v as f32).into(), points: &scan.points }).collect()
    }
}

/// The edge of the voxels in which the free space of places is looked at that are registered in voxels of edge `voxel`. It is finer: a cupboard stands in what its place in
/// another storey, with the same walls, has free; in voxels as large as it is deep, it would be the wall.
pub(crate) fn free_voxel(voxel: f64) -> f32 {
    0.5 * voxel as f32
}

/// The map that other scans are registered to, from fine to coarse.
pub(crate) fn levels(scans: &[PlaceScan], voxel: f64) -> Vec<LocalMap> {
    let mut levels: Vec<LocalMap> = (0..LEVELS).map(|k| LocalMap::new(voxel * f64::from(1u32 << k))).collect();
    for level in &mut levels {
        scans.iter().for_each(|scan| level.insert(scan.points.iter().map(|p| p.map(f64::from))));
    }
    levels
}

/// A cloud with one point for each third of a voxel, and not more than `most`.
pub(crate) fn thinned(downsampler: &mut Downsampler, points: &[[f32; 3]], voxel: f64, most: usize) -> Vec<[f32; 3]> {
    let mut means = Vec::new();
    downsampler.means(points, (voxel / DENSITY) as f32, &mut means);
    let step = means.len().div_ceil(most).max(1);
    means.into_iter().step_by(step).collect()
}

/// Points and normals, one for each voxel, for registration to other scans.
pub(crate) fn surfels(scans: &[PlaceScan], voxel: f64) -> Vec<Surfel> {
    let mut map = LocalMap::new(voxel * SPACING);
    scans.iter().for_each(|scan| map.insert(scan.points.iter().map(|p| p.map(f64::from))));
    let mut out = Vec::new();
    map.surfels(&mut out);
    out
}

/// The rotation that makes level surfaces level: their mean normal, found from the sensor's own vertical.
fn level(surfels: &[Surfel]) -> UnitQuaternion<f64> {
    let mut up = Vector3::z();
    for _ in 0..3 {
        let (mut sum, mut count) = (Vector3::zeros(), 0);
        for surfel in surfels {
            let normal = Vector3::from(surfel.normal.map(f64::from));
            let cosine = normal.dot(&up);
            if cosine.abs() > f64::from(LEVEL_COSINE) {
                sum += normal * cosine.signum();
                count += 1;
            }
        }
        if (count as f32) < LEVEL_SHARE * surfels.len() as f32 || sum.norm() == 0.0 {
            return UnitQuaternion::identity();
        }
        up = sum.normalize();
    }
    UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_default()
}
