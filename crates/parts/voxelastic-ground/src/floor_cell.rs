//! What is known of the floor of a cell.

/// How the height of a cell's floor is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Known {
    /// Not at all.
    No,
    /// The floor was seen near by on one side only: good enough to say what an obstacle is, and not that there is a floor.
    Beyond,
    /// It was seen on two opposite sides.
    Between,
    /// It was seen.
    Seen,
}

/// The floor of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloorCell {
    /// Height in the map frame, metres; NaN where it is not known.
    pub height: f32,
    /// Standard deviation of that, metres.
    pub sigma: f32,
    /// Upper end of the voxels of the floor, metres: above the height, by what a voxel does not resolve.
    pub top: f32,
    /// From the top to what is occupied above, metres.
    pub headroom: f32,
    /// How it is known.
    pub known: Known,
    /// How much of what the robot climbs the floor takes: its largest fall within an eighth of a metre as a share of the robot's step, or its slope as a share of the robot's,
    /// whichever is more; beyond 1 it cannot go there.
    pub difficulty: f32,
    /// How far from the last floor that was seen it is, along cells, if it is [beyond](Known::Beyond) that; else 0; metres.
    pub beyond: f32,
}

impl FloorCell {
    pub(crate) const NONE: Self =
        Self { height: f32::NAN, sigma: f32::NAN, top: f32::NAN, headroom: f32::NAN, known: Known::No, difficulty: 0.0, beyond: 0.0 };

    /// Whether it is steeper than the robot climbs.
    pub fn is_steep(&self) -> bool {
        self.difficulty > 1.0
    }
}
