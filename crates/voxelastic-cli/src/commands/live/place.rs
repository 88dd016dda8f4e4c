//! Where a node is in what comes, and where that belongs in the map of before.

use super::relocalisation::Relocalisation;
use crate::input::Positions;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_io::ReadPosition;
use voxelastic_live::feed::Arrival;

/// Where a node is in what comes.
#[derive(Default)]
pub struct Place {
    /// Where the reading of a recording was after each item.
    positions: Option<Positions>,
    /// Where it was after the last item that was taken.
    position: Option<ReadPosition>,
    /// Scans that came, and those that were left out, while an earlier process mapped.
    pub before: [usize; 2],
    /// Of this process: scans that were taken, and those that were left out before.
    taken: [usize; 2],
    /// Finds the first scans in the map of an earlier process.
    pub relocalisation: Option<Box<Relocalisation>>,
    /// The number of the first node that comes, and the last one of before.
    pub first_node: NodeId,
    pub last_node: Option<NodeId>,
    /// Where the frame of the poses that come lies in the map, if that is another one.
    pub t_map_frame: Option<Pose>,
}

impl Place {
    /// After what an earlier process has taken.
    pub fn new(positions: Option<Positions>, before: [usize; 2]) -> Self {
        Self { positions, before, ..Self::default() }
    }

    /// Whether what comes is a recording.
    pub fn is_recorded(&self) -> bool {
        self.positions.is_some()
    }

    /// Where the reading of a recording is, if there is one; none where nobody can go on from here.
    pub fn position(&self) -> Option<Option<ReadPosition>> {
        if self.is_recorded() { self.position.clone().map(Some) } else { self.relocalisation.is_none().then_some(None) }
    }

    /// An input was taken.
    pub fn note(&mut self, arrival: &Arrival, is_scan: bool) {
        if is_scan {
            self.taken = [self.taken[0] + 1, arrival.left_out];
        }
        self.position = self.positions.as_ref().and_then(|positions| positions.after(arrival.number));
    }

    /// Scans that came, and those that were left out, in all.
    pub fn came(&self) -> [usize; 2] {
        let [taken, left_out] = self.taken;
        [self.before[0] + taken + left_out, self.before[1] + left_out]
    }
}
