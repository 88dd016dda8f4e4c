//! Cost of collision checks, and what the octree's maxima save: checks per second, the level at which they end, and the same checks on a dense array
//! of voxels.
//!
//! ```sh
//! cargo run --release -p voxelastic-plan --example checks -- mine.vox
//! ```
//!
//! Positions are drawn in free space of the largest submap. Times are processor time of one thread.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rustix::time::{ClockId, clock_gettime};
use serde_json::{Value, json};
use std::hint::black_box;
use voxelastic::field::occupancy::{OccupancyField, State, UNKNOWN, state_of};
use voxelastic::geometry::Aabb;
use voxelastic::octree::{BLOCK_SHIFT, NONE, block_coords, voxel_coords};
use voxelastic::query::{Capsule, FieldQuery, MergeOptions, Shape, Sphere, UnknownAs};
use voxelastic_io::store::MapStore;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const COUNT: usize = 20_000;
const RADIUS: f64 = 0.35;
/// Length of the motions, metres.
const MOTION: f64 = 2.0;
/// Size of the box that positions are drawn from and that the dense array covers, metres.
const BOX: [f64; 3] = [60.0, 60.0, 6.0];

/// Seconds on a clock.
fn now(clock: ClockId) -> f64 {
    let t = clock_gettime(clock);
    t.tv_sec as f64 + 1e-9 * t.tv_nsec as f64
}

/// Calls a second.
fn rate(calls: usize, mut work: impl FnMut()) -> f64 {
    let best = (0..3).map(|_| {
        let begun = now(ClockId::ThreadCPUTime);
        work();
        now(ClockId::ThreadCPUTime) - begun
    });
    calls as f64 / best.fold(f64::INFINITY, f64::min)
}

/// Single resolution: one byte for each finest voxel of a box.
struct Dense {
    low: [i32; 3],
    size: [usize; 3],
    values: Vec<i8>,
}

impl Dense {
    fn new(field: &OccupancyField, low: [i32; 3], size: [usize; 3]) -> Self {
        let mut dense = Self { low, size, values: vec![UNKNOWN; size.iter().product()] };
        field.tree().for_each(|key, level, octant| {
            let corner = block_coords(key).map(|c| c << BLOCK_SHIFT);
            if octant.link == NONE {
                dense.fill(corner, 8 << level, octant.payload.value);
            } else if level == 0 {
                let block = field.block(octant.link);
                let scale = usize::from(block.scale);
                for (i, &value) in field.values(block).iter().enumerate() {
                    let c = voxel_coords(i, scale);
                    dense.fill(std::array::from_fn(|k| corner[k] + (c[k] << scale) as i32), 1 << scale, value);
                }
            }
        });
        dense
    }

    fn fill(&mut self, corner: [i32; 3], edge: i32, value: i8) {
        let range = |k: usize| {
            let first = (corner[k] - self.low[k]).clamp(0, self.size[k] as i32) as usize;
            let end = (corner[k] + edge - self.low[k]).clamp(0, self.size[k] as i32) as usize;
            first..end
        };
        let (xs, ys, zs) = (range(0), range(1), range(2));
        for z in zs {
            for y in ys.clone() {
                let row = (z * self.size[1] + y) * self.size[0];
                self.values[row + xs.start..row + xs.end.max(xs.start)].fill(value);
            }
        }
    }

    /// Whether every voxel no farther than the radius from the line is free; visits all of them.
    fn is_free(&self, capsule: &Capsule, per_metre: f64) -> bool {
        let [from, to] = [capsule.from, capsule.to].map(|p| p.map(|c| c * per_metre));
        let radius = capsule.radius * per_metre;
        let low: [i32; 3] = std::array::from_fn(|k| (from[k].min(to[k]) - radius).floor() as i32);
        let high: [i32; 3] = std::array::from_fn(|k| (from[k].max(to[k]) + radius).floor() as i32);
        let line = Line { from, along: std::array::from_fn(|k| to[k] - from[k]) };
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    if self.state([x, y, z]) != State::Free && line.is_near([x, y, z], radius) {
                        return false;
                    }
                }
            }
        }
        true
    }

    fn state(&self, c: [i32; 3]) -> State {
        let at: [i32; 3] = std::array::from_fn(|k| c[k] - self.low[k]);
        if (0..3).any(|k| at[k] < 0 || at[k] as usize >= self.size[k]) {
            return State::Unknown;
        }
        state_of(self.values[at[0] as usize + self.size[0] * (at[1] as usize + self.size[1] * at[2] as usize)])
    }
}

/// A straight motion, in voxels.
struct Line {
    from: [f64; 3],
    along: [f64; 3],
}

impl Line {
    /// Squared distance from the point at `t` (0 to 1) to the voxel.
    fn gap(&self, t: f64, voxel: [i32; 3]) -> f64 {
        let off = |k: usize| {
            let p = self.from[k] + t * self.along[k];
            (f64::from(voxel[k]) - p).max(p - f64::from(voxel[k] + 1)).max(0.0)
        };
        (0..3).map(|k| off(k) * off(k)).sum()
    }

    /// Whether the motion comes within `radius` of the voxel.
    fn is_near(&self, voxel: [i32; 3], radius: f64) -> bool {
        let squared = self.along.iter().map(|c| c * c).sum::<f64>().max(1e-9);
        let middle = voxel.map(|c| f64::from(c) + 0.5);
        let t = ((0..3).map(|k| (middle[k] - self.from[k]) * self.along[k]).sum::<f64>() / squared).clamp(0.0, 1.0);
        let off = (0..3).map(|k| (middle[k] - self.from[k] - t * self.along[k]).powi(2)).sum::<f64>().sqrt();
        if off > radius + 0.5 * 3f64.sqrt() {
            return false;
        }
        // The point nearest to the voxel's centre is usually close enough to the one nearest to the voxel.
        self.gap(t, voxel) <= radius * radius || self.least_gap(voxel) <= radius * radius
    }

    /// Squared distance from the voxel to the nearest point of the motion, by ternary search: the distance is convex along it.
    fn least_gap(&self, voxel: [i32; 3]) -> f64 {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
            if self.gap(a, voxel) <= self.gap(b, voxel) {
                high = b;
            } else {
                low = a;
            }
        }
        self.gap(0.5 * (low + high), voxel)
    }
}

fn main() -> Result<()> {
    let path = std::env::args().nth(1).ok_or("give a map")?;
    let store = MapStore::open(&path)?;
    let voxel: f32 = store.manifest().details.settings.get("voxel_size").ok_or("the map does not say how large its voxels are")?.parse()?;
    let atlas = store.load_atlas()?;
    let submap = atlas.submaps().iter().max_by_key(|s| s.occupancy().len()).ok_or("the map is empty")?;
    let field = submap.query();
    let map = atlas.query().unwrap();

    // Around where the submap's scans were taken.
    let middle = submap.scans().get(submap.scans().len() / 2).map_or([0.0; 3], |s| s.t_submap_lidar.translation.vector.into());
    let low: [f64; 3] = std::array::from_fn(|k| middle[k] - 0.5 * BOX[k]);
    // The array is unknown outside of the box: no motion may leave it.
    let margin = [MOTION + 0.5, MOTION + 0.5, 0.5];
    let mut random = StdRng::seed_from_u64(1);
    let mut places = Vec::new();
    while places.len() < COUNT {
        let p: [f64; 3] = std::array::from_fn(|k| low[k] + random.random_range(margin[k]..BOX[k] - margin[k]));
        if field.state(p) == State::Free {
            places.push(p);
        }
    }
    let spheres: Vec<Shape> = places.iter().map(|p| Sphere { centre: *p, radius: RADIUS }.into()).collect();
    let motions: Vec<Capsule> = places
        .iter()
        .map(|p| {
            let (sin, cos) = random.random_range(0.0..std::f64::consts::TAU).sin_cos();
            Capsule { from: *p, to: [p[0] + MOTION * cos, p[1] + MOTION * sin, p[2]], radius: RADIUS }
        })
        .collect();
    let sweeps: Vec<Shape> = motions.iter().map(|m| (*m).into()).collect();

    let ask = |shapes: &[Shape]| rate(COUNT, || shapes.iter().for_each(|s| _ = black_box(field.is_free(s, UnknownAs::Blocked))));
    let reach = |up_to: f64| rate(COUNT, || places.iter().for_each(|p| _ = black_box(field.clearance(*p, up_to, UnknownAs::Blocked))));
    let in_map: Vec<[f64; 3]> = places.iter().map(|p| (submap.t_map_submap() * nalgebra::Point3::from(*p)).coords.into()).collect();
    let reach_map = |up_to: f64| rate(COUNT, || in_map.iter().for_each(|p| _ = black_box(map.clearance(*p, up_to, UnknownAs::Blocked))));
    let sweeps_map: Vec<Shape> = sweeps.iter().map(|s| s.moved(&submap.t_map_submap())).collect();
    let ask_map = |shapes: &[Shape]| rate(COUNT, || shapes.iter().for_each(|s| _ = black_box(map.is_free(s, UnknownAs::Blocked))));

    let first = low.map(|c| (c / f64::from(voxel)).floor() as i32);
    let dense = Dense::new(submap.occupancy(), first, BOX.map(|c| (c / f64::from(voxel)).ceil() as usize));
    let per_metre = 1.0 / f64::from(voxel);
    let still: Vec<Capsule> = places.iter().map(|p| Capsule { from: *p, to: *p, radius: RADIUS }).collect();
    let scan = |shapes: &[Capsule]| rate(COUNT, || shapes.iter().for_each(|s| _ = black_box(dense.is_free(s, per_metre))));
    let differing = motions.iter().zip(&sweeps).filter(|(m, s)| dense.is_free(m, per_metre) != field.is_free(s, UnknownAs::Blocked)).count();

    // Merged around the positions, as far as the clearance queries reach.
    let merged: serde_json::Map<String, Value> = [1.0, 0.5]
        .into_iter()
        .map(|share| {
            let mut bounds = Aabb::default();
            in_map.iter().for_each(|p| bounds.add(p.map(|c| c as f32)));
            (bounds.min, bounds.max) = (bounds.min.map(|c| c - 2.5), bounds.max.map(|c| c + 2.5));
            let (begun, cpu) = (std::time::Instant::now(), now(ClockId::ProcessCPUTime));
            let whole = map.merge(&MergeOptions { cell: share * voxel, bounds: Some(bounds) });
            let (merge_ms, merge_cpu_ms) = (1e3 * begun.elapsed().as_secs_f64(), 1e3 * (now(ClockId::ProcessCPUTime) - cpu));
            let query = whole.query();
            let reach = |up_to: f64| rate(COUNT, || in_map.iter().for_each(|p| _ = black_box(query.clearance(*p, up_to, UnknownAs::Blocked))));
            let off = |p: &[f64; 3]| map.clearance(*p, 1.0, UnknownAs::Blocked) - query.clearance(*p, 1.0, UnknownAs::Blocked);
            let most = in_map.iter().map(off).fold(f64::NEG_INFINITY, f64::max);
            let moves = rate(COUNT, || sweeps_map.iter().for_each(|s| _ = black_box(query.is_free(s, UnknownAs::Blocked))));
            let found = json!({
                "merge_ms": merge_ms, "merge_cpu_ms": merge_cpu_ms, "mb": whole.bytes() as f64 / 1e6, "motion_2_m": moves, "clearance_up_to_0.5_m": reach(0.5),
                "clearance_up_to_1_m": reach(1.0), "clearance_up_to_2_m": reach(2.0), "less_than_asked_of_all_submaps_at_most_m": most,
            });
            (format!("cells of {share} voxels"), found)
        })
        .collect();

    let summary = json!({
        "submaps": atlas.submaps().len(),
        "one_submap_per_s": { "sphere": ask(&spheres), "motion_2_m": ask(&sweeps), "clearance_up_to_1_m": reach(1.0), "clearance_up_to_2_m": reach(2.0) },
        "whole_map_per_s": { "motion_2_m": ask_map(&sweeps_map), "clearance_up_to_0.5_m": reach_map(0.5), "clearance_up_to_1_m": reach_map(1.0), "clearance_up_to_2_m": reach_map(2.0) },
        "merged_map_per_s": merged,
        "dense_array_per_s": { "sphere": scan(&still), "motion_2_m": scan(&motions) },
        "dense_array_mb": dense.values.len() as f64 / 1e6,
        "submap_mb": submap.occupancy().bytes() as f64 / 1e6,
        "answers_that_differ_from_dense": differing,
        "sphere_ends": ends(&field, &spheres),
        "motion_2_m_ends": ends(&field, &sweeps),
    });
    #[expect(clippy::print_stdout, reason = "the figures are what this program is for")]
    {
        println!("{summary:#}");
    }
    Ok(())
}

/// Levels at which checks end: shares by the edge of the smallest cube visited.
fn ends(field: &FieldQuery<'_>, shapes: &[Shape]) -> Value {
    let mut shares = std::collections::BTreeMap::<u32, f64>::new();
    let (mut octants, mut blocks, mut free) = (0.0, 0.0, 0.0);
    for shape in shapes {
        let (is_free, work) = field.is_free_with_stats(shape, UnknownAs::Blocked);
        *shares.entry(work.smallest).or_default() += 1.0 / shapes.len() as f64;
        octants += f64::from(work.octants) / shapes.len() as f64;
        blocks += f64::from(work.blocks) / shapes.len() as f64;
        free += f64::from(u8::from(is_free)) / shapes.len() as f64;
    }
    let name = |level: &u32| if *level == 0 { "voxels".to_owned() } else { format!("octants of {} voxels", 1u64 << level) };
    let shares: serde_json::Map<String, Value> = shares.iter().map(|(level, share)| (name(level), json!(share))).collect();
    json!({ "free": free, "mean_octants": octants, "mean_blocks": blocks, "smallest_cube_looked_at": shares })
}
