//! What a second lap adds to a TSDF map, counted by voxel: where new voxels are, and whether filling gaps would have created them before.
//!
//!     voxelastic simulate campus --laps 2 -o campus2
//!     voxelastic map campus2 --poses groundtruth --field tsdf --max-scans 182 -o one.vox
//!     voxelastic map campus2 --poses groundtruth --field tsdf -o two.vox
//!     cargo run --release -p voxelastic-bench --example laps -- one.vox two.vox
//!
//! Only current arrays count, and voxels of blocks that changed their scale in between are counted separately. Submaps with equal numbers are compared.

use std::error::Error;
use std::path::Path;
use voxelastic::atlas::Atlas;
use voxelastic::field::tsdf::{TsdfField, Voxel, WEIGHT_ONE};
use voxelastic::octree::{BLOCK_EDGE, block_coords, edge_at, voxel_coords};
use voxelastic_io::store::MapStore;

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// Voxels along an edge of a brick.
const BRICK_EDGE: usize = 4;
/// Widths of the gaps that are filled for comparison, voxels.
const GAPS: [usize; 5] = [0, 1, 2, 4, 7];
/// Width of the bins of the distance to the nearest scan, metres.
const RING: f64 = 5.0;
const RINGS: usize = 8;

/// Voxels of both maps, and of the second one only.
#[derive(Clone, Copy, Default)]
struct OldAndNew {
    old: usize,
    new: usize,
}

impl OldAndNew {
    fn add(&mut self, is_old: bool) {
        *(if is_old { &mut self.old } else { &mut self.new }) += 1;
    }

    fn print(&self, what: &str) {
        println!("{what:28} {:>12} {:>12} {:>+7.1} %", self.old, self.new, 100.0 * self.new as f64 / self.old.max(1) as f64);
    }
}

/// Counts of voxels.
#[derive(Default)]
struct Counts {
    all: OldAndNew,
    /// Up to half a diagonal of a voxel from the surface, and farther.
    near: OldAndNew,
    far: OldAndNew,
    rings: [OldAndNew; RINGS],
    /// New voxels in new blocks, in new bricks of old blocks, and in old bricks; those that were seen once; and voxels of blocks that changed
    /// their scale.
    in_new_block: usize,
    in_new_brick: usize,
    in_old_brick: usize,
    once: usize,
    rescaled: usize,
}

fn main() -> Result<()> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [before, after] = &paths[..] else { return Err("give two maps: after one lap, and after two".into()) };
    let open = |path: &String| -> Result<(Atlas, f64)> {
        let store = MapStore::open(Path::new(path))?;
        let voxel: f64 = store.manifest().details.settings.get("voxel_size").ok_or("the map does not say how large its voxels are")?.parse()?;
        Ok((store.load_atlas()?, voxel))
    };
    let ((before, _), (after, voxel)) = (open(before)?, open(after)?);
    let mut counts = Counts::default();
    for submap in after.submaps() {
        let scans: Vec<[f64; 3]> = submap.scans().iter().map(|scan| scan.t_submap_lidar.translation.vector.into()).collect();
        let Some(old) = before.submap(submap.id()) else {
            println!("submap {}: {} scans, not there before: left out, but for filled gaps", submap.id(), submap.scans().len());
            continue;
        };
        println!("submap {}: {} scans, then {}", submap.id(), old.scans().len(), submap.scans().len());
        count(old.tsdf(), submap.tsdf(), voxel, &scans, &mut counts);
    }
    println!("\n{:28} {:>12} {:>12}", "voxels", "old", "new");
    counts.all.print("all");
    counts.near.print("nearer than 0.87 voxels");
    counts.far.print("farther");
    for (i, ring) in counts.rings.iter().enumerate() {
        let to = if i + 1 < RINGS { format!("to {}", RING * (i + 1) as f64) } else { "and more".to_owned() };
        ring.print(&format!("{} {to} m from a scan", RING * i as f64));
    }
    let Counts { in_new_block, in_new_brick, in_old_brick, once, rescaled, .. } = counts;
    println!("new ones: {in_new_block} in new blocks, {in_new_brick} in new bricks, {in_old_brick} in old bricks; {once} seen once");
    println!("in blocks of another scale than before: {rescaled}\n");
    for gap in GAPS {
        let [a, b] = [&before, &after].map(|atlas| atlas.submaps().iter().map(|s| filled(s.tsdf(), gap)).sum::<usize>());
        println!("with gaps of up to {gap} voxels filled: {a}, then {b}: {:+.1} %", 100.0 * (b as f64 / a as f64 - 1.0));
    }
    Ok(())
}

/// Which brick of its array voxel `index` lies in.
fn brick(index: usize, scale: usize) -> usize {
    let [x, y, z] = voxel_coords(index, scale).map(|c| c / BRICK_EDGE);
    x | y << 1 | z << 2
}

/// Adds what is in `after` to `counts`, by what was in `before`. Edges of finest voxels are `voxel` metres long; `scans` are in the submap's frame.
fn count(before: &TsdfField, after: &TsdfField, voxel: f64, scans: &[[f64; 3]], counts: &mut Counts) {
    for id in after.ids() {
        let block = after.block(id);
        let scale = usize::from(block.scale);
        let now = after.current(block);
        let old = before.find(block.key).map(|id| before.block(id));
        if old.is_some_and(|old| old.scale != block.scale) {
            counts.rescaled += now.iter().filter(|v| v.is_observed()).count();
            continue;
        }
        let old: Option<Vec<Voxel>> = old.map(|old| before.current(old));
        let was = |index: usize| old.as_ref().is_some_and(|old| old[index].is_observed());
        let mut had = [false; 8];
        (0..now.len()).filter(|&i| was(i)).for_each(|i| had[brick(i, scale)] = true);
        let centre = block_coords(block.key).map(|c| (f64::from(c) + 0.5) * BLOCK_EDGE as f64 * voxel);
        let away = |scan: &[f64; 3]| (0..3).map(|k| (scan[k] - centre[k]).powi(2)).sum::<f64>().sqrt();
        let ring = ((scans.iter().map(away).fold(f64::INFINITY, f64::min) / RING) as usize).min(RINGS - 1);
        for (i, v) in now.iter().enumerate().filter(|(_, v)| v.is_observed()) {
            let is_old = was(i);
            counts.all.add(is_old);
            (if v.distance_in_voxels().abs() < 0.87 { &mut counts.near } else { &mut counts.far }).add(is_old);
            counts.rings[ring].add(is_old);
            if !is_old {
                *(match (&old, had[brick(i, scale)]) {
                    (None, _) => &mut counts.in_new_block,
                    (_, false) => &mut counts.in_new_brick,
                    _ => &mut counts.in_old_brick,
                }) += 1;
                counts.once += usize::from(v.weight <= WEIGHT_ONE);
            }
        }
    }
}

/// Voxels of a field if all gaps of up to `most` voxels between two known ones, on a line along an axis within a block, were filled.
fn filled(field: &TsdfField, most: usize) -> usize {
    let of_block = |id: u32| {
        let block = field.block(id);
        let edge = edge_at(block.scale.into());
        let known: Vec<bool> = field.current(block).iter().map(|v| v.is_observed()).collect();
        let mut full = known.clone();
        for (step, others) in [(1, [edge, edge * edge]), (edge, [1, edge * edge]), (edge * edge, [1, edge])] {
            for start in (0..edge * edge).map(|i| i % edge * others[0] + i / edge * others[1]) {
                let on_line: Vec<usize> = (0..edge).map(|i| start + i * step).filter(|&i| known[i]).collect();
                for pair in on_line.windows(2).filter(|pair| (pair[1] - pair[0]) / step <= most + 1) {
                    (pair[0]..pair[1]).step_by(step).for_each(|i| full[i] = true);
                }
            }
        }
        full.iter().filter(|&&known| known).count()
    };
    field.ids().map(of_block).sum()
}
