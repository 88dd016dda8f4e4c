//! The types of values that settings have, and how they are read from and written as text.

use crate::memory::MemorySize;
use Allowed::{Between, OneOf};
use std::fmt;

/// The values that a setting may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Allowed {
    /// A number from the first to the second, both included.
    Between(f64, f64),
    /// One of these words.
    OneOf(&'static [&'static str]),
    /// Text, described here; whoever uses the setting checks it.
    Text(&'static str),
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Between(low, high) => write!(f, "{low} to {high}"),
            Self::OneOf(words) => write!(f, "{}", words.join(" | ")),
            Self::Text(words) => write!(f, "{words}"),
        }
    }
}

/// The kinds of values that settings have.
pub(super) trait Value: Sized + Clone + PartialEq {
    fn parse(text: &str) -> Option<Self>;
    fn text(&self) -> String;
    fn is_within(&self, allowed: &Allowed) -> bool;
}

macro_rules! number_values {
    ($($kind:ty),*) => {$(
        impl Value for $kind {
            fn parse(text: &str) -> Option<Self> {
                text.parse().ok()
            }
            fn text(&self) -> String {
                self.to_string()
            }
            fn is_within(&self, allowed: &Allowed) -> bool {
                // Bounds are compared as the setting's own type, so that 0.005 is not below 0.005.
                matches!(*allowed, Between(low, high) if (low as $kind..=high as $kind).contains(self))
            }
        }
    )*};
}
number_values!(f32, f64, usize);

impl Value for String {
    fn parse(text: &str) -> Option<Self> {
        Some(text.to_owned())
    }
    fn text(&self) -> String {
        self.clone()
    }
    fn is_within(&self, _: &Allowed) -> bool {
        !self.trim().is_empty()
    }
}

/// What becomes of things that move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dynamic {
    /// They are mapped as everything else, and leave traces.
    #[default]
    Keep,
    /// Their points are set aside, and what they left is removed at the end.
    Remove,
}

impl Value for Dynamic {
    fn parse(text: &str) -> Option<Self> {
        match text {
            "keep" => Some(Self::Keep),
            "remove" => Some(Self::Remove),
            _ => None,
        }
    }
    fn text(&self) -> String {
        match self {
            Self::Keep => "keep",
            Self::Remove => "remove",
        }
        .to_owned()
    }
    fn is_within(&self, _: &Allowed) -> bool {
        true
    }
}

/// What becomes of the laps of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Laps {
    /// What a lap sees again goes into the submaps of the one before.
    #[default]
    Fused,
    /// Each has submaps of its own.
    Apart,
}

impl Value for Laps {
    fn parse(text: &str) -> Option<Self> {
        match text {
            "fused" => Some(Self::Fused),
            "apart" => Some(Self::Apart),
            _ => None,
        }
    }
    fn text(&self) -> String {
        match self {
            Self::Fused => "fused",
            Self::Apart => "apart",
        }
        .to_owned()
    }
    fn is_within(&self, _: &Allowed) -> bool {
        true
    }
}

/// What a map stores.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FieldKind {
    /// Truncated signed distances: surfaces and meshes (paper: MultiresTSDF).
    #[default]
    Tsdf,
    /// Free, occupied and unknown space (paper: MultiresOFusion).
    Occupancy,
    /// Both, side by side, in one pass over the scans.
    Both,
}

impl FieldKind {
    pub(super) const ALL: [(&'static str, Self); 3] = [("tsdf", Self::Tsdf), ("occupancy", Self::Occupancy), ("both", Self::Both)];

    /// Whether the map has signed distances.
    pub fn has_tsdf(self) -> bool {
        matches!(self, Self::Tsdf | Self::Both)
    }

    /// Whether the map has occupancy.
    pub fn has_occupancy(self) -> bool {
        matches!(self, Self::Occupancy | Self::Both)
    }

    /// Its name, as settings and files have it.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

impl Value for FieldKind {
    fn parse(text: &str) -> Option<Self> {
        Self::ALL.iter().find(|(name, _)| *name == text).map(|(_, kind)| *kind)
    }
    fn text(&self) -> String {
        self.name().to_owned()
    }
    fn is_within(&self, allowed: &Allowed) -> bool {
        matches!(allowed, OneOf(words) if words.contains(&self.name()))
    }
}

/// What a beam without return says about the space along it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NoReturn {
    /// Nothing: it may have met something dark, or a mirror.
    #[default]
    Unknown,
    /// That there is nothing up to the maximum range.
    Free,
}

impl NoReturn {
    const ALL: [(&'static str, Self); 2] = [("unknown", Self::Unknown), ("free", Self::Free)];
}

/// Radius around the sensor that counts as free, because the robot was there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum RobotRadius {
    /// As the sensor's least range, because nothing nearer is measured, but at most [`RobotRadius::MOST_BY_ITSELF`].
    #[default]
    Auto,
    /// This radius, metres; 0 for none.
    Metres(f32),
}

impl RobotRadius {
    /// Largest radius that is chosen automatically, metres: sensors are seldom mounted lower, and a larger ball would reach below the floor.
    pub const MOST_BY_ITSELF: f32 = 0.5;
    /// Largest radius, metres.
    const MOST: f32 = 5.0;
}

impl Value for RobotRadius {
    fn parse(text: &str) -> Option<Self> {
        if text == "auto" { Some(Self::Auto) } else { text.parse().ok().map(Self::Metres) }
    }
    fn text(&self) -> String {
        match self {
            Self::Auto => "auto".to_owned(),
            Self::Metres(radius) => radius.to_string(),
        }
    }
    fn is_within(&self, _: &Allowed) -> bool {
        match self {
            Self::Auto => true,
            Self::Metres(radius) => (0.0..=Self::MOST).contains(radius),
        }
    }
}

impl Value for MemorySize {
    fn parse(text: &str) -> Option<Self> {
        text.parse().ok()
    }
    fn text(&self) -> String {
        self.to_string()
    }
    fn is_within(&self, _: &Allowed) -> bool {
        true
    }
}

impl Value for NoReturn {
    fn parse(text: &str) -> Option<Self> {
        Self::ALL.iter().find(|(name, _)| *name == text).map(|(_, kind)| *kind)
    }
    fn text(&self) -> String {
        Self::ALL[*self as usize].0.to_owned()
    }
    fn is_within(&self, allowed: &Allowed) -> bool {
        matches!(allowed, OneOf(words) if words.contains(&Self::ALL[*self as usize].0))
    }
}
