//! What of a scan lies beside the surfaces of a place: furniture that stands in only one of two rooms that look alike.

use super::place::PlaceScan;
use crate::registration::{LocalMap, Surfel, VoxelIndex, key};
use voxelastic::geometry::{Pose, Rigid};

/// A surface is the map's own if it is as near to its plane, or to what is no plane, in voxels.
const SAME: (f32, f32) = (0.5, 1.0);
/// A surface continues a plane of the map that is no farther away, in voxels: what was mapped by few scans has gaps.
const CONTINUES: f32 = 5.0;
/// A surface that is no farther from one of the map lies where the map was seen, in voxels.
const SEEN: f32 = 3.0;
/// Cosine of the largest angle between normals that are alike.
const ALIKE: f32 = 0.9;

/// Share of a scan's surfaces beside those of a place, `None` where none of them is near the place's. Neither those count that continue one of the map's planes, nor those where the map has
/// nothing.
pub(super) fn beside(place: &[PlaceScan], scan: &[Surfel], t_place_scan: &Pose, voxel: f64) -> Option<f64> {
    let mut map = LocalMap::new(voxel);
    place.iter().for_each(|scan| map.insert(scan.points.iter().map(|p| p.map(f64::from))));
    let mut surfels = Vec::new();
    map.surfels(&mut surfels);
    let cells = Cells::new(&surfels, CONTINUES * voxel as f32);
    let (moved, turned) = (Rigid::from(t_place_scan), t_place_scan.rotation.cast::<f32>());
    let (mut on, mut beside) = (0usize, 0usize);
    for surfel in scan {
        let normal = turned * nalgebra::Vector3::from(surfel.normal);
        match cells.standing(&Surfel { point: moved.apply(surfel.point), normal: normal.into() }, voxel as f32) {
            Standing::On => on += 1,
            Standing::Beside => beside += 1,
            Standing::Open => {}
        }
    }
    (on + beside > 0).then(|| beside as f64 / (on + beside) as f64)
}

/// How a surface of a scan stands to those of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Standing {
    On,
    Beside,
    /// It continues a plane of the map, or is where the map has nothing.
    Open,
}

/// Surfaces of a map by cells as wide as they are looked for.
struct Cells<'a> {
    edge: f32,
    index: VoxelIndex,
    surfels: Vec<Vec<&'a Surfel>>,
}

impl<'a> Cells<'a> {
    fn new(surfels: &'a [Surfel], edge: f32) -> Self {
        let mut cells = Self { edge, index: VoxelIndex::default(), surfels: Vec::new() };
        for surfel in surfels {
            let (at, is_new) = cells.index.get_or_insert(key(cells.coordinates(surfel.point)), cells.surfels.len() as u32);
            if is_new {
                cells.surfels.push(Vec::new());
            }
            cells.surfels[at as usize].push(surfel);
        }
        cells
    }

    fn coordinates(&self, p: [f32; 3]) -> [i32; 3] {
        p.map(|v| (v / self.edge).floor() as i32)
    }

    fn standing(&self, of: &Surfel, voxel: f32) -> Standing {
        let [x, y, z] = self.coordinates(of.point);
        let around = (0..27).filter_map(|k| self.index.get(key([x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1])));
        let mut nearest = f32::INFINITY;
        let mut continues = false;
        for surfel in around.flat_map(|at| &self.surfels[at as usize]) {
            let way: [f32; 3] = std::array::from_fn(|k| of.point[k] - surfel.point[k]);
            let distance = dot(way, way).sqrt() / voxel;
            if distance > CONTINUES {
                continue;
            }
            nearest = nearest.min(distance);
            let is_plane = [of, surfel].map(|s| s.normal != [0.0; 3]);
            let is_alike = !is_plane[0] || dot(of.normal, surfel.normal).abs() > ALIKE;
            if is_plane[1] && is_alike && dot(way, surfel.normal).abs() < SAME.0 * voxel {
                if distance < 1.5 {
                    return Standing::On;
                }
                continues = true;
            } else if is_plane != [true, true] && distance < SAME.1 {
                return Standing::On;
            }
        }
        if nearest <= SEEN && !continues { Standing::Beside } else { Standing::Open }
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| a[k] * b[k]).sum()
}
