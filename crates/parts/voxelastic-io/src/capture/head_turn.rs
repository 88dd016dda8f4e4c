//! How far the head of a sensor turns from one block of a packet to the next.

/// A larger turn between two blocks, hundredths of a degree, is a gap: packets were lost, or the sensor leaves a sector out.
const LARGEST_STEP: u32 = 1000;

/// The turn between two blocks, as far as packets have told it.
#[derive(Debug, Default)]
pub(super) struct HeadTurn {
    /// The last one that was no gap, hundredths of a degree.
    last: f64,
}

impl HeadTurn {
    /// The turn from each block of a packet to the next one, hundredths of a degree, by the azimuths of the blocks in the same unit. A gap, and the last block, take the turn
    /// before them, and a gap at the beginning the one after it.
    pub(super) fn steps(&mut self, azimuths: &[u16]) -> Vec<f64> {
        let between = |pair: &[u16]| (u32::from(pair[1]) + 36_000 - u32::from(pair[0])) % 36_000;
        if let Some(step) = azimuths.windows(2).map(between).find(|step| *step < LARGEST_STEP) {
            self.last = f64::from(step);
        }
        let mut steps: Vec<f64> = Vec::with_capacity(azimuths.len());
        for step in azimuths.windows(2).map(between) {
            if step < LARGEST_STEP {
                self.last = f64::from(step);
            }
            steps.push(self.last);
        }
        steps.push(self.last);
        steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_and_the_last_block_turn_as_their_neighbours() {
        let mut turn = HeadTurn::default();
        assert_eq!(turn.steps(&[35_960, 35_980, 0, 21, 5_000, 5_020]), [20.0, 20.0, 21.0, 21.0, 20.0, 20.0]);
        assert_eq!(turn.steps(&[100, 9_000, 9_019, 9_040]), [19.0, 19.0, 21.0, 21.0]);
        assert_eq!(turn.steps(&[100, 9_000]), [21.0, 21.0], "nothing but a gap: as before");
        assert_eq!((turn.steps(&[7]), turn.steps(&[])), (vec![21.0], vec![21.0]));
    }
}
