//! Where a ray passes through a surface, by the signed distances at few of its points.

/// The search for the place at which a ray passes through a surface from its front, within two voxels of where it enters an occupied voxel. It says at which places of
/// the ray it needs the signed distance, and [takes](Self::take) them.
pub struct Crossing {
    /// Where the ray enters the voxel.
    near: f64,
    voxel: f64,
    search: Search,
}

/// A place on the ray, metres from its origin, and the signed distance there.
type Sample = (f64, f64);

/// What is being done.
#[derive(Clone, Copy)]
enum Search {
    /// At the voxel.
    Begin,
    /// Along the ray while it is in front of a surface, backwards while it is behind one. The surface is no nearer than its distance, so that few steps do.
    Walk { last: Sample, way: f64 },
    /// Between a place in front of the surface and one behind it.
    Refine { front: Sample, behind: Sample },
    /// In small steps, where distances are not known everywhere, or the surface is not where it seemed to be.
    Scan,
}

/// How far from the voxel the surface may be, voxels.
const REACH: f64 = 2.0;

/// Between places so near each other, distances are as good as linear, voxels.
const SMALL: f64 = 0.25;

/// Steps of a scan.
const STEPS: u32 = 8;

impl Crossing {
    /// A search around a place on a ray, metres, in a map with finest voxels of `voxel` metres.
    pub fn new(near: f64, voxel: f64) -> Self {
        Self { near, voxel, search: Search::Begin }
    }

    /// The places at which it needs the signed distance.
    pub fn places(&self) -> impl Iterator<Item = f64> + use<> {
        let (one, range) = match self.search {
            Search::Begin => (Some(self.near), 0..0),
            Search::Walk { last, way } => (Some(self.ahead(last, way)), 0..0),
            Search::Refine { front, behind } => (Some(zero(front, behind)), 0..0),
            Search::Scan => (None, 0..STEPS + 1),
        };
        let (begin, step) = (self.near - REACH * self.voxel, 2.0 * REACH * self.voxel / f64::from(STEPS));
        one.into_iter().chain(range.map(move |k| begin + f64::from(k) * step))
    }

    /// Number of these places.
    pub fn count(&self) -> usize {
        if let Search::Scan = self.search { STEPS as usize + 1 } else { 1 }
    }

    /// Takes the signed distances at the [`places`](Self::places), NaN where they are not known. Some at the end of the search: the crossing, if there is one.
    pub fn take(&mut self, values: &[f32]) -> Option<Option<f64>> {
        let mut samples = self.places().zip(values.iter().map(|value| f64::from(*value)));
        let Some(here) = samples.next() else { return Some(None) };
        let way = if here.1 > 0.0 { 1.0 } else { -1.0 };
        match self.search {
            Search::Begin | Search::Walk { .. } if here.1.is_nan() => self.scan(),
            Search::Begin => self.walk(here, way),
            Search::Walk { way: before, .. } if way == before => self.walk(here, way),
            Search::Walk { last, .. } if way < 0.0 => self.between(last, here),
            Search::Walk { last, .. } => self.between(here, last),
            Search::Refine { front, behind } if here.1.is_nan() => Some(Some(zero(front, behind))),
            Search::Refine { behind, .. } if here.1 > 0.0 => Some(Some(zero(here, behind))),
            Search::Refine { front, .. } => Some(Some(zero(front, here))),
            Search::Scan => {
                let mut last = here;
                let ends = samples.find_map(|behind| {
                    let front = std::mem::replace(&mut last, behind);
                    (front.1 > 0.0 && behind.1 <= 0.0).then_some((front, behind))
                });
                ends.map_or(Some(None), |(front, behind)| self.between(front, behind))
            }
        }
    }

    /// The next place of a walk.
    fn ahead(&self, last: Sample, way: f64) -> f64 {
        last.0 + way * (0.9 * last.1.abs()).max(SMALL * self.voxel)
    }

    fn walk(&mut self, last: Sample, way: f64) -> Option<Option<f64>> {
        if (self.ahead(last, way) - self.near).abs() > REACH * self.voxel {
            return self.scan();
        }
        self.search = Search::Walk { last, way };
        None
    }

    fn scan(&mut self) -> Option<Option<f64>> {
        self.search = Search::Scan;
        None
    }

    fn between(&mut self, front: Sample, behind: Sample) -> Option<Option<f64>> {
        if behind.0 - front.0 <= 1.01 * SMALL * self.voxel {
            return Some(Some(zero(front, behind)));
        }
        self.search = Search::Refine { front, behind };
        None
    }
}

/// Where the distance is zero between two places, if it is linear.
fn zero(front: Sample, behind: Sample) -> f64 {
    front.0 + (behind.0 - front.0) * (front.1 / (front.1 - behind.1))
}
