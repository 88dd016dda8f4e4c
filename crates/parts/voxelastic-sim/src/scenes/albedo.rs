//! Albedos of materials, 0 to 1.

pub(super) const STONE: f32 = 0.42;
pub(super) const TRIM: f32 = 0.6;
pub(super) const GLASS: f32 = 0.12;
pub(super) const ROCK: f32 = 0.25;
pub(super) const GRASS: f32 = 0.3;
pub(super) const PAVING: f32 = 0.22;
pub(super) const BARK: f32 = 0.2;
pub(super) const LEAVES: f32 = 0.35;
pub(super) const IRON: f32 = 0.15;
pub(super) const WOOD: f32 = 0.3;
pub(super) const PAINT: f32 = 0.7;
pub(super) const SIGN: f32 = 0.95;
