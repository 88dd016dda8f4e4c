//! A block moves between scales: what it was told at one goes over to the next (paper Sec. III-A, propagation).

use super::formation::{Run, Update};
use super::scale::ScaleRule;
use crate::field::tsdf::propagate::{children, propagate_delta_down, propagate_down, propagate_up};
use crate::field::tsdf::{Array, Block, Touched, Voxel};
use crate::octree::voxels_at;

/// How a block moves between scales in a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Change {
    None,
    Coarser,
    /// To an array that was there before.
    Finer,
    /// To a new array.
    FinerNew,
}

/// Decides whether `block`, `distance` metres from the sensor, changes scale.
pub(super) fn scale_change(block: &Block, rule: &ScaleRule, distance: f32) -> Change {
    let (current, finest) = (usize::from(block.scale), usize::from(block.finest));
    match rule.next(current, distance) {
        next if next > current => Change::Coarser,
        next if next == current => Change::None,
        next if next < finest => Change::FinerNew,
        _ => Change::Finer,
    }
}

impl Update<'_> {
    /// Fills the array of a block's new scale from the one that it leaves (paper Sec. III-A, propagation).
    #[allow(unsafe_code)]
    #[cold]
    #[inline(never)]
    pub(super) fn change_scale(&self, run: &Run, touched: &mut Touched) {
        // SAFETY: here and below, this block occurs in one run only, so in one thread only.
        let block = unsafe { self.field.block(run.block).get() };
        let scale = usize::from(block.scale);
        let [mut new, mut from, mut past] = [[Voxel::default(); voxels_at(0)]; 3];
        let new = &mut new[..voxels_at(scale)];
        let mut guessed = 0;
        let guesses = self.band.guesses();
        let copy = |array: Array, into: &mut [Voxel; voxels_at(0)]| {
            // SAFETY: as above.
            unsafe { self.field.copy(block, array, &mut into[..voxels_at(array.scale())]) };
        };
        match run.change {
            Change::None => return,
            Change::Coarser => {
                copy(Array::Data(scale - 1), &mut from);
                guessed = propagate_up(&from[..voxels_at(scale - 1)], new, scale - 1);
            }
            Change::Finer => {
                copy(Array::Data(scale + 1), &mut from);
                copy(Array::Past(scale + 1), &mut past);
                // SAFETY: as above.
                unsafe { self.field.copy(block, Array::Data(scale), new) };
                let coarse = ..voxels_at(scale + 1);
                propagate_delta_down(&from[coarse], &past[coarse], new, scale, self.band.max_weight as u16, &guesses);
            }
            Change::FinerNew => {
                copy(Array::Data(scale + 1), &mut from);
                propagate_down(&from[..voxels_at(scale + 1)], new, scale, &guesses);
            }
        }
        let mut shades = [0; voxels_at(0)];
        let shades = &mut shades[..voxels_at(scale)];
        if block.shaded {
            self.change_shades(block, run.change, shades);
        }
        // SAFETY: as above.
        unsafe {
            self.field.store(block, run.block, Array::Data(scale), (new, shades), touched);
            if run.change == Change::Coarser {
                // What a guess turns out to be is nothing that finer voxels could learn from.
                (0..new.len()).filter(|i| guessed >> i & 1 == 1).for_each(|i| new[i] = Voxel::default());
                shades.fill(0);
                self.field.store(block, run.block, Array::Past(scale), (new, shades), touched);
            }
        }
    }

    /// Intensities move between scales by plain copy and mean of what is known.
    #[allow(unsafe_code)]
    fn change_shades(&self, block: &Block, change: Change, shades: &mut [u8]) {
        let scale = usize::from(block.scale);
        let mut from = [0; voxels_at(0)];
        let copy = |scale: usize, into: &mut [u8]| {
            // SAFETY: as in `change_scale`.
            unsafe { self.field.copy_shades(block, scale, into) };
        };
        match change {
            Change::Coarser => {
                copy(scale - 1, &mut from[..voxels_at(scale - 1)]);
                for (i, shade) in shades.iter_mut().enumerate() {
                    let known = || children(i, scale - 1).map(|c| u32::from(from[c])).filter(|&s| s > 0);
                    *shade = (known().sum::<u32>() / known().count().max(1) as u32) as u8;
                }
            }
            Change::FinerNew => {
                copy(scale + 1, &mut from[..voxels_at(scale + 1)]);
                for (i, &shade) in from[..voxels_at(scale + 1)].iter().enumerate() {
                    children(i, scale).for_each(|c| shades[c] = shade);
                }
            }
            Change::None | Change::Finer => copy(scale, shades),
        }
    }
}
