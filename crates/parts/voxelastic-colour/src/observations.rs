//! What images show of each vertex: its best observations.

/// Observations that a vertex keeps, those with the largest weights.
pub(crate) const KEPT: usize = 6;

/// What one image shows of a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Observation {
    /// Number of the image.
    pub(crate) image: u32,
    /// 0 if there is none.
    pub(crate) weight: f32,
    /// Linear light, 0 to 65535.
    light: [u16; 3],
}

impl Observation {
    pub(crate) fn new(image: u32, weight: f32, light: [f32; 3]) -> Self {
        Self { image, weight, light: light.map(|c| (c.clamp(0.0, 1.0) * 65535.0).round() as u16) }
    }

    /// Linear light, 0 to 1.
    pub(crate) fn light(&self) -> [f32; 3] {
        self.light.map(|c| f32::from(c) / 65535.0)
    }
}

/// The best observations of a vertex, the best first.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Observations([Observation; KEPT]);

impl Observations {
    /// Adds one. Of equal weights the earlier is kept.
    pub(crate) fn add(&mut self, new: Observation) {
        let at = self.0.partition_point(|o| o.weight >= new.weight);
        if at < KEPT {
            self.0.copy_within(at..KEPT - 1, at + 1);
            self.0[at] = new;
        }
    }

    pub(crate) fn all(&self) -> &[Observation] {
        let count = self.0.iter().take_while(|o| o.weight > 0.0).count();
        &self.0[..count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_are_kept() {
        let mut kept = Observations::default();
        assert!(kept.all().is_empty());
        for image in 0..20 {
            kept.add(Observation::new(image, ((image * 7) % 20 + 1) as f32, [0.5; 3]));
        }
        let weights: Vec<f32> = kept.all().iter().map(|o| o.weight).collect();
        assert_eq!(weights, [20.0, 19.0, 18.0, 17.0, 16.0, 15.0]);
        assert!((kept.all()[0].light()[1] - 0.5).abs() < 1e-4);
    }
}
