//! The robot's own space: where the sensor stood there is room for the robot, although no ray observes it. Sensors measure nothing nearer than their least
//! range, and nothing above and below their field of view.
//!
//! Space within a radius of the sensor, and not too far along its axis, counts as observed once as free, unless it was observed: occupied space stays occupied, and so does what it hides from
//! the sensor, because nobody knows what is behind it.

use super::evidence::Steps;
use crate::field::occupancy::propagate::ChangedOctants;
use crate::field::occupancy::{FlipKind, OccupancyField, Summary, UNKNOWN};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, NONE, Octant, block_key, voxel_coords, voxel_index, voxels_at};

/// More cells than this between the sensor and the end of its own space are made larger.
const MAX_CELLS: f32 = 16.0;
/// Something in the cell is occupied.
const OCCUPIED: u8 = 1;
/// Something in the cell is not known to be free.
const OPEN: u8 = 2;

/// The own space of a sensor: finest voxels, submap frame.
pub(super) struct OwnSpace {
    /// Where it stands.
    pub sensor: [f32; 3],
    /// Its z axis.
    pub axis: [f32; 3],
    pub radius: f32,
    /// How far the space reaches along the axis, to both sides.
    pub height: f32,
}

/// Frees the own space of a sensor. Adds the octants that it changes to `changed`. The root of the tree must cover the space.
pub(super) fn free_own_space(field: &mut OccupancyField, own: &OwnSpace, steps: &Steps, changed: &mut ChangedOctants) {
    let scale = (0..3).find(|scale| own.radius <= MAX_CELLS * (1 << scale) as f32).unwrap_or(3);
    let cells = CellGrid::around(field, own, scale, steps.free);
    let edge = (BLOCK_EDGE >> scale) as i32;
    let mut cursor = Cursor::new(&field.tree);
    for block in cells.blocks(scale) {
        let is_to_free = |i: usize| {
            let local = voxel_coords(i, scale);
            cells.is_to_free(std::array::from_fn(|k| block[k] * edge + local[k] as i32))
        };
        let free: Vec<bool> = (0..voxels_at(scale)).map(is_to_free).collect();
        if free.contains(&true) {
            free_cells_of_block(field, &mut cursor, block_key(block), (scale, &free), steps.free);
            changed.add(block_key(block), 0);
            changed.add_flip(block_key(block), 0, FlipKind { occupied: false, free: true });
        }
    }
}

/// Frees the cells of one block that are marked in `free`, in the order of voxels of `scale`.
fn free_cells_of_block(field: &mut OccupancyField, cursor: &mut Cursor, key: u64, (scale, free): (usize, &[bool]), value: i8) {
    let (group, index) = cursor.find_or_create(&mut field.tree, key);
    let id = field.find_or_create_in((group, index), key, scale);
    let block = *field.block(id);
    let own = usize::from(block.scale);
    let (mut low, mut high) = (i8::MAX, i8::MIN);
    for (i, voxel) in field.voxels.get_mut(own, block.slot).iter_mut().enumerate() {
        // The block may hold finer voxels than cells.
        let cell = voxel_coords(i, own).map(|c| c >> (scale - own));
        if free[voxel_index(cell, scale)] && !is_free(*voxel, value) {
            *voxel = value;
        }
        (low, high) = (low.min(*voxel), high.max(*voxel));
    }
    let uniform = low == high;
    let payload = if uniform { Summary::uniform(low) } else { Summary { value: UNKNOWN, max: high, observed: low != UNKNOWN } };
    field.tree.siblings_mut(group)[index] = Octant { link: if uniform { NONE } else { id }, payload };
    if uniform {
        field.remove(id);
    }
}

/// Whether a voxel is at least as free as after one observation.
fn is_free(voxel: i8, once: i8) -> bool {
    voxel != UNKNOWN && voxel <= once
}

/// The cells in a cube around the sensor: cubes of 2^scale finest voxels.
struct CellGrid {
    /// Coordinates of the first cell.
    low: [i32; 3],
    /// Cells along an edge of the cube.
    size: i32,
    /// Position and axis of the sensor, radius and height of the space, cells.
    sensor: [f64; 3],
    axis: [f64; 3],
    radius: f64,
    height: f64,
    flags: Vec<u8>,
}

impl CellGrid {
    fn around(field: &OccupancyField, own: &OwnSpace, scale: usize, once: i8) -> Self {
        let cell = f64::from(1u32 << scale);
        let [radius, height] = [own.radius, own.height].map(|length| f64::from(length) / cell);
        let (sensor, axis) = (own.sensor.map(|c| f64::from(c) / cell), own.axis.map(f64::from));
        let low = sensor.map(|c| (c - radius).floor() as i32);
        let size = (2.0 * radius).ceil() as i32 + 1;
        let mut grid = Self { low, size, sensor, axis, radius, height, flags: vec![0; (size as usize).pow(3)] };
        grid.read(field, scale, once);
        grid
    }

    /// Sets the flags of all cells.
    fn read(&mut self, field: &OccupancyField, scale: usize, once: i8) {
        let edge = (BLOCK_EDGE >> scale) as i32;
        for at in self.blocks(scale).collect::<Vec<_>>() {
            let corner = at.map(|c| c * edge);
            let Some((_, octant)) = field.tree.find(block_key(at)) else { continue };
            if octant.link == NONE {
                let flag = flag_of(octant.payload.value, once);
                (0..voxels_at(scale)).for_each(|i| self.flag(corner, voxel_coords(i, scale), flag));
                continue;
            }
            let block = field.block(octant.link);
            for (i, &value) in field.values(block).iter().enumerate() {
                self.flag_voxel(corner, (voxel_coords(i, block.scale.into()), block.scale.into()), scale, flag_of(value, once));
            }
        }
    }

    /// The blocks that the grid reaches into.
    fn blocks(&self, scale: usize) -> impl Iterator<Item = [i32; 3]> + use<> {
        let shift = BLOCK_SHIFT as usize - scale;
        let [xs, ys, zs] = self.low.map(|low| low >> shift..=(low + self.size - 1) >> shift);
        zs.flat_map(move |z| ys.clone().map(move |y| (y, z))).flat_map(move |(y, z)| xs.clone().map(move |x| [x, y, z]))
    }

    /// Sets a flag of the cells that share space with a voxel of a block, given by its coordinates and scale; `corner` is the block's first cell.
    fn flag_voxel(&mut self, corner: [i32; 3], (voxel, own): ([usize; 3], usize), scale: usize, flag: u8) {
        if own <= scale {
            return self.flag(corner, voxel.map(|c| c >> (scale - own)), flag);
        }
        let cells = 1usize << (own - scale);
        for j in 0..cells.pow(3) {
            let within = [j % cells, j / cells % cells, j / cells / cells];
            self.flag(corner, std::array::from_fn(|k| voxel[k] * cells + within[k]), flag);
        }
    }

    fn flag(&mut self, corner: [i32; 3], local: [usize; 3], flag: u8) {
        if let Some(index) = self.index(std::array::from_fn(|k| corner[k] + local[k] as i32)) {
            self.flags[index] |= flag;
        }
    }

    fn index(&self, c: [i32; 3]) -> Option<usize> {
        let local: [i32; 3] = std::array::from_fn(|k| c[k] - self.low[k]);
        let is_in = local.iter().all(|v| (0..self.size).contains(v));
        is_in.then(|| local.iter().rev().fold(0, |index, v| index * self.size as usize + *v as usize))
    }

    /// Whether cell `c` is within the own space, not known to be free, and seen from the sensor.
    fn is_to_free(&self, c: [i32; 3]) -> bool {
        let Some(index) = self.index(c) else { return false };
        let off: [f64; 3] = std::array::from_fn(|k| f64::from(c[k]) + 0.5 - self.sensor[k]);
        let dot = |other: [f64; 3]| -> f64 { (0..3).map(|k| off[k] * other[k]).sum() };
        let is_in = dot(off) <= self.radius * self.radius && dot(self.axis).abs() <= self.height;
        self.flags[index] == OPEN && is_in && self.is_seen(c)
    }

    /// Whether no occupied cell is on the straight line from the sensor to the centre of cell `to`; the sensor's own cell does not count.
    fn is_seen(&self, to: [i32; 3]) -> bool {
        let mut cell = self.sensor.map(|c| c.floor() as i32);
        let ray: [f64; 3] = std::array::from_fn(|k| f64::from(to[k]) + 0.5 - self.sensor[k]);
        let mut next: [f64; 3] = std::array::from_fn(|k| {
            let face = f64::from(cell[k] + i32::from(ray[k] > 0.0));
            (face - self.sensor[k]) / ray[k]
        });
        while cell != to {
            // Only axes along which the cell is not reached yet, so that rounding cannot lead past it.
            let Some(axis) = (0..3).filter(|&k| cell[k] != to[k]).min_by(|&a, &b| next[a].total_cmp(&next[b])) else { return true };
            cell[axis] += (to[axis] - cell[axis]).signum();
            next[axis] += 1.0 / ray[axis].abs();
            if self.index(cell).is_some_and(|index| self.flags[index] & OCCUPIED != 0) {
                return false;
            }
        }
        true
    }
}

fn flag_of(value: i8, once: i8) -> u8 {
    match value {
        UNKNOWN => OPEN,
        v if v > 0 => OCCUPIED,
        v if is_free(v, once) => 0,
        _ => OPEN,
    }
}
