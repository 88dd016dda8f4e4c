//! What is published, and for whom.

use super::floor_plan::GridSettings;
use crate::link::Link;
use std::sync::Arc;

/// The time that the whole 2-D map may take a link of limited rate, and its costs as much again, seconds.
const GRID_TIME: f64 = 2.5;

/// What is published.
#[derive(Clone, Debug)]
pub struct OutputOptions {
    /// Level of detail of the surface, 0 to 3.
    pub detail: usize,
    /// What `~/grid` is made for.
    pub grid: GridSettings,
    /// Whether the robot explores: then there are topics about that.
    pub explores: bool,
    /// Whether transforms are published.
    pub transforms: bool,
    /// What messages travel over, where that limits what goes out: what is large is not published then, and the rest less often.
    pub link: Option<Arc<Link>>,
}

impl Default for OutputOptions {
    fn default() -> Self {
        Self { detail: 1, grid: GridSettings::default(), explores: false, transforms: true, link: None }
    }
}

impl OutputOptions {
    /// What the whole 2-D map is made for: over a link its cells may be larger.
    pub(super) fn grid(&self) -> GridSettings {
        let most = self.link.as_ref().map(|link| (link.carries(GRID_TIME) as f64).sqrt());
        GridSettings { most_cells: most.unwrap_or(self.grid.most_cells), ..self.grid }
    }
}
