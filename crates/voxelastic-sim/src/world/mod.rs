//! A world: the union of solids, with exact distances and ray casting.

mod build;
mod interior;
mod surface;

pub use build::WorldBuilder;
pub use surface::SurfacePoint;

use crate::bvh::{Bvh, LANES, Packet};
use crate::solid::{Solid, Vec3};

/// A ray: a start and a unit direction, world frame, metres.
pub type Ray = (Vec3, Vec3);

/// Where a ray meets a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, metres; 0 when the ray starts inside a solid.
    pub range: f64,
    /// Which of [`World::solids`] is hit.
    pub solid: u32,
}

/// A union of solids in a map frame with z up, metres.
///
/// The distance to it is exact outside, and inside down to a limit: also where solids overlap or touch, whose inner faces do not count as
/// surface. Rays are cast in closed form.
#[derive(Clone, Debug)]
pub struct World {
    name: String,
    seed: u64,
    /// First those in the tree, in its order, then the unbounded ones.
    solids: Vec<Solid>,
    albedo: Vec<f32>,
    bounded: usize,
    bvh: Bvh,
}

impl World {
    /// Usual limit of [`distance`](Self::distance): inside of solids it is exact down to this depth in metres; deeper points all get minus this.
    pub const DEPTH_LIMIT: f64 = 1.0;

    /// What the world is called.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The seed it was built from.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The solids whose union the world is.
    pub fn solids(&self) -> &[Solid] {
        &self.solids
    }

    /// Share of light that a solid's surface throws back, 0 to 1.
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

    /// As [`distance`](Self::distance), down to a depth of `limit` metres: the search for the way out grows with it.
    pub fn distance_within(&self, p: [f64; 3], limit: f64) -> f64 {
        let p = Vec3::from(p);
        if !p.iter().all(|c| c.is_finite()) {
            return f64::NAN;
        }
        match self.nearest_solid(&p) {
            Some((d, _)) if d < interior::SKIN / 10.0 => -self.depth(&p, limit),
            Some((d, _)) => d,
            None => f64::INFINITY,
        }
    }

    /// The solid nearest to `p` with its own signed distance; inside of several, the one that `p` is deepest in.
    pub(crate) fn nearest_solid(&self, p: &Vec3) -> Option<(f64, u32)> {
        let mut best: Option<(f64, u32)> = None;
        for (index, solid) in (self.bounded as u32..).zip(&self.solids[self.bounded..]) {
            let d = solid.distance(p);
            if best.is_none_or(|b| d < b.0) {
                best = Some((d, index));
            }
        }
        let limit = best.map_or(f64::INFINITY, |b| b.0);
        self.bvh.nearest(&self.solids, p, limit).or(best)
    }

    /// First surface along the ray from `origin` to the unit `direction`, no further than `range` metres. A ray that starts
    /// inside a solid hits at once.
    pub fn cast(&self, origin: [f64; 3], direction: [f64; 3], range: f64) -> Option<Hit> {
        let mut hit = [None];
        self.cast_all(&[(origin.into(), direction.into())], range, &mut hit);
        hit[0]
    }

    /// As [`World::cast`] for many rays; fastest when neighbours in the list are neighbours in space. Fills as many
    /// `hits` as there are rays (or as it is long).
    pub fn cast_all(&self, rays: &[Ray], range: f64, hits: &mut [Option<Hit>]) {
        for (rays, hits) in rays.chunks(LANES).zip(hits.chunks_mut(LANES)) {
            let packet = self.cast_packet(rays, range);
            for (lane, hit) in hits.iter_mut().take(rays.len()).enumerate() {
                let solid = packet.solid[lane];
                *hit = (solid != u32::MAX).then(|| Hit { range: packet.range[lane], solid });
            }
        }
    }

    fn cast_packet(&self, rays: &[Ray], range: f64) -> Packet {
        let mut packet = Packet::new(rays, range);
        for (index, solid) in (self.bounded as u32..).zip(&self.solids[self.bounded..]) {
            packet.hit(index, solid);
        }
        self.bvh.cast(&self.solids, &mut packet);
        packet
    }

    /// Unit normal, pointing out, of solid `solid` at a point on its surface.
    pub fn normal(&self, solid: u32, p: [f64; 3]) -> [f64; 3] {
        self.solids[solid as usize].normal(&p.into()).into()
    }

    /// Corners of the smallest axis-aligned box around all bounded solids; `None` if there are none.
    pub fn bounds(&self) -> Option<([f64; 3], [f64; 3])> {
        let boxes = self.solids[..self.bounded].iter().map(Solid::bounds);
        boxes.reduce(|a, b| (a.0.inf(&b.0), a.1.sup(&b.1))).map(|(low, high)| (low.into(), high.into()))
    }

    /// A hash of all solids: equal for equal worlds, whichever machine built them (coordinates count to 0.1 mm).
    pub fn fingerprint(&self) -> u64 {
        let fold = |hash: u64, value: u64| (hash ^ value).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(23);
        let solids = self.solids.iter().zip(&self.albedo);
        solids.fold(0xcbf2_9ce4_8422_2325, |hash, (solid, albedo)| {
            let (kind, numbers) = solid.parameters();
            let hash = fold(fold(hash, kind), u64::from((albedo * 1000.0) as u32));
            numbers.iter().fold(hash, |h, n| fold(h, (n * 1e4).round() as i64 as u64))
        })
    }
}

#[cfg(test)]
mod tests;
