//! Where scans are that are looked for in a map.

use super::MappingRun;
use voxelastic_slam::loops::Whereabouts;

impl MappingRun {
    /// Has the scans that come, while they are looked for in a map that was loaded or gone on with, looked for about there alone. Returns where that is; in words why it means
    /// nothing otherwise.
    pub fn look_near(&mut self, about: Whereabouts) -> Result<Whereabouts, String> {
        let is_empty = self.scans() == 0;
        match &mut self.alignment.search {
            Some(search) => Ok(search.look_near(about)),
            None if is_empty => Err("there is no map yet in which the scans could be looked for".to_owned()),
            None => Err("the scans are not looked for: they are in the map already, where their poses say".to_owned()),
        }
    }
}
