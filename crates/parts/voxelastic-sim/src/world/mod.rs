//! Worlds: unions of solids with exact distances and ray casting.

mod builder;
mod depth;
mod surface;
mod union;

pub use builder::WorldBuilder;
pub use surface::SurfacePoint;
pub use union::{Hit, Ray};

use crate::solid::{Solid, Vec3};
use depth::SKIN;
use union::Union;

/// A union of solids in a map frame with z up, metres.
///
/// Distances are exact outside, and inside down to a limit, also where solids overlap or touch: faces inside of the union are not surface. Rays are
/// intersected in closed form.
#[derive(Clone, Debug)]
pub struct World {
    name: String,
    seed: u64,
    union: Union,
    /// Albedo of each solid.
    albedo: Vec<f32>,
}

impl World {
    /// Limit of [`distance`](Self::distance) inside of solids, metres: deeper points get minus this.
    pub const DEPTH_LIMIT: f64 = 1.0;

    /// A world of a union whose solids have these albedos.
    fn new(name: String, seed: u64, union: Union, albedo: Vec<f32>) -> Self {
        Self { name, seed, union, albedo }
    }

    /// Name of the world.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The seed it was built from.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The solids whose union is the world.
    pub fn solids(&self) -> &[Solid] {
        &self.union.solids
    }

    /// The solids except half spaces; the first of [`solids`](Self::solids).
    fn bounded_solids(&self) -> &[Solid] {
        &self.union.solids[..self.union.bounded]
    }

    /// Albedo of a solid's surface, 0 to 1.
    pub fn albedo(&self, solid: u32) -> f32 {
        self.albedo[solid as usize]
    }

    /// Signed distance from `p` (map frame, metres) to the surface of the union, negative inside; no less than
    /// minus [`World::DEPTH_LIMIT`]. Positive infinity in an empty world.
    ///
    /// Exact to rounding outside. Inside it is exact to about 2e-5 m. NaN for a point that is not finite.
    pub fn distance(&self, p: [f64; 3]) -> f64 {
        self.distance_within(p, Self::DEPTH_LIMIT)
    }

    /// As [`distance`](Self::distance), down to a depth of `limit` metres. The cost inside of solids grows with the limit.
    pub fn distance_within(&self, p: [f64; 3], limit: f64) -> f64 {
        let p = Vec3::from(p);
        if !p.iter().all(|c| c.is_finite()) {
            return f64::NAN;
        }
        match self.union.nearest(&p) {
            Some((d, _)) if d < SKIN / 10.0 => -depth::depth(&self.union, &p, Self::DEPTH_LIMIT, limit),
            Some((d, _)) => d,
            None => f64::INFINITY,
        }
    }

    /// Smallest signed distance of a solid to `p`, and the index of the solid; inside of several the one whose surface is farthest.
    pub(crate) fn nearest(&self, p: [f64; 3]) -> Option<(f64, u32)> {
        self.union.nearest(&p.into())
    }

    /// As [`nearest`](Self::nearest).
    #[cfg(test)]
    fn nearest_solid(&self, p: &Vec3) -> Option<(f64, u32)> {
        self.union.nearest(p)
    }

    /// First surface along the ray from `origin` to the unit `direction`, no further than `range` metres. A ray that starts
    /// inside a solid hits at once.
    pub fn cast(&self, origin: [f64; 3], direction: [f64; 3], range: f64) -> Option<Hit> {
        let mut hit = [None];
        self.cast_all(&[(origin.into(), direction.into())], range, &mut hit);
        hit[0]
    }

    /// As [`World::cast`] for many rays; fastest when neighbours in the list are neighbours in space. Fills as many
    /// `hits` as there are rays, at most all.
    pub fn cast_all(&self, rays: &[Ray], range: f64, hits: &mut [Option<Hit>]) {
        self.union.cast(rays, range, hits);
    }

    /// Unit normal, pointing out, of solid `solid` at a point on its surface.
    pub fn normal(&self, solid: u32, p: [f64; 3]) -> [f64; 3] {
        self.union.solids[solid as usize].normal(&p.into()).into()
    }

    /// Corners of the smallest axis-aligned box around all bounded solids; `None` if there are none.
    pub fn bounds(&self) -> Option<([f64; 3], [f64; 3])> {
        let boxes = self.bounded_solids().iter().map(Solid::bounds);
        boxes.reduce(|a, b| (a.0.inf(&b.0), a.1.sup(&b.1))).map(|(low, high)| (low.into(), high.into()))
    }

    /// A hash of all solids: equal for equal worlds on every machine (coordinates are rounded to 0.1 mm).
    pub fn fingerprint(&self) -> u64 {
        let fold = |hash: u64, value: u64| (hash ^ value).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(23);
        let solids = self.solids().iter().zip(&self.albedo);
        solids.fold(0xcbf2_9ce4_8422_2325, |hash, (solid, albedo)| {
            let (kind, numbers) = solid.parameters();
            let hash = fold(fold(hash, kind), u64::from((albedo * 1000.0) as u32));
            numbers.iter().fold(hash, |h, n| fold(h, (n * 1e4).round() as i64 as u64))
        })
    }
}

#[cfg(test)]
mod tests;
