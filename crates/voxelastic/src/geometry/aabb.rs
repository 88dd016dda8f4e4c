//! Axis-aligned boxes.

/// An axis-aligned box in metres; empty until a point is added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Corner with the smallest coordinates, metres.
    pub min: [f32; 3],
    /// Corner with the largest coordinates, metres.
    pub max: [f32; 3],
}

impl Default for Aabb {
    fn default() -> Self {
        Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] }
    }
}

impl Aabb {
    /// Extends the box to contain point `p`, metres.
    pub fn add(&mut self, p: [f32; 3]) {
        self.min = std::array::from_fn(|i| self.min[i].min(p[i]));
        self.max = std::array::from_fn(|i| self.max[i].max(p[i]));
    }

    /// Whether no point was ever added.
    pub fn is_empty(&self) -> bool {
        self.min[0] > self.max[0]
    }

    /// Edge lengths, metres; zero for an empty box.
    pub fn size(&self) -> [f32; 3] {
        std::array::from_fn(|i| (self.max[i] - self.min[i]).max(0.0))
    }
}
