//! Distance to the nearest obstacle. Descends the octree nearest octants first and skips octants that are farther than the nearest obstacle
//! found so far, or whose maximum is free.

use super::atlas::PlacedField;
use super::collision::{BITS_OF_BYTE, blocking_bytes};
use super::field::{blocks, is_clear};
use super::shape::{OrientedBox, moved};
use super::shape_sdf::BoxSolid;
use super::{AtlasQuery, FieldQuery, UnknownAs};
use crate::field::occupancy::{OccupancyField, Summary, UNKNOWN};
use crate::geometry::Pose;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, block_coords, voxel_coords};

impl FieldQuery<'_> {
    /// Distance in metres from `p` (submap frame) to the nearest voxel that is occupied or, unless it counts as free, unknown, at the size
    /// at which the field holds it; 0 within such a voxel, `up_to` if there is none nearer.
    ///
    /// Space outside of the field is unknown. Also 0 if `p` is not finite or `up_to` is not a finite positive length.
    pub fn clearance(&self, p: [f64; 3], up_to: f64, unknown: UnknownAs) -> f64 {
        let Some(base) = self.voxel_of(p).filter(|_| up_to > 0.0 && up_to.is_finite()) else {
            // Beyond the largest coordinates all space is unknown.
            let is_far = p.iter().all(|c| c.is_finite()) && up_to > 0.0 && up_to.is_finite();
            return if is_far && unknown == UnknownAs::Free { up_to } else { 0.0 };
        };
        let fraction = std::array::from_fn(|k| (p[k] * self.per_metre - f64::from(base[k])) as f32);
        let reach = up_to * self.per_metre;
        let nearest = match unknown {
            UnknownAs::Blocked => NearestSearch::<true>::new(self.field, base, fraction, reach as f32).run(),
            UnknownAs::Free => NearestSearch::<false>::new(self.field, base, fraction, reach as f32).run(),
        };
        nearest.map_or(up_to, |distance| (f64::from(distance) * self.voxel).min(up_to))
    }
}

/// A search around a point. Coordinates of octants are finest voxels; `STRICT`: unknown space is an obstacle.
struct NearestSearch<'a, const STRICT: bool> {
    field: &'a OccupancyField,
    /// The voxel that contains the point, and the position in it: differences are exact far from the origin.
    base: [i32; 3],
    fraction: [f32; 3],
    reach: i32,
    /// Squared distance to the nearest obstacle found, at first that of the limit.
    best: f32,
    found: bool,
}

impl<'a, const STRICT: bool> NearestSearch<'a, STRICT> {
    const POLICY: UnknownAs = if STRICT { UnknownAs::Blocked } else { UnknownAs::Free };

    fn new(field: &'a OccupancyField, base: [i32; 3], fraction: [f32; 3], reach: f32) -> Self {
        Self { field, base, fraction, reach: reach.min(1e6) as i32 + 1, best: reach * reach, found: false }
    }

    /// Distance in finest voxels; none if there is no obstacle within reach.
    fn run(mut self) -> Option<f32> {
        let tree = self.field.tree();
        if tree.is_empty() {
            return STRICT.then_some(0.0);
        }
        let (corner, level) = (block_coords(tree.root_key()).map(|c| c << BLOCK_SHIFT), tree.root_level());
        if STRICT {
            self.add_outside(corner, (BLOCK_EDGE << level) as i32);
        }
        if self.squared_distance(corner, (BLOCK_EDGE << level) as i32) < self.best {
            self.descend(*tree.root(), corner, level);
        }
        self.found.then(|| self.best.sqrt())
    }

    fn add(&mut self, squared: f32) {
        if squared < self.best {
            (self.best, self.found) = (squared, true);
        }
    }

    /// Adds the unknown space outside of the root cube.
    fn add_outside(&mut self, corner: [i32; 3], edge: i32) {
        let inside = |k: usize| {
            let from_low = (self.base[k] - corner[k]) as f32 + self.fraction[k];
            from_low.min(edge as f32 - from_low).max(0.0)
        };
        let nearest = inside(0).min(inside(1)).min(inside(2));
        self.add(nearest * nearest);
    }

    /// Squared distance to the cube.
    #[inline(always)]
    fn squared_distance(&self, corner: [i32; 3], edge: i32) -> f32 {
        let along = |k: usize| {
            let low = (corner[k] - self.base[k]) as f32 - self.fraction[k];
            low.max(-(low + edge as f32)).max(0.0)
        };
        let [x, y, z] = [along(0), along(1), along(2)];
        x * x + y * y + z * z
    }

    /// Searches the smallest octant that contains everything within reach.
    fn descend(&mut self, octant: Octant<Summary>, corner: [i32; 3], level: u32) {
        let (mut octant, mut corner, mut level) = (octant, corner, level);
        while level > 0 && octant.link != NONE && !is_clear(&octant.payload, Self::POLICY) {
            let half = (BLOCK_EDGE << level) as i32 / 2;
            let side: [i32; 3] = std::array::from_fn(|k| i32::from(self.base[k] >= corner[k] + half));
            let child: [i32; 3] = std::array::from_fn(|k| corner[k] + side[k] * half);
            let contains_all = (0..3).all(|k| self.base[k] - self.reach >= child[k] && self.base[k] + self.reach < child[k] + half);
            if !contains_all {
                break;
            }
            octant = self.field.tree().siblings(octant.link)[(side[0] | side[1] << 1 | side[2] << 2) as usize];
            (corner, level) = (child, level - 1);
        }
        self.visit(octant, corner, level);
    }

    /// Searches an octant that is nearer than the best.
    fn visit(&mut self, octant: Octant<Summary>, corner: [i32; 3], level: u32) {
        if is_clear(&octant.payload, Self::POLICY) {
            return;
        }
        // Uniform, or all unknown.
        if octant.link == NONE || (STRICT && octant.payload.max == UNKNOWN) {
            return self.add(self.squared_distance(corner, (BLOCK_EDGE << level) as i32));
        }
        if level == 0 {
            return self.visit_block(octant.link, corner);
        }
        let half = (BLOCK_EDGE << level) as i32 / 2;
        let siblings = self.field.tree().siblings(octant.link);
        let near = (0..3).fold(0, |bits, k| bits | usize::from(self.base[k] >= corner[k] + half) << k);
        for flip in [0, 1, 2, 4, 3, 5, 6, 7] {
            let child = near ^ flip;
            if is_clear(&siblings[child].payload, Self::POLICY) {
                continue;
            }
            let at = std::array::from_fn(|k| corner[k] + if child >> k & 1 == 1 { half } else { 0 });
            if self.squared_distance(at, half) < self.best {
                self.visit(siblings[child], at, level - 1);
            }
        }
    }

    fn visit_block(&mut self, id: u32, corner: [i32; 3]) {
        let block = self.field.block(id);
        let (values, scale) = (self.field.values(block), usize::from(block.scale));
        if scale == 0 {
            return self.visit_rows(values, corner);
        }
        for (i, _) in values.iter().enumerate().filter(|(_, v)| blocks(**v, Self::POLICY)) {
            let c = voxel_coords(i, scale);
            self.add(self.squared_distance(std::array::from_fn(|k| corner[k] + (c[k] << scale) as i32), 1 << scale));
        }
    }

    /// Searches rows of eight voxels: in each the nearest obstacle on either side. Starts with the nearest layer and row, so that most others
    /// are too far.
    fn visit_rows(&mut self, values: &[i8], corner: [i32; 3]) {
        let local: [f32; 3] = std::array::from_fn(|k| (self.base[k] - corner[k]) as f32 + self.fraction[k]);
        let distance = |voxel: usize, at: f32| (voxel as f32 - at).max(at - (voxel + 1) as f32).max(0.0);
        let aside: [[f32; BLOCK_EDGE]; 2] = [1, 2].map(|k| std::array::from_fn(|i| distance(i, local[k]).powi(2)));
        let nearest = |k: usize| (self.base[k] - corner[k]).clamp(0, BLOCK_EDGE as i32 - 1) as usize;
        let [y_first, z_first] = [nearest(1), nearest(2)];
        let column = (self.base[0] - corner[0]).clamp(0, BLOCK_EDGE as i32);
        // The voxels before the point's own along x.
        let before = if column == 0 { 0 } else { u64::MAX >> (u64::BITS - BITS_OF_BYTE * column as u32) };
        let rows = values.as_chunks::<BLOCK_EDGE>().0;
        for z in outwards(z_first) {
            if aside[1][z] >= self.best {
                continue;
            }
            for y in outwards(y_first) {
                let aside = aside[0][y] + aside[1][z];
                if aside >= self.best {
                    continue;
                }
                let blocking = blocking_bytes::<STRICT>(u64::from_le_bytes(rows[y + BLOCK_EDGE * z].map(|v| v as u8)));
                let (low, high) = (blocking & before, blocking & !before);
                if low != 0 {
                    let dx = distance(((u64::BITS - 1 - low.leading_zeros()) / BITS_OF_BYTE) as usize, local[0]);
                    self.add(dx * dx + aside);
                }
                if high != 0 {
                    let dx = distance((high.trailing_zeros() / BITS_OF_BYTE) as usize, local[0]);
                    self.add(dx * dx + aside);
                }
            }
        }
    }
}

/// Indices along a block's edge from `first` to the end, then from `first` down to 0.
#[inline(always)]
fn outwards(first: usize) -> impl Iterator<Item = usize> {
    (first..BLOCK_EDGE).chain((0..first).rev())
}

impl AtlasQuery<'_> {
    /// Distance in metres from `p` (map frame) to the nearest space that is occupied or, unless it counts as free, unknown; 0 within such
    /// space, `up_to` if there is none nearer.
    ///
    /// Exact to rounding if one submap has observed all of the surroundings. Where the free spaces of submaps complete each other, space is
    /// divided into cubes of the finest voxel's size as in [`is_free`](Self::is_free), and the result is too small by at most such a cube's
    /// diagonal. A sphere with a radius below the clearance is free.
    pub fn clearance(&self, p: [f64; 3], up_to: f64, unknown: UnknownAs) -> f64 {
        if !(p.iter().all(|c| c.is_finite()) && up_to > 0.0 && up_to.is_finite()) {
            return 0.0;
        }
        let mut best = up_to;
        let local = |part: &PlacedField<'_>| moved(&part.t_submap_map, p);
        let reaches = |part: &PlacedField<'_>, local: [f64; 3], by: f64| part.reaches(local.map(|c| c - by), local.map(|c| c + by));
        let mut near = self.parts.iter().map(|part| (part, local(part))).filter(|(part, local)| reaches(part, *local, up_to));
        if unknown == UnknownAs::Free {
            near.for_each(|(part, local)| best = part.query.clearance(local, best, unknown));
            return best;
        }
        let Some((first, local)) = near.next() else { return 0.0 };
        let Some(second) = near.next() else { return first.query.clearance(local, up_to, unknown) };
        let near: Vec<(&PlacedField<'_>, [f64; 3])> = [(first, local), second].into_iter().chain(near).collect();
        for (part, local) in &near {
            best = part.query.clearance(*local, best, UnknownAs::Free);
        }
        let mut known = 0.0f64;
        for (part, local) in &near {
            known = known.max(part.query.clearance(*local, best, UnknownAs::Blocked));
            if known >= best {
                return best;
            }
        }
        // The search below is not more precise.
        if best - known <= 3f64.sqrt() * self.voxel_size() {
            return known;
        }
        let parts: Vec<&PlacedField<'_>> = near.iter().map(|(part, _)| *part).collect();
        let mut search = UncoveredSearch { parts: &parts, p, voxel_size: self.voxel_size(), known, best };
        search.run();
        search.best
    }
}

/// A search for the nearest cube of the map frame that is free in no submap.
struct UncoveredSearch<'a, 'b> {
    parts: &'a [&'a PlacedField<'b>],
    p: [f64; 3],
    voxel_size: f64,
    /// Everything within this distance is free.
    known: f64,
    best: f64,
}

impl UncoveredSearch<'_, '_> {
    fn run(&mut self) {
        let levels = (2.0 * self.best / self.voxel_size).max(1.0).log2().ceil().min(30.0) as u32;
        let edge = self.voxel_size * f64::from(1u32 << levels);
        let first = self.p.map(|c| ((c - self.best) / edge).floor() * edge);
        for corner in 0..8 {
            self.visit(std::array::from_fn(|k| first[k] + if corner >> k & 1 == 1 { edge } else { 0.0 }), edge, levels);
        }
    }

    fn visit(&mut self, low: [f64; 3], edge: f64, level: u32) {
        let off = |k: usize| (low[k] - self.p[k]).max(self.p[k] - low[k] - edge).max(0.0);
        let gap = (0..3).map(|k| off(k).powi(2)).sum::<f64>().sqrt();
        let farthest = (0..3).map(|k| (self.p[k] - low[k]).abs().max((self.p[k] - low[k] - edge).abs()).powi(2)).sum::<f64>().sqrt();
        // A cube that reaches the end of the free space touches it and is not covered.
        let is_within = farthest + 1e-3 * self.voxel_size <= self.known;
        if gap >= self.best || is_within || self.is_covered(low, edge) {
            return;
        }
        if level == 0 {
            self.best = gap;
            return;
        }
        let half = 0.5 * edge;
        let near = (0..3).fold(0, |bits, k| bits | usize::from(self.p[k] >= low[k] + half) << k);
        for flip in [0, 1, 2, 4, 3, 5, 6, 7] {
            let child = near ^ flip;
            self.visit(std::array::from_fn(|k| low[k] + if child >> k & 1 == 1 { half } else { 0.0 }), half, level - 1);
        }
    }

    /// Whether all of the cube is free in some submap.
    fn is_covered(&self, low: [f64; 3], edge: f64) -> bool {
        let middle = low.map(|c| c + 0.5 * edge);
        let t_map_cube = Pose::translation(middle[0], middle[1], middle[2]);
        self.parts.iter().any(|part| {
            let cube = OrientedBox { t_frame_box: part.t_submap_map * t_map_cube, half: [0.5 * edge; 3] };
            part.query.is_clear_of(&BoxSolid::new(&cube, part.query.per_metre), UnknownAs::Blocked)
        })
    }
}
