//! How far is it to the nearest thing that stops a robot? Into the octree nearest octants first, past everything that is farther
//! than what was found, or whose maximum says that nothing stops there.

use super::atlas::Part;
use super::field::{blocks, is_clear};
use super::free::{BITS_OF_BYTE, blocking_bytes};
use super::shape::{OrientedBox, moved};
use super::solid::Block;
use super::{AtlasQuery, FieldQuery, UnknownAs};
use crate::field::occupancy::{OccupancyField, Summary, UNKNOWN};
use crate::geometry::Pose;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, block_coords, voxel_coords};

impl FieldQuery<'_> {
    /// Distance from `p` (metres, submap frame) to the nearest voxel that is occupied or, unless it counts as free, unknown,
    /// at the size at which the field holds it; `up_to` metres when there is none nearer, 0 inside of one.
    ///
    /// Space outside of the field is unknown. 0 too for a point that is not finite, or an `up_to` that is not a length.
    pub fn clearance(&self, p: [f64; 3], up_to: f64, unknown: UnknownAs) -> f64 {
        let Some(base) = self.voxel_of(p).filter(|_| up_to > 0.0 && up_to.is_finite()) else {
            // So far out nothing is known.
            let is_far = p.iter().all(|c| c.is_finite()) && up_to > 0.0 && up_to.is_finite();
            return if is_far && unknown == UnknownAs::Free { up_to } else { 0.0 };
        };
        let fraction = std::array::from_fn(|k| (p[k] * self.per_metre - f64::from(base[k])) as f32);
        let reach = up_to * self.per_metre;
        let nearest = match unknown {
            UnknownAs::Blocked => Nearest::<true>::new(self.field, base, fraction, reach as f32).run(),
            UnknownAs::Free => Nearest::<false>::new(self.field, base, fraction, reach as f32).run(),
        };
        nearest.map_or(up_to, |distance| (f64::from(distance) * self.voxel).min(up_to))
    }
}

/// A search around a point. Coordinates of octants are finest voxels; `STRICT`: unknown space stops.
struct Nearest<'a, const STRICT: bool> {
    field: &'a OccupancyField,
    /// The voxel that holds the point, and where in it the point is: differences stay exact far from the origin.
    base: [i32; 3],
    fraction: [f32; 3],
    reach: i32,
    /// Squared distance to the nearest found, or that asked up to.
    best: f32,
    found: bool,
}

impl<'a, const STRICT: bool> Nearest<'a, STRICT> {
    const POLICY: UnknownAs = if STRICT { UnknownAs::Blocked } else { UnknownAs::Free };

    fn new(field: &'a OccupancyField, base: [i32; 3], fraction: [f32; 3], reach: f32) -> Self {
        Self { field, base, fraction, reach: reach.min(1e6) as i32 + 1, best: reach * reach, found: false }
    }

    /// Distance in finest voxels; none when nothing is within reach.
    fn run(mut self) -> Option<f32> {
        let tree = self.field.tree();
        if tree.is_empty() {
            return STRICT.then_some(0.0);
        }
        let (corner, level) = (block_coords(tree.root_key()).map(|c| c << BLOCK_SHIFT), tree.root_level());
        if STRICT {
            self.meet_outside(corner, (BLOCK_EDGE << level) as i32);
        }
        if self.gap(corner, (BLOCK_EDGE << level) as i32) < self.best {
            self.descend(*tree.root(), corner, level);
        }
        self.found.then(|| self.best.sqrt())
    }

    fn meet(&mut self, squared: f32) {
        if squared < self.best {
            (self.best, self.found) = (squared, true);
        }
    }

    /// Beyond the faces of the root cube everything is unknown.
    fn meet_outside(&mut self, corner: [i32; 3], edge: i32) {
        let inside = |k: usize| {
            let from_low = (self.base[k] - corner[k]) as f32 + self.fraction[k];
            from_low.min(edge as f32 - from_low).max(0.0)
        };
        let nearest = inside(0).min(inside(1)).min(inside(2));
        self.meet(nearest * nearest);
    }

    /// Squared distance to the cube.
    #[inline(always)]
    fn gap(&self, corner: [i32; 3], edge: i32) -> f32 {
        let along = |k: usize| {
            let low = (corner[k] - self.base[k]) as f32 - self.fraction[k];
            low.max(-(low + edge as f32)).max(0.0)
        };
        let [x, y, z] = [along(0), along(1), along(2)];
        x * x + y * y + z * z
    }

    /// To the smallest octant that holds all within reach, and everything below it.
    fn descend(&mut self, octant: Octant<Summary>, corner: [i32; 3], level: u32) {
        let (mut octant, mut corner, mut level) = (octant, corner, level);
        while level > 0 && octant.link != NONE && !is_clear(&octant.payload, Self::POLICY) {
            let half = (BLOCK_EDGE << level) as i32 / 2;
            let side: [i32; 3] = std::array::from_fn(|k| i32::from(self.base[k] >= corner[k] + half));
            let child: [i32; 3] = std::array::from_fn(|k| corner[k] + side[k] * half);
            let holds_all = (0..3).all(|k| self.base[k] - self.reach >= child[k] && self.base[k] + self.reach < child[k] + half);
            if !holds_all {
                break;
            }
            octant = self.field.tree().siblings(octant.link)[(side[0] | side[1] << 1 | side[2] << 2) as usize];
            (corner, level) = (child, level - 1);
        }
        self.visit(octant, corner, level);
    }

    /// Looks into an octant that is nearer than the best.
    fn visit(&mut self, octant: Octant<Summary>, corner: [i32; 3], level: u32) {
        if is_clear(&octant.payload, Self::POLICY) {
            return;
        }
        // Uniform, or unknown all through.
        if octant.link == NONE || (STRICT && octant.payload.max == UNKNOWN) {
            return self.meet(self.gap(corner, (BLOCK_EDGE << level) as i32));
        }
        if level == 0 {
            return self.visit_block(octant.link, corner);
        }
        let half = (BLOCK_EDGE << level) as i32 / 2;
        let siblings = self.field.tree().siblings(octant.link);
        let near = (0..3).fold(0, |bits, k| bits | usize::from(self.base[k] >= corner[k] + half) << k);
        for turn in [0, 1, 2, 4, 3, 5, 6, 7] {
            let child = near ^ turn;
            if is_clear(&siblings[child].payload, Self::POLICY) {
                continue;
            }
            let at = std::array::from_fn(|k| corner[k] + if child >> k & 1 == 1 { half } else { 0 });
            if self.gap(at, half) < self.best {
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
            self.meet(self.gap(std::array::from_fn(|k| corner[k] + (c[k] << scale) as i32), 1 << scale));
        }
    }

    /// Rows of eight voxels at a time, the nearest on either side in each; the layer and the row beside the point first, so that most
    /// others are too far by then.
    fn visit_rows(&mut self, values: &[i8], corner: [i32; 3]) {
        let place: [f32; 3] = std::array::from_fn(|k| (self.base[k] - corner[k]) as f32 + self.fraction[k]);
        let off = |voxel: usize, at: f32| (voxel as f32 - at).max(at - (voxel + 1) as f32).max(0.0);
        let aside: [[f32; BLOCK_EDGE]; 2] = [1, 2].map(|k| std::array::from_fn(|i| off(i, place[k]).powi(2)));
        let nearest = |k: usize| (self.base[k] - corner[k]).clamp(0, BLOCK_EDGE as i32 - 1) as usize;
        let [y_first, z_first] = [nearest(1), nearest(2)];
        let column = (self.base[0] - corner[0]).clamp(0, BLOCK_EDGE as i32);
        // The voxels below the point's own along x.
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
                let stopping = blocking_bytes::<STRICT>(u64::from_le_bytes(rows[y + BLOCK_EDGE * z].map(|v| v as u8)));
                let (low, high) = (stopping & before, stopping & !before);
                if low != 0 {
                    let dx = off(((u64::BITS - 1 - low.leading_zeros()) / BITS_OF_BYTE) as usize, place[0]);
                    self.meet(dx * dx + aside);
                }
                if high != 0 {
                    let dx = off((high.trailing_zeros() / BITS_OF_BYTE) as usize, place[0]);
                    self.meet(dx * dx + aside);
                }
            }
        }
    }
}

/// The indices of a block's edge from `first` outwards: up to the end, then down.
#[inline(always)]
fn outwards(first: usize) -> impl Iterator<Item = usize> {
    (first..BLOCK_EDGE).chain((0..first).rev())
}

impl AtlasQuery<'_> {
    /// Distance from `p` (metres, map frame) to the nearest space that is occupied or, unless it counts as free, unknown;
    /// `up_to` metres when there is none nearer, 0 inside of it.
    ///
    /// Where one submap knows all around, this is exact to rounding. Where submaps have to complete each other, the rest
    /// is taken in cubes of the finest voxel's size, as [`is_free`](Self::is_free) does, and what is returned is too small by no more than
    /// such a cube's diagonal. A sphere of a radius below the clearance is free.
    pub fn clearance(&self, p: [f64; 3], up_to: f64, unknown: UnknownAs) -> f64 {
        if !(p.iter().all(|c| c.is_finite()) && up_to > 0.0 && up_to.is_finite()) {
            return 0.0;
        }
        let mut best = up_to;
        let place = |part: &Part<'_>| moved(&part.t_submap_map, p);
        let reaches = |part: &Part<'_>, local: [f64; 3], by: f64| part.reaches(local.map(|c| c - by), local.map(|c| c + by));
        let mut near = self.parts.iter().map(|part| (part, place(part))).filter(|(part, local)| reaches(part, *local, up_to));
        if unknown == UnknownAs::Free {
            near.for_each(|(part, local)| best = part.query.clearance(local, best, unknown));
            return best;
        }
        let Some((first, local)) = near.next() else { return 0.0 };
        let Some(second) = near.next() else { return first.query.clearance(local, up_to, unknown) };
        let near: Vec<(&Part<'_>, [f64; 3])> = [(first, local), second].into_iter().chain(near).collect();
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
        // The search below is no better than this.
        if best - known <= 3f64.sqrt() * self.voxel() {
            return known;
        }
        let parts: Vec<&Part<'_>> = near.iter().map(|(part, _)| *part).collect();
        let mut search = Uncovered { parts: &parts, p, voxel: self.voxel(), known, best };
        search.run();
        search.best
    }
}

/// A search for the nearest cube of the map frame that no submap knows to be free.
struct Uncovered<'a, 'b> {
    parts: &'a [&'a Part<'b>],
    p: [f64; 3],
    voxel: f64,
    /// All within this distance is known to be free.
    known: f64,
    best: f64,
}

impl Uncovered<'_, '_> {
    fn run(&mut self) {
        let levels = (2.0 * self.best / self.voxel).max(1.0).log2().ceil().min(30.0) as u32;
        let edge = self.voxel * f64::from(1u32 << levels);
        let first = self.p.map(|c| ((c - self.best) / edge).floor() * edge);
        for corner in 0..8 {
            self.visit(std::array::from_fn(|k| first[k] + if corner >> k & 1 == 1 { edge } else { 0.0 }), edge, levels);
        }
    }

    fn visit(&mut self, low: [f64; 3], edge: f64, level: u32) {
        let off = |k: usize| (low[k] - self.p[k]).max(self.p[k] - low[k] - edge).max(0.0);
        let gap = (0..3).map(|k| off(k).powi(2)).sum::<f64>().sqrt();
        let farthest = (0..3).map(|k| (self.p[k] - low[k]).abs().max((self.p[k] - low[k] - edge).abs()).powi(2)).sum::<f64>().sqrt();
        // A cube that reaches what ends the known space touches it, and what touches is not covered.
        let is_within = farthest + 1e-3 * self.voxel <= self.known;
        if gap >= self.best || is_within || self.is_covered(low, edge) {
            return;
        }
        if level == 0 {
            self.best = gap;
            return;
        }
        let half = 0.5 * edge;
        let near = (0..3).fold(0, |bits, k| bits | usize::from(self.p[k] >= low[k] + half) << k);
        for turn in [0, 1, 2, 4, 3, 5, 6, 7] {
            let child = near ^ turn;
            self.visit(std::array::from_fn(|k| low[k] + if child >> k & 1 == 1 { half } else { 0.0 }), half, level - 1);
        }
    }

    /// Whether some submap knows all of the cube to be free.
    fn is_covered(&self, low: [f64; 3], edge: f64) -> bool {
        let middle = low.map(|c| c + 0.5 * edge);
        let t_map_cube = Pose::translation(middle[0], middle[1], middle[2]);
        self.parts.iter().any(|part| {
            let cube = OrientedBox { t_frame_box: part.t_submap_map * t_map_cube, half: [0.5 * edge; 3] };
            part.query.is_clear_of(&Block::new(&cube, part.query.per_metre), UnknownAs::Blocked)
        })
    }
}
