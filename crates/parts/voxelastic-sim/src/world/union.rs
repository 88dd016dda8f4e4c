//! The union of solids: nearest solid and ray casting, accelerated by a bounding volume hierarchy.

use crate::solid::{Solid, Vec3};
use crate::solid_bvh::{LANES, Packet, SolidBvh};

/// A ray: origin and unit direction, world frame, metres.
pub type Ray = (Vec3, Vec3);

/// An intersection of a ray with a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, metres; 0 when the ray starts inside a solid.
    pub range: f64,
    /// Index of the solid in [`World::solids`](super::World::solids).
    pub solid: u32,
}

/// Solids in the order of the leaves of a hierarchy, followed by the unbounded ones.
#[derive(Clone, Debug)]
pub(super) struct Union {
    pub solids: Vec<Solid>,
    /// Number of bounded solids, which come first.
    pub bounded: usize,
    bvh: SolidBvh,
}

impl Union {
    /// The union of `bounded` and `unbounded` solids, and the order of the bounded ones: entry k is the former index of solid k.
    pub fn new(bounded: &[Solid], unbounded: impl IntoIterator<Item = Solid>) -> (Self, Vec<u32>) {
        let (bvh, order) = SolidBvh::build(bounded);
        let solids = order.iter().map(|&k| bounded[k as usize]).chain(unbounded).collect();
        (Self { solids, bounded: bounded.len(), bvh }, order)
    }

    fn unbounded(&self) -> impl Iterator<Item = (u32, &Solid)> {
        (self.bounded as u32..).zip(&self.solids[self.bounded..])
    }

    /// Smallest signed distance of a solid to `p`, and its index: outside the nearest solid, inside of several the one whose surface is farthest.
    pub fn nearest(&self, p: &Vec3) -> Option<(f64, u32)> {
        let mut best: Option<(f64, u32)> = None;
        for (index, solid) in self.unbounded() {
            let d = solid.distance(p);
            if best.is_none_or(|b| d < b.0) {
                best = Some((d, index));
            }
        }
        let limit = best.map_or(f64::INFINITY, |b| b.0);
        self.bvh.nearest(&self.solids, p, limit).or(best)
    }

    /// Casts rays up to `range` metres, [`LANES`] at a time.
    pub fn cast(&self, rays: &[Ray], range: f64, hits: &mut [Option<Hit>]) {
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
        for (index, solid) in self.unbounded() {
            packet.hit(index, solid);
        }
        self.bvh.cast(&self.solids, &mut packet);
        packet
    }
}
